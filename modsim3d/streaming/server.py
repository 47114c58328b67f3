"""A stream over TCP: a thread hands the lines to readers, who may be slow, go away, and come back."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

from modsim3d.errors import ModsimError
from modsim3d.streaming.address import Address
from modsim3d.streaming.backlog import Backlog
from modsim3d.streaming.readers import Reader, ReaderGone

BACKLOG_BYTES = 1 << 26
MOST_READERS = 32
PATIENCE = 10
"""Times `wait_s` that a reader may take nothing: systems hand lines over in lumps of 100 kB, so a tracker that needs
half a second for each seems to take nothing for more than a minute."""
RECEIVE_BYTES = 4096
"""What the system takes in of what a reader sends: then the reader waits."""
Tell = Callable[[str], None]


class NobodyReads(Exception):
    """There is no reader, and none has come back in time."""


class LineServer:
    """Sends lines to whoever connects.

    Each reader gets the header, then all lines that are kept, from the oldest on, then the lines as they come. A reader
    that was away connects again and gets the kept lines again. The slowest reader holds the stream up once the lines
    that it has not taken fill the backlog; one that takes nothing for ten times `wait_s` is disconnected.

        with LineServer(Address("127.0.0.1", 0), 60.0, header) as server:
            server.wait_for_reader()
            server.send(line)
            server.finish()

    Attributes:
        address: Where it listens, with the port that was chosen.
        wait_s: How long to wait while there is no reader.
    """

    def __init__(
        self,
        address: Address,
        wait_s: float,
        header: bytes,
        *,
        warn: Tell = lambda text: None,
        tell: Tell = lambda text: None,
        backlog_bytes: int = BACKLOG_BYTES,
    ) -> None:
        """Listen, and serve whoever connects.

        Args:
            address: Where to listen.
            wait_s: How long to wait while there is no reader.
            header: The first line.
            warn: Called, from another thread, with a reader that is disconnected.
            tell: Called, from another thread, with readers that come and go.
            backlog_bytes: Most bytes of lines that are kept.

        Raises:
            ModsimError: The address cannot be used.
        """
        self._listener = address.listen(RECEIVE_BYTES)
        self.address = Address(address.host, self._listener.getsockname()[1])
        self.wait_s, self._header = wait_s, header
        self._warn, self._tell = warn, tell
        self._backlog = Backlog(backlog_bytes)
        self._readers: list[Reader] = []
        self._alone_since = time.monotonic()
        self._came = self._served = 0
        self._ended = self._stopping = False
        self._problem: BaseException | None = None
        self._changed = threading.Condition()
        self._waker, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        for each in (self._listener, self._waker, self._woken):
            each.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._woken, selectors.EVENT_READ, self._wake_up)
        self._thread = threading.Thread(target=self._run, name="modsim3d readers", daemon=True)
        self._thread.start()

    def __enter__(self) -> LineServer:
        """The server."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Hang up, whatever has been taken."""
        with self._changed:
            self._stopping = True
        self._wake()
        self._thread.join()

    def wait_for_reader(self) -> None:
        """Wait until somebody has connected.

        Raises:
            ModsimError: Nobody has.
        """
        with self._changed:
            if not self._wait_until(lambda: self._came > 0):
                raise ModsimError(
                    f"{self.address}: nobody has connected for {self.wait_s:g} s: start the reader, or give --wait"
                )

    def send(self, lines: bytes) -> None:
        """Give lines to all readers; waits while the backlog is full of lines that one of them has yet to take.

        Raises:
            NobodyReads: The backlog is full, and there has been no reader for `wait_s`.
        """
        with self._changed:
            if not self._wait_until(lambda: self._fits(lines)):
                raise NobodyReads
            self._backlog.append(lines)
        self._wake()

    def finish(self, *, come_back: bool = True) -> None:
        """Send the rest, and wait until the readers have hung up.

        Args:
            come_back: If no reader has everything, wait `wait_s` for one to come back.

        Raises:
            NobodyReads: No reader has taken everything.
        """
        with self._changed:
            self._ended = True
            self._wake()
            self._wait_until(lambda: not self._readers and (self._served > 0 or not come_back))
            if not self._served:
                raise NobodyReads

    def _wait_until(self, holds: Callable[[], bool]) -> bool:
        """Wait until something holds; False if there has been no reader for too long."""
        while True:
            if self._problem is not None:
                raise self._problem
            if holds():
                return True
            left = None if self._readers else self._alone_since + self.wait_s - time.monotonic()
            if left is not None and left <= 0:
                return False
            self._changed.wait(left)

    def _fits(self, lines: bytes) -> bool:
        """Whether all that must go for some lines to fit has been taken by all readers, and there is one."""
        kept_from = self._backlog.first + self._backlog.drops(lines)
        if kept_from == self._backlog.first:
            return True
        return bool(self._readers) and all(reader.next >= kept_from for reader in self._readers)

    def _wake(self) -> None:
        with suppress(OSError):  # it has been woken often enough, or has ended
            self._waker.send(b"\0")

    def _run(self) -> None:
        try:
            while not self._stopping:
                with self._changed:
                    timeout = self._prepare()
                    self._changed.notify_all()
                events = self._selector.select(timeout)
                with self._changed:
                    for key, _ in events:
                        key.data()
        except BaseException as problem:
            self._problem = problem
        finally:
            self._close()

    def _prepare(self) -> float | None:
        """Ask the system for what each reader is waited for, and disconnect those who are waited for too long.

        Returns:
            How long nothing need be done unless something happens.
        """
        timeouts = [self._prepared(reader) for reader in list(self._readers)]
        return min((each for each in timeouts if each is not None), default=None)

    def _prepared(self, reader: Reader) -> float | None:
        """How long nothing need be done for a reader; None if that depends on others."""
        if self._ended and not reader.leaving and not reader.wants(self._backlog):
            self._attempt(reader, reader.say_goodbye)
        if reader not in self._readers:
            return None
        waits = reader.leaving or reader.wants(self._backlog)
        left = PATIENCE * self.wait_s - reader.waited_for_s(waits)
        if left <= 0:
            self._give_up(reader)
            return None
        rest = reader.rests_until - time.monotonic()
        self._watch(reader, waits and rest <= 0)
        if not waits:
            return None
        return min(left, rest) if rest > 0 else left

    def _watch(self, reader: Reader, waits: bool) -> None:
        wanted = selectors.EVENT_READ if reader.leaving else selectors.EVENT_WRITE
        registered = self._selector.get_map().get(reader.connection)
        if registered is not None and (not waits or registered.events != wanted):
            self._selector.unregister(reader.connection)
            registered = None
        if waits and registered is None:
            self._selector.register(reader.connection, wanted, lambda: self._serve(reader))

    def _serve(self, reader: Reader) -> None:
        if not reader.leaving:
            self._attempt(reader, lambda: reader.send(self._backlog))
        elif self._attempt(reader, reader.has_hung_up):
            self._served += 1
            self._remove(reader, "has everything")

    def _attempt(self, reader: Reader, action: Callable[[], bool | None]) -> bool:
        try:
            return bool(action())
        except ReaderGone:
            self._remove(reader, "has gone")
            return False

    def _give_up(self, reader: Reader) -> None:
        if reader.leaving:  # the system delivers the rest
            self._served += 1
            self._remove(reader, "has not hung up")
            return
        self._remove(reader, "is disconnected")
        self._warn(f"reader {reader.name} has taken nothing for {PATIENCE * self.wait_s:g} s, and is disconnected")

    def _remove(self, reader: Reader, why: str) -> None:
        self._readers.remove(reader)
        self._alone_since = time.monotonic()
        if reader.connection in self._selector.get_map():
            self._selector.unregister(reader.connection)
        reader.close()
        self._tell(f"{reader.name} {why}")

    def _accept(self) -> None:
        try:
            connection, place = self._listener.accept()
        except (BlockingIOError, ConnectionError):  # it has gone already
            return
        name = f"{place[0]} port {place[1]}"
        if len(self._readers) == MOST_READERS:
            connection.close()
            self._warn(f"reader {name} is turned away: there are {MOST_READERS} already")
            return
        try:
            reader = Reader(connection, name, self._header, self._backlog.first)
        except OSError:  # some systems set nothing on a connection that has ended
            connection.close()
            return
        self._readers.append(reader)
        self._came += 1
        self._tell(f"{name} has connected")

    def _wake_up(self) -> None:
        self._woken.recv(4096)

    def _close(self) -> None:
        with self._changed:
            for reader in list(self._readers):
                self._remove(reader, "is disconnected")
            self._changed.notify_all()
        for each in (self._selector, self._listener, self._waker, self._woken):
            each.close()
