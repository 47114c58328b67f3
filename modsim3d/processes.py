"""Work done in this process or shared between several, with the results in the order of the pieces."""

from __future__ import annotations

import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from numbers import Integral
from queue import Empty, SimpleQueue
from typing import Any, Generic, Literal, Protocol, TypeVar

from modsim3d.errors import ModsimError
from modsim3d.worker_process import DiedError, Task, WorkerProcess, may_fork

MOST_WORKERS = 1024
AHEAD = 3
"""Pieces that may wait for each worker; it bounds the memory."""

T = TypeVar("T")
P = TypeVar("P")
W = TypeVar("W")
W_co = TypeVar("W_co", covariant=True)


WorkerCount = int | Literal["auto"]
"""Number of worker processes; `auto`: one for each CPU that this process may use."""


def worker_count(workers: WorkerCount, name: str = "workers") -> int:
    """The number of workers that is asked for; `name` is what an error calls it.

    Raises:
        ModsimError: It is neither such a number nor `auto`.
    """
    if isinstance(workers, str) and workers == "auto":
        return min(_usable_cpus(), MOST_WORKERS)
    if isinstance(workers, Integral) and not isinstance(workers, bool) and 1 <= workers <= MOST_WORKERS:
        return int(workers)
    shown = repr(workers)[:60]
    raise ModsimError(f"{name}: needs a number of processes from 1 to {MOST_WORKERS}, or 'auto' (got {shown})")


def parse_workers(text: str) -> WorkerCount:
    """The value of the option `--workers`.

    Raises:
        ModsimError: It is neither a number of workers nor `auto`.
    """
    value: Any = int(text) if re.fullmatch("[0-9]{1,9}", text) else text
    worker_count(value, "--workers")
    return value  # type: ignore[no-any-return]


def _usable_cpus() -> int:
    """The number of CPUs that this process may use."""
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers(Protocol[W_co]):
    """One or several workers of one type, each in a process of its own or the only one in this process."""

    def map(self, work: Callable[[W_co, P], T], pieces: Iterable[P]) -> Iterator[T]:
        """Do the work on each piece, and give the results in the order of the pieces.

        Args:
            work: Called with a worker and a piece. Other processes must be able to import it.
            pieces: A few are taken ahead of the results.

        Raises:
            ModsimError: A worker process could not be set up, or died.
        """


def open_workers(
    workers: WorkerCount,
    if_killed: str,
    set_up: Callable[..., AbstractContextManager[W]],
    *arguments: Any,
    here_too: bool = False,
) -> AbstractContextManager[Workers[W]]:
    """One worker in this process, or several in processes of their own.

    Args:
        workers: Number of workers, or `auto`.
        if_killed: What a user should do if a worker process dies.
        set_up: Opens a worker. Called once in each process with `arguments`, which must be picklable.
        *arguments: Arguments of `set_up`.
        here_too: Of several workers, one is in this process and works while it waits for the others.

    Raises:
        ModsimError: This is no number of workers.
    """
    return _opened(worker_count(workers), if_killed, set_up, arguments, here_too)


@contextmanager
def _opened(
    count: int,
    if_killed: str,
    set_up: Callable[..., AbstractContextManager[W]],
    arguments: tuple[Any, ...],
    here_too: bool,
) -> Iterator[Workers[W]]:
    if count == 1:
        with set_up(*arguments) as worker:
            yield _ThisProcess(worker)
        return
    fork = may_fork()
    started = [WorkerProcess(fork, set_up, arguments) for _ in range(count - here_too)]  # before the first thread
    processes: _Processes[W] = _Processes(started, count, if_killed)
    try:
        with ExitStack() as opened:
            if here_too:
                processes.work_here(opened.enter_context(set_up(*arguments)))
            yield processes
    finally:
        processes.close()


@dataclass(frozen=True)
class _ThisProcess(Generic[W]):
    worker: W

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        return (work(self.worker, piece) for piece in pieces)


class _Processes(Generic[W]):
    """Worker processes, each with a thread here that hands it pieces and waits for the results."""

    def __init__(self, processes: list[WorkerProcess], workers: int, if_killed: str) -> None:
        self._processes = processes
        self._if_killed = if_killed
        self._most_waiting = workers * AHEAD
        self._do_here: Callable[[Task | None], None] | None = None
        self._tasks: SimpleQueue[Task | None] = SimpleQueue()
        self._threads = [threading.Thread(target=process.do_all, args=(self._tasks, workers)) for process in processes]
        for thread in self._threads:
            thread.start()

    def work_here(self, worker: W) -> None:
        """Let this process do pieces too, with a worker of its own, while it waits for a result."""
        self._do_here = partial(_do, worker)

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        waiting: deque[Future[T]] = deque()
        for piece in pieces:
            waiting.append(Future())
            self._tasks.put((waiting[-1], work, piece))
            if len(waiting) >= self._most_waiting:
                yield self._result(waiting.popleft())
        while waiting:
            yield self._result(waiting.popleft())

    def close(self) -> None:
        """Let the workers end what they do now, and end them."""
        with suppress(Empty):
            while True:
                self._tasks.get_nowait()
        for process in self._processes:
            process.stop()
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def _result(self, future: Future[T]) -> T:
        with suppress(Empty):
            while self._do_here is not None and not future.done():
                self._do_here(self._tasks.get_nowait())
        try:
            return future.result()
        except DiedError:
            raise ModsimError(f"a worker process died (killed, or out of memory); {self._if_killed}") from None


def _do(worker: Any, task: Task | None) -> None:
    assert task is not None  # it comes only after all tasks
    future, work, piece = task
    try:
        future.set_result(work(worker, piece))
    except Exception as error:
        future.set_exception(error)
