"""What runs in a Dask worker: it hands tasks to one process of its own, one after the other.

The process of the Dask worker itself makes no run. So a run that ends its process does not end the Dask worker, with
which Dask would suspect and repeat the tasks that wait there; and the Dask worker answers its scheduler at any time.
This module imports little, because every Dask worker imports it.
"""

from __future__ import annotations

import pickle
import threading
from concurrent.futures import Future
from functools import cache
from queue import SimpleQueue
from typing import Any

from modsim3d.campaign.engines.death import LOST
from modsim3d.campaign.engines.worker_process import ProcessDiedError, WorkerProcess


def work_on(campaign: str, task: bytes) -> Any:
    """Do a task.

    Args:
        campaign: Key of the engine that handed it in.
        task: The pickled task.

    Returns:
        Its report, or how its process died.

    Raises:
        ModsimError: A process could not start, or the task cannot be done here.
    """
    return _hands().do(campaign, task)


def give_up(campaign: str) -> None:
    """Do no more tasks of a campaign, end the one that is being done, and end the process."""
    _hands().give_up(campaign)


class _Hands:
    """One process and the thread that talks to it: one task at a time, however many threads the Dask worker has.

    The system ends the process when the thread that started it ends, and threads of a Dask worker may end. This one
    lasts as long as the Dask worker, and does not keep it from ending.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Future[Any], str, bytes | None]] = SimpleQueue()
        self._lock = threading.Lock()
        self._process: WorkerProcess | None = None
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
                self._process = WorkerProcess()
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
        """End the process."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()


_making = threading.Lock()


def _hands() -> _Hands:
    with _making:
        return _only_hands()


@cache
def _only_hands() -> _Hands:
    return _Hands()
