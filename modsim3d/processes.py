"""Work done in this process or shared between several, with the results in the order of the pieces."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import re
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from numbers import Integral
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Generic, Literal, Protocol, TypeVar

from modsim3d.errors import ModsimError

PR_SET_PDEATHSIG = 1  # linux/prctl.h
MOST_WORKERS = 1024
AHEAD = 3
"""Pieces that may wait for each worker process; it bounds the memory."""

T = TypeVar("T")
P = TypeVar("P")
W = TypeVar("W")
W_co = TypeVar("W_co", covariant=True)


_Task = tuple[Future[Any], Callable[[Any, Any], Any], Any]
"""Where the result goes, the work and the piece."""


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
    workers: WorkerCount, if_killed: str, set_up: Callable[..., AbstractContextManager[W]], *arguments: Any
) -> AbstractContextManager[Workers[W]]:
    """One worker in this process, or several in processes of their own.

    Args:
        workers: Number of workers, or `auto`.
        if_killed: What a user should do if a worker process dies.
        set_up: Opens a worker. Called once in each process with `arguments`, which must be picklable.
        *arguments: Arguments of `set_up`.

    Raises:
        ModsimError: This is no number of workers, or there are several and this process is itself a worker.
    """
    count = worker_count(workers)
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
    start = multiprocessing.get_context("fork").Process if _may_fork() else multiprocessing.get_context("spawn").Process
    started = [_WorkerProcess(start, set_up, arguments) for _ in range(count)]  # all before the first thread starts
    processes: _Processes[W] = _Processes(started, if_killed)
    try:
        yield processes
    finally:
        processes.close()


@dataclass(frozen=True)
class _ThisProcess(Generic[W]):
    worker: W

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        return (work(self.worker, piece) for piece in pieces)


class _Processes(Generic[W]):
    """Worker processes, each with a thread here that hands it one piece after another and waits for the result."""

    def __init__(self, processes: list[_WorkerProcess], if_killed: str) -> None:
        self._processes = processes
        self._if_killed = if_killed
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._threads = [threading.Thread(target=self._hand_out, args=(process,)) for process in processes]
        for thread in self._threads:
            thread.start()

    def map(self, work: Callable[[W, P], T], pieces: Iterable[P]) -> Iterator[T]:
        waiting: deque[Future[T]] = deque()
        for piece in pieces:
            waiting.append(Future())
            self._tasks.put((waiting[-1], work, piece))
            if len(waiting) >= len(self._processes) * AHEAD:
                yield self._result(waiting.popleft())
        while waiting:
            yield self._result(waiting.popleft())

    def close(self) -> None:
        """Let the workers end what they have begun, and end them."""
        while not self._tasks.empty():
            self._tasks.get()
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()
        for process in self._processes:
            process.close()

    def _result(self, future: Future[T]) -> T:
        try:
            return future.result()
        except _DiedError:
            raise ModsimError(f"a worker process died (killed, or out of memory); {self._if_killed}") from None

    def _hand_out(self, process: _WorkerProcess) -> None:
        while (task := self._tasks.get()) is not None:
            future, work, piece = task
            try:
                future.set_result(process.do(work, piece))
            except BaseException as error:
                future.set_exception(error)


class _WorkerProcess:
    """A worker in a process of its own.

    Nobody else holds the other end of its pipe, so that the pipe ends when the process dies, whatever it was doing. In
    a queue that several processes share, half a result would be waited for without end.
    """

    def __init__(
        self, start: Callable[..., BaseProcess], set_up: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> None:
        self._pipe, other_end = multiprocessing.Pipe()
        self._process = start(target=_serve, args=(other_end, set_up, arguments), daemon=True)
        self._process.start()
        other_end.close()  # before the next process is forked, which would hold it too

    def do(self, work: Callable[[Any, P], T], piece: P) -> T:
        """Do the work on a piece.

        Raises:
            _DiedError: The process died, now or before.
            BaseException: What the work raised.
        """
        try:
            self._pipe.send((work, piece))
            result, error = self._pipe.recv()
        except (EOFError, OSError) as lost:
            raise _DiedError from lost
        if error is not None:
            raise error
        done: T = result
        return done

    def close(self) -> None:
        """End the process, if it has not died."""
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join()
        self._pipe.close()


class _DiedError(Exception):
    """A worker process died."""


def end_with_parent(parent: int | None = None) -> None:
    """Let the system end this process when its parent ends, however it ends: a killed one must not leave workers.

    Args:
        parent: Number of the parent; if it has ended already, this process ends now.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if parent is not None and os.getppid() != parent:
        os._exit(1)


def _serve(pipe: Connection, set_up: Callable[..., AbstractContextManager[Any]], arguments: tuple[Any, ...]) -> None:
    """Set up the worker of this process, and do what comes through a pipe until None comes."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process tells the user what was interrupted
    with ExitStack() as opened:
        worker, problem = None, None
        try:
            worker = opened.enter_context(set_up(*arguments))
        except ModsimError as error:
            problem = error
        while (task := pipe.recv()) is not None:
            work, piece = task
            _answer(pipe, problem, work, worker, piece)


def _answer(
    pipe: Connection, problem: ModsimError | None, work: Callable[[Any, Any], Any], worker: Any, piece: Any
) -> None:
    """Send a result and no error, or an error with its traceback as a note."""
    try:
        if problem is not None:
            raise problem
        pipe.send((work(worker, piece), None))
    except BaseException as error:
        if not isinstance(error, ModsimError):
            error.add_note("".join(traceback.format_exception(error)))
        pipe.send((None, error))


def _made_by_multiprocessing() -> bool:
    """Whether this process is a worker, or one that still imports the script that starts workers."""
    importing = getattr(multiprocessing.current_process(), "_inheriting", False)  # before `parent_process` is set
    return bool(importing) or multiprocessing.parent_process() is not None


def _may_fork() -> bool:
    """Whether this process has one thread only; a fork starts at once, but is not safe otherwise."""
    tasks = Path("/proc/self/task")
    return (len(list(tasks.iterdir())) if tasks.is_dir() else threading.active_count()) == 1
