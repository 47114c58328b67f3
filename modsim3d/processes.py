"""Work done in this process or shared between several, with the results in the order of the pieces."""

from __future__ import annotations

import ctypes
import multiprocessing
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from modsim3d.errors import ModsimError

PR_SET_PDEATHSIG = 1  # linux/prctl.h
AHEAD = 3
"""Pieces that may wait for each worker process; it bounds the memory."""

T = TypeVar("T")
P = TypeVar("P")
W = TypeVar("W")
W_co = TypeVar("W_co", covariant=True)


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
    count: int, if_killed: str, set_up: Callable[..., AbstractContextManager[W]], *arguments: Any
) -> AbstractContextManager[Workers[W]]:
    """One worker in this process, or several in processes of their own.

    Args:
        count: Number of workers.
        if_killed: What a user should do if a worker process dies.
        set_up: Opens a worker. Called once in each process with `arguments`, which must be picklable.
        *arguments: Arguments of `set_up`.

    Raises:
        ModsimError: Several workers are asked for, and this process is itself a worker.
    """
    if count > 1 and _made_by_multiprocessing():
        raise ModsimError(
            "workers cannot be started inside a process that multiprocessing made; a script that starts them must do "
            "so under `if __name__ == '__main__':`"
        )
    return _opened(count, if_killed, set_up, *arguments)


@contextmanager
def _opened(
    count: int, if_killed: str, set_up: Callable[..., AbstractContextManager[W]], *arguments: Any
) -> Iterator[Workers[W]]:
    if count == 1:
        with set_up(*arguments) as worker:
            yield _ThisProcess(worker)
        return
    context = multiprocessing.get_context(_start_method())
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_start_worker, initargs=(set_up, *arguments))
    try:
        yield _Processes(pool, count, if_killed)
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class _ThisProcess(Generic[W]):
    worker: W

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        return (work(self.worker, piece) for piece in pieces)


@dataclass(frozen=True)
class _Processes(Generic[W]):
    pool: ProcessPoolExecutor
    count: int
    if_killed: str

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        waiting: deque[Future[T]] = deque()
        for piece in pieces:
            waiting.append(self.pool.submit(_work_here, work, piece))
            if len(waiting) >= self.count * AHEAD:
                yield self._result(waiting.popleft())
        while waiting:
            yield self._result(waiting.popleft())

    def _result(self, future: Future[T]) -> T:
        try:
            return future.result()
        except BrokenProcessPool:
            raise ModsimError(f"a worker process died (killed, or out of memory); {self.if_killed}") from None


_worker: Any = None
"""The worker of this process, or the error that setting it up raised; only worker processes have one."""
_open = ExitStack()


def _start_worker(set_up: Callable[..., AbstractContextManager[Any]], *arguments: Any) -> None:
    """Set up the worker of this process; what it opens lives as long as the process."""
    global _worker
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)  # a killed parent must not leave workers behind
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process tells the user what was interrupted
    try:
        _worker = _open.enter_context(set_up(*arguments))
    except ModsimError as error:
        _worker = error  # raised here it would break the pool, and its message would be lost


def _work_here(work: Callable[[Any, P], T], piece: P) -> T:
    if isinstance(_worker, ModsimError):
        raise _worker
    return work(_worker, piece)


def _made_by_multiprocessing() -> bool:
    """Whether this process is a worker, or one that still imports the script that starts workers."""
    importing = getattr(multiprocessing.current_process(), "_inheriting", False)  # before `parent_process` is set
    return bool(importing) or multiprocessing.parent_process() is not None


def _start_method() -> str:
    """`fork` starts at once, but is safe only while this process has one thread."""
    tasks = Path("/proc/self/task")
    threads = len(list(tasks.iterdir())) if tasks.is_dir() else threading.active_count()
    return "fork" if threads == 1 else "spawn"
