"""Workers of a Dask cluster, whoever started it, and of jobs that Slurm starts."""

import logging
import pickle
import threading
import time
import uuid
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from typing import Any

from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.campaign.workers import LOST, CampaignWorker, Death, ProcessDiedError
from modsim3d.core.errors import ModsimError


def work_on(campaign: str, task: bytes) -> Any:
    """Report on a pickled task, or how its process died. `campaign` is the key of the engine that handed it in. Raises
    ModsimError if a process could not start, or the task cannot be done here."""
    return _hands().do(campaign, task)


def give_up(campaign: str) -> None:
    """Do no more tasks of a campaign, end the one that is being done, and end the process."""
    _hands().give_up(campaign)


class _Hands:
    """One process and the thread that talks to it: one task at a time, however many threads the Dask worker has. The
    system ends the process when the thread that started it ends, and threads of a Dask worker may end. This one lasts
    as long as the Dask worker, and does not keep it from ending."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Future[Any], str, bytes | None]] = SimpleQueue()
        self._lock = threading.Lock()
        self._process: CampaignWorker | None = None
        self._campaign: str | None = None  # of the task that is being done
        self._given_up: set[str] = set()
        threading.Thread(target=self._work, daemon=True).start()

    def do(self, campaign: str, task: bytes) -> Any:
        future: Future[Any] = Future()
        self._waiting.put((future, campaign, task))
        return future.result()

    def give_up(self, campaign: str) -> None:
        with self._lock:
            self._given_up.add(campaign)
            if self._process is not None and self._campaign == campaign:
                self._process.kill()
        self._waiting.put((Future(), campaign, None))

    def _work(self) -> None:
        while True:
            future, campaign, task = self._waiting.get()
            try:
                if task is None:
                    self._close()
                else:
                    future.set_result(self._answer(campaign, task))
            except BaseException as error:
                future.set_exception(error)

    def _answer(self, campaign: str, task: bytes) -> Any:
        with self._lock:
            if campaign in self._given_up:
                return LOST
            if self._process is None:
                self._process = CampaignWorker()
            self._campaign, process = campaign, self._process
        try:
            return process.do(pickle.loads(task))
        except BaseException as error:
            self._close()
            if isinstance(error, ProcessDiedError):
                return error.death
            raise
        finally:
            with self._lock:
                self._campaign = None

    def _close(self) -> None:
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()


_making = threading.Lock()
_only_hands = cache(_Hands)


def _hands() -> _Hands:
    with _making:
        return _only_hands()


CONNECT_S = 30.0  # how long a scheduler is waited for, at the start and when the connection to it is lost
LOOK_S = 2.0  # time between two looks at which workers there are
_MISSING = 'campaigns on a cluster need {}: pip install "modsim3d[cluster]"'


class DaskEngine:
    """Does tasks on the workers of a Dask scheduler; workers may come and go."""

    def __init__(self, address: str) -> None:
        """Connect to an address such as `tcp://10.0.0.1:8786`; ModsimError without a scheduler there or Dask."""
        client_type = _library().Client
        try:
            self._client: Any = client_type(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise ModsimError(f"no Dask scheduler answers at {address}: {str(error).splitlines()[0]}") from None
        self._name, self._key, self._number = address, uuid.uuid4().hex, 0
        self._handed: dict[str, tuple[Any, Task]] = {}
        self._ended: SimpleQueue[str] = SimpleQueue()
        self._workers = 0
        self._looked = float("-inf")

    @property
    def width(self) -> int:
        """Number of worker processes that there are now; 1 if there is none yet."""
        if time.monotonic() - self._looked > LOOK_S:
            with suppress(OSError):  # the connection is lost: `next` finds out whether it comes back
                self._workers = len(self._client.nthreads())
            self._looked = time.monotonic()
        return max(1, self._workers)

    def submit(self, task: Task) -> None:
        """Hand in a task; Dask chooses the worker. It is bound to none, not even loosely: Dask would never give such a
        task to a worker that comes after all others have gone."""
        self._number += 1
        key = f"modsim3d-{self._key}-{self._number}"
        future = self._client.submit(work_on, self._key, pickle.dumps(task), key=key, pure=False, retries=0)
        self._handed[key] = future, task
        future.add_done_callback(lambda ended: self._ended.put(ended.key))

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Wait for a task that was handed in, with its report, or how its process died. Dask hands the task of a worker
        that it has lost to another by itself, and says so only if that happens often. Raises ModsimError if a worker
        cannot do it, or the scheduler is gone."""
        while True:
            key = self._next_ended()
            if key not in self._handed:
                continue
            future, task = self._handed.pop(key)
            status = future.status
            if status == "error":
                _raise_unless_killed(future.exception())
                return task, LOST
            if status == "finished":
                with suppress(CancelledError, OSError):  # the connection may be lost just now
                    report: TaskReport | Death = future.result()
                    return task, report
            self._wait_for_scheduler()  # it was cancelled when the connection was lost, or its result is lost
            self.submit(task)

    def close(self) -> None:
        """End what is handed in, and leave the cluster."""
        with suppress(Exception):  # the scheduler may be gone, and its tasks with it
            if self._handed:
                self._client.cancel([future for future, _ in self._handed.values()], force=True)
            self._client.run(give_up, self._key, on_error="ignore")
        self._client.close()

    def _next_ended(self) -> str:
        """The key of a task that ended, or was cancelled or lost."""
        while True:
            try:
                return self._ended.get(timeout=LOOK_S)
            except Empty:
                for key, (future, _) in self._handed.items():
                    if future.status not in ("pending", "finished"):
                        return key

    def _wait_for_scheduler(self) -> None:
        """Wait while the client connects again; ModsimError if it does not."""
        while self._client.status == "connecting":
            time.sleep(0.1)
        if self._client.status != "running":
            raise ModsimError(
                f"the Dask scheduler at {self._name} is gone: what is done is kept; start a scheduler, and the same "
                "command goes on"
            )
        self._looked = float("-inf")


class SlurmEngine(DaskEngine):
    """Does tasks in jobs that Slurm starts, each with Dask workers; this process is their scheduler."""

    def __init__(self, jobs: int) -> None:
        """Hand in jobs; the first tasks begin when the first of them does. The configuration of Dask says below
        `jobqueue.slurm` what each job has. Raises ModsimError if a library is missing, the configuration is not
        complete, or Slurm refuses a job."""
        cluster_type = _library("dask_jobqueue").SLURMCluster
        settings = _library("dask").config
        if missing := [key for key in ("cores", "memory") if settings.get(f"jobqueue.slurm.{key}", None) is None]:
            raise ModsimError(
                f"Slurm: the configuration of Dask does not say what a job has: set jobqueue.slurm.{missing[0]} in "
                "~/.config/dask/jobqueue.yaml"
            )
        self._cluster = cluster_type(scheduler_options={"dashboard_address": None})
        self._cluster.scale(jobs=jobs)
        super().__init__(self._cluster.scheduler_address)

    def close(self) -> None:
        """End what is handed in, and the jobs."""
        super().close()
        self._cluster.close()


def check_libraries(*names: str) -> None:
    """Check that libraries of clusters are there, without the time to load them; ModsimError if one is not."""
    for name in names:
        if find_spec(name) is None:
            raise ModsimError(_MISSING.format(name))


def _library(name: str = "distributed") -> Any:
    """A library that is no part of the usual installation; ModsimError if it is not there."""
    try:
        library = import_module(name)
    except ImportError as error:
        raise ModsimError(_MISSING.format(error.name)) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what a user needs to know is raised
    return library


def _raise_unless_killed(error: BaseException) -> None:
    """Raise what went wrong with a task as a ModsimError, unless its workers died."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return
    if isinstance(error, ModsimError):
        raise error
    raise ModsimError(f"a Dask worker cannot do a task: {type(error).__name__}: {error}")
