"""Commands that clean up when the system tells them to stop."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALED = 128
"""The exit status of a process that a signal has ended is this and the signal's number."""


class Stopped(KeyboardInterrupt):
    """The process was told to stop by a signal; `status` is its exit status."""

    def __init__(self, number: int) -> None:
        """Keep the signal's number as the exit status."""
        super().__init__()
        self.status = SIGNALED + number


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise `Stopped`, as Ctrl-C raises KeyboardInterrupt, where they would end the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    owner = os.getpid()

    def stop(number: int, frame: FrameType | None) -> None:
        if os.getpid() != owner:  # a worker, which has nothing to clean up
            os._exit(SIGNALED + number)
        raise Stopped(number)

    ending = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) is signal.SIG_DFL]
    for number in ending:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in ending:
            signal.signal(number, signal.SIG_DFL)
