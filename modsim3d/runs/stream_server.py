"""A stream over TCP: a thread hands the lines to readers, who may be slow, go away, and come back."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType

from modsim3d.core.errors import ModsimError
from modsim3d.runs.stream_lines import Address


class Backlog:
    """The latest chunks of a stream, counted from the stream's beginning; old ones make room for new ones. `first` is
    the number of the oldest chunk that is kept."""

    def __init__(self, most_bytes: int) -> None:
        """Start empty. `most_bytes` is kept at most, or a single chunk that is larger."""
        self.first = 0
        self._chunks: deque[bytes] = deque()
        self._most, self._bytes = most_bytes, 0

    @property
    def stop(self) -> int:
        """The number that the next chunk gets."""
        return self.first + len(self._chunks)

    def drops(self, chunk: bytes) -> int:
        """Number of the oldest chunks that must go before a chunk fits."""
        excess, count = self._bytes + len(chunk) - self._most, 0
        for kept in self._chunks:
            if excess <= 0:
                break
            excess, count = excess - len(kept), count + 1
        return count

    def append(self, chunk: bytes) -> None:
        """Keep a chunk, and drop the oldest ones that it leaves no room for."""
        for _ in range(self.drops(chunk)):
            self._bytes -= len(self._chunks.popleft())
            self.first += 1
        self._chunks.append(chunk)
        self._bytes += len(chunk)

    def from_number(self, number: int, least_bytes: int) -> tuple[bytes, int]:
        """Chunks from a number that is kept, joined, and the number after them; as many as reach `least_bytes`."""
        taken, size = [], 0
        while number < self.stop and size < least_bytes:
            taken.append(self._chunks[number - self.first])
            size += len(taken[-1])
            number += 1
        return b"".join(taken), number


SEND_BYTES = 1 << 16  # handed to the system at once, and about what it keeps: the rest waits in the backlog

DROP_BYTES, DROP_S = 1 << 16, 0.05  # what a reader has sent is dropped in such pieces, so often, to spare the processor


class ReaderLoss(Exception):
    """A reader has closed its connection before it had everything."""


class Reader:
    """A connection that lines are sent to. What it sends stays in its own system's buffers until the stream ends."""

    def __init__(self, connection: socket.socket, name: str, header: bytes, first: int) -> None:
        """Begin with the header and chunk `first`; messages have the address of the reader as `name`."""
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        self.connection, self.name, self.next = connection, name, first  # the chunk that it gets next
        self.leaving = False  # it has everything and was told so; now it is waited for to hang up
        self.rests_until = 0.0  # time of the monotonic clock before which it is not looked at
        self._pending = memoryview(header)
        self._waited_for_since: float | None = None

    def wants(self, backlog: Backlog) -> bool:
        """Whether there is something to send."""
        return bool(self._pending) or self.next < backlog.stop

    def send(self, backlog: Backlog) -> None:
        """Send what its system takes at once. Raises ReaderLoss if it is not there any more."""
        if not self._pending:
            chunks, self.next = backlog.from_number(self.next, SEND_BYTES)
            self._pending = memoryview(chunks)
        try:
            sent = self.connection.send(self._pending)
        except BlockingIOError:
            return
        except OSError:
            raise ReaderLoss from None
        self._pending = self._pending[sent:]
        self._waited_for_since = None

    def say_goodbye(self) -> None:
        """Tell it that there is no more. Raises ReaderLoss if it is not there any more."""
        self.leaving = True
        self._waited_for_since = None
        try:
            self.connection.shutdown(socket.SHUT_WR)
        except OSError:
            raise ReaderLoss from None

    def has_hung_up(self) -> bool:
        """Whether it has hung up too. What it has sent is dropped: closing over it could cost it the last lines. Raises
        ReaderLoss if it closed its connection without reading everything."""
        self.rests_until = time.monotonic() + DROP_S
        try:
            ended = not self.connection.recv(DROP_BYTES)
            if ended and self.connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise ReaderLoss
        except BlockingIOError:
            return False
        except OSError:
            raise ReaderLoss from None
        return ended

    def close(self) -> None:
        """Hang up. What was sent still arrives."""
        with suppress(OSError):  # it is not there any more, or it has sent nothing
            self.connection.shutdown(socket.SHUT_WR)
            self.connection.recv(DROP_BYTES)
        self.connection.close()

    def waited_for_s(self, waits: bool) -> float:
        """Time for which it has been waited for, to take something or to hang up; `waits` is whether it is now."""
        now = time.monotonic()
        if not waits:
            self._waited_for_since = None
        elif self._waited_for_since is None:
            self._waited_for_since = now
        return now - (self._waited_for_since or now)


BACKLOG_BYTES = 1 << 26
MAX_READERS = 32
PATIENCE = 10
"""Times `wait_s` that a reader may take nothing: systems hand lines over in lumps of 100 kB, so a tracker that needs
half a second for each seems to take nothing for more than a minute."""
RECEIVE_BYTES = 4096  # what the system takes in of what a reader sends: then the reader waits
Tell = Callable[[str], None]


class NoReader(Exception):
    """There is no reader, and none has come back in time."""


class LineServer:
    """Sends lines to whoever connects.

        with LineServer(Address("127.0.0.1", 0), 60.0, header) as server:
            server.wait_for_reader()
            server.send(line)
            server.finish()

    Each reader gets the header, then all lines that are kept, from the oldest on, then the lines as they come. A reader
    that was away connects again and gets the kept lines again. The slowest reader holds the stream up once the lines
    that it has not taken fill the backlog; one that takes nothing for ten times `wait_s` is disconnected."""

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
        """Listen at `address`, whose port 0 is any free one, and serve whoever connects; `header` is the first line.
        `wait_s` is how long to wait while there is no reader. Another thread calls `warn` with a reader that is
        disconnected, and `tell` with readers that come and go. Lines are kept up to `backlog_bytes`. Raises
        ModsimError if the address cannot be used."""
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
        for endpoint in (self._listener, self._waker, self._woken):
            endpoint.setblocking(False)
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
        """Wait until somebody has connected. Raises ModsimError if nobody has."""
        with self._changed:
            if not self._wait_until(lambda: self._came > 0):
                raise ModsimError(
                    f"{self.address}: nobody has connected for {self.wait_s:g} s: start the reader, or give --timeout"
                )

    def send(self, lines: bytes) -> None:
        """Give lines to all readers; waits while the backlog is full of lines that one of them has yet to take. Raises
        NoReader if the backlog is full, and there has been no reader for `wait_s`."""
        with self._changed:
            if not self._wait_until(lambda: self._fits(lines)):
                raise NoReader
            self._backlog.append(lines)
        self._wake()

    def finish(self, *, come_back: bool = True) -> None:
        """Send the rest, and wait until the readers have hung up. If no reader has everything and `come_back` is set,
        wait `wait_s` for one to come back. Raises NoReader if no reader has taken everything."""
        with self._changed:
            self._ended = True
            self._wake()
            self._wait_until(lambda: not self._readers and (self._served > 0 or not come_back))
            if not self._served:
                raise NoReader

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
                    timeouts = [self._prepared(reader) for reader in list(self._readers)]
                    self._changed.notify_all()
                events = self._selector.select(min((wait for wait in timeouts if wait is not None), default=None))
                with self._changed:
                    for key, _ in events:
                        key.data()
        except BaseException as problem:
            self._problem = problem
        finally:
            self._close()

    def _prepared(self, reader: Reader) -> float | None:
        """Ask the system for what a reader is waited for, or disconnect it if it is waited for too long; the time in
        which nothing need be done for it, None if that depends on others."""
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
        except ReaderLoss:
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
        if len(self._readers) == MAX_READERS:
            connection.close()
            self._warn(f"reader {name} is turned away: there are {MAX_READERS} already")
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
        for resource in (self._selector, self._listener, self._waker, self._woken):
            resource.close()
