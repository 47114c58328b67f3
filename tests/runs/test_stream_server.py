"""Readers over TCP that are slow, gone, back, or send: each line that one can still get arrives, once and in order."""

import errno
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.runs import stream_server as server_module
from modsim3d.runs.stream_lines import Address
from modsim3d.runs.stream_server import LineServer, NoReader, Reader, ReaderLoss

LONG_S = 120.0  # what no test waits for unless something is wrong
HEADER = b"header\n"
LINES = [b"%d %s\n" % (number, b"x" * 500) for number in range(6000)]  # 3 MB: more than the buffers of two sockets


def serve(wait_s: float = LONG_S, **options: object) -> LineServer:
    return LineServer(Address("127.0.0.1", 0), wait_s, HEADER, **options)  # type: ignore[arg-type]


def connect(server: LineServer, *, small: bool = False) -> socket.socket:
    """A reader, once the server knows that somebody has come."""
    reader = socket.socket()
    reader.settimeout(LONG_S)
    if small:
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    reader.connect((server.address.host, server.address.port))
    server.wait_for_reader()
    return reader


def rest_of(reader: socket.socket) -> list[bytes]:
    with closing(reader), reader.makefile("rb") as lines:
        return list(lines)


class Background(threading.Thread):
    """Calls a function in a thread; `result` waits for it."""

    def __init__(self, call: Callable[[], object]) -> None:
        super().__init__(daemon=True)
        self._call, self._found = call, None
        self.start()

    def run(self) -> None:
        try:
            self._found = self._call()
        except BaseException as error:
            self._found = error

    def result(self) -> object:
        self.join(LONG_S)
        assert not self.is_alive()
        return self._found


@pytest.fixture(autouse=True)
def nothing_stays_open() -> Iterator[None]:
    before = len([*Path("/dev/fd").iterdir()]), threading.active_count()
    yield
    assert (len([*Path("/dev/fd").iterdir()]), threading.active_count()) == before


def send_all(server: LineServer, lines: list[bytes] = LINES) -> None:
    for line in lines:
        server.send(line)


def test_two_readers_get_every_line_and_the_slowest_holds_the_stream_up():
    with serve() as server:
        first = Background(lambda: rest_of(connect(server)))
        server.wait_for_reader()
        send_all(server, LINES[:3000])
        late = Background(lambda: rest_of(connect(server, small=True)))
        send_all(server, LINES[3000:])
        server.finish()
        assert first.result() == late.result() == [HEADER, *LINES]
    with serve(backlog_bytes=10_000) as server:
        slow, fast = connect(server, small=True), Background(lambda: rest_of(connect(server)))
        sending = Background(lambda: (send_all(server), server.finish()))
        first = slow.recv(len(HEADER), socket.MSG_WAITALL)
        assert sending.is_alive(), "3 MB fit into no buffer"
        assert [first, *rest_of(slow)] == [HEADER, *LINES]
        assert sending.result() == (None, None)
        header, *received = fast.result()
        assert header == HEADER and received == LINES[len(LINES) - len(received) :]


def test_what_is_kept_is_bounded_and_a_reader_that_comes_back_gets_it_from_the_oldest_line() -> None:
    with serve(backlog_bytes=100_000) as server:
        stays = Background(lambda: rest_of(connect(server)))
        leaves = connect(server)
        send_all(server, LINES[:100])
        with leaves.makefile("rb") as lines:
            assert [next(lines) for _ in range(51)] == [HEADER, *LINES[:50]]
        leaves.close()
        send_all(server, LINES[100:5900])
        back = connect(server)
        with back.makefile("rb") as lines:
            assert next(lines) == HEADER
            oldest = LINES.index(next(lines))
        assert 100 < oldest <= 5900
        send_all(server, LINES[5900:])
        back.close()
        server.finish()
        assert stays.result()[-1] == LINES[-1]


def test_a_reader_that_takes_nothing_is_disconnected_and_one_that_crashed_gets_all_when_it_is_back():
    said: list[str] = []
    with serve(warn=said.append, backlog_bytes=10_000) as server, closing(connect(server, small=True)):
        server.wait_s = 0.03
        with pytest.raises(NoReader):
            send_all(server)
            server.finish()
    assert len(said) == 1 and "has taken nothing for 0.3 s, and is disconnected" in said[0]
    gone = threading.Event()
    with serve(tell=lambda text: gone.set() if text.endswith("has gone") else None) as server:
        crashed = connect(server)
        send_all(server, LINES[:100])
        crashed.recv(1000)
        ending = Background(server.finish)
        crashed.close()  # with lines unread: the system tells the sender
        assert gone.wait(LONG_S)
        assert rest_of(connect(server)) == [HEADER, *LINES[:100]] and ending.result() is None


def test_a_stream_that_nobody_takes_ends_and_hanging_up_early_ends_it_at_once():
    with serve() as server:
        connect(server).close()
        server.wait_s = 0.05
        with pytest.raises(NoReader):
            send_all(server)
            server.finish()
    with serve(0.05) as server, pytest.raises(ModsimError, match=r"nobody has connected for 0\.05 s"):
        server.wait_for_reader()
    with serve() as server:
        reader = connect(server)
        send_all(server, LINES[:10])
        first = reader.recv(8, socket.MSG_PEEK)
    assert first and rest_of(reader)[0] == HEADER


def test_what_a_reader_sends_is_never_taken_in_and_an_end_with_lines_on_the_way_is_none():
    with serve() as server:
        reader = connect(server)
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        pushing = Background(lambda: reader.sendall(b"GET / HTTP/1.1\r\n" * 20_000))
        reading = Background(lambda: rest_of(reader))
        send_all(server)
        assert pushing.is_alive(), "320 kB were taken in"
        server.finish()
        assert reading.result() == [HEADER, *LINES]
        pushing.result()

    class Ended(socket.socket):
        """A connection that the other side has closed, and then refused what was still sent."""

        def recv(self, *sizes: int) -> bytes:
            return b""

        def getsockopt(self, *options: int) -> int:  # type: ignore[override]
            return errno.EPIPE

    with socket.create_server(("127.0.0.1", 0)) as listener, closing(Ended()) as connection:
        connection.connect(listener.getsockname())
        with pytest.raises(ReaderLoss):
            Reader(connection, "it", HEADER, 0).has_hung_up()


def test_a_reader_that_sends_after_the_last_line_or_ends_its_own_side_first_still_gets_all_lines() -> None:
    with serve() as server:
        reader = connect(server, small=True)
        send_all(server, LINES[:100])
        ending = Background(server.finish)
        for _ in range(3):  # a closed connection would answer with a reset, which costs it what it has not read
            reader.sendall(b"more, please\n")
            time.sleep(0.1)
        assert rest_of(reader) == [HEADER, *LINES[:100]] and ending.result() is None
    with serve() as server:  # as `nc -N` does with an empty standard input
        reader = connect(server)
        reader.shutdown(socket.SHUT_WR)
        reading = Background(lambda: rest_of(reader))
        send_all(server)
        server.finish()
        assert reading.result() == [HEADER, *LINES]


def test_one_reader_too_many_is_turned_away_and_a_fault_in_the_thread_ends_the_stream(monkeypatch):
    monkeypatch.setattr(server_module, "MAX_READERS", 1)
    said: list[str] = []
    with serve(warn=said.append) as server:
        first = Background(lambda: rest_of(connect(server)))
        server.wait_for_reader()
        assert rest_of(connect(server)) == []
        server.finish()
        assert first.result() == [HEADER]
    assert len(said) == 1 and "turned away: there are 1 already" in said[0]

    def broken(*arguments: object) -> None:
        raise OSError("too many open files")

    monkeypatch.setattr(LineServer, "_wake_up", broken)
    with serve() as server:
        server.send(LINES[0])
        with pytest.raises(OSError, match="too many open files"):
            server.wait_for_reader()
