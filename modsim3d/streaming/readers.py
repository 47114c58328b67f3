"""One reader of a stream over TCP: it gets every line in order, and nothing that it sends is read."""

from __future__ import annotations

import socket
import time
from contextlib import suppress

from modsim3d.streaming.backlog import Backlog

SEND_BYTES = 1 << 16
"""What is handed to the system at once, and about what the system keeps of it: the rest waits in the backlog."""

DROP_BYTES, DROP_S = 1 << 16, 0.05
"""How much of what a reader has sent is dropped at once, and how often, so that no sender takes up the processor."""


class ReaderGone(Exception):
    """A reader has closed its connection before it had everything."""


class Reader:
    """A connection that lines are sent to. What it sends stays in its own system's buffers until the stream ends.

    Attributes:
        connection: Its socket, which does not block.
        name: Its address, as messages have it.
        next: Number of the chunk that it gets next.
        leaving: It has everything and was told so; now it is waited for to hang up.
        rests_until: Time of the monotonic clock before which it is not looked at.
    """

    def __init__(self, connection: socket.socket, name: str, header: bytes, first: int) -> None:
        """Begin with the header and chunk `first`."""
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        self.connection, self.name, self.next = connection, name, first
        self.leaving = False
        self.rests_until = 0.0
        self._pending = memoryview(header)
        self._waited_for_since: float | None = None

    def wants(self, backlog: Backlog) -> bool:
        """Whether there is something to send."""
        return bool(self._pending) or self.next < backlog.stop

    def send(self, backlog: Backlog) -> None:
        """Send what its system takes at once.

        Raises:
            ReaderGone: It is not there any more.
        """
        if not self._pending:
            chunks, self.next = backlog.from_number(self.next, SEND_BYTES)
            self._pending = memoryview(chunks)
        try:
            sent = self.connection.send(self._pending)
        except BlockingIOError:
            return
        except OSError:
            raise ReaderGone from None
        self._pending = self._pending[sent:]
        self._waited_for_since = None

    def say_goodbye(self) -> None:
        """Tell it that there is no more.

        Raises:
            ReaderGone: It is not there any more.
        """
        self.leaving = True
        self._waited_for_since = None
        try:
            self.connection.shutdown(socket.SHUT_WR)
        except OSError:
            raise ReaderGone from None

    def has_hung_up(self) -> bool:
        """Whether it has hung up too. What it has sent is dropped: closing over it could cost it the last lines.

        Raises:
            ReaderGone: It closed its connection without reading everything.
        """
        self.rests_until = time.monotonic() + DROP_S
        try:
            ended = not self.connection.recv(DROP_BYTES)
            if ended and self.connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise ReaderGone
        except BlockingIOError:
            return False
        except OSError:
            raise ReaderGone from None
        return ended

    def close(self) -> None:
        """Hang up. What was sent still arrives."""
        with suppress(OSError):  # it is not there any more, or it has sent nothing
            self.connection.shutdown(socket.SHUT_WR)
            self.connection.recv(DROP_BYTES)
        self.connection.close()

    def waited_for_s(self, waits: bool) -> float:
        """How long it has been waited for, to take something or to hang up; `waits` is whether it is at the moment."""
        now = time.monotonic()
        if not waits:
            self._waited_for_since = None
        elif self._waited_for_since is None:
            self._waited_for_since = now
        return now - (self._waited_for_since or now)
