"""Work shared between processes, and taken back in its order."""

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
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from modsim3d.errors import ModsimError

PR_SET_PDEATHSIG = 1  # linux/prctl.h
AHEAD = 3
"""Pieces for each worker that may wait for their turn: it bounds the memory."""

T = TypeVar("T")
P = TypeVar("P")


@contextmanager
def open_pool(count: int, start: Callable[..., None], *arguments: Any) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that are set up once.

    Args:
        count: Number of processes.
        start: Called in each process with the arguments.
        *arguments: For `start`.

    Raises:
        ModsimError: This process is itself a worker.
    """
    if multiprocessing.parent_process() is not None:
        raise ModsimError(
            "workers cannot be started inside a process that multiprocessing made; a script that starts them must do "
            "so under `if __name__ == '__main__':`"
        )
    context = multiprocessing.get_context(_start_method())
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_start_worker, initargs=(start, *arguments))
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def in_order(
    pool: ProcessPoolExecutor, count: int, work: Callable[[P], T], pieces: Iterable[P], died: str
) -> Iterator[T]:
    """What becomes of each piece, in their order; few are under way at a time.

    Args:
        pool: From `open_pool`.
        count: Its number of processes.
        work: Done in them.
        pieces: To be worked on.
        died: What to say if a process dies.

    Raises:
        ModsimError: A process died.
    """
    waiting: deque[Future[T]] = deque()
    for piece in pieces:
        waiting.append(pool.submit(work, piece))
        if len(waiting) >= count * AHEAD:
            yield result_of(waiting.popleft(), died)
    while waiting:
        yield result_of(waiting.popleft(), died)


def result_of(future: Future[T], died: str) -> T:
    """A result, once it is there.

    Raises:
        ModsimError: The process that was to make it died.
    """
    try:
        return future.result()
    except BrokenProcessPool:
        raise ModsimError(f"a worker process died (killed, or out of memory); {died}") from None


def _start_worker(start: Callable[..., None], *arguments: Any) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)  # a killed parent must not leave workers behind
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that they work for says what was interrupted
    start(*arguments)


def _start_method() -> str:
    """A copy of this process starts at once, but is safe only while it has one thread."""
    tasks = Path("/proc/self/task")
    threads = len(list(tasks.iterdir())) if tasks.is_dir() else threading.active_count()
    return "fork" if threads == 1 else "spawn"
