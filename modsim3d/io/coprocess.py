"""A program that answers lines on its standard input by lines on its standard output, one by one."""

from __future__ import annotations

import os
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from modsim3d.core.errors import ModsimError

MAX_LINE_BYTES = 64 << 20
_CHUNK = 1 << 16
_LAST_BYTES, _LAST_LINES = 4096, 8
"""How much of standard error is kept, and how many of its lines an error has."""
_END_S = 5.0
"""Time that a program has to end once its output has ended, before it is killed."""

SUPERVISOR = """\
import _thread, os, signal, sys, time
from contextlib import suppress
life, linux = int(sys.argv[1]), sys.platform == "linux"
if linux:
    import ctypes
    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER: whoever loses its parent becomes a child of this
child = os.fork()
if not child:
    os.close(life)
    os.setpgid(0, 0)
    with suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("1000")  # where memory is short, the system ends the program and not who asks it
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execv(sys.argv[2], sys.argv[3:])
    except OSError as error:
        os.write(2, (error.strerror or "cannot be run").encode())
        os._exit(127)
for number in range(3):
    os.close(number)
def wait_for_children():
    with suppress(OSError):  # there are none, or nobody listens
        while True:
            number, status, used = os.wait4(-1, 0)
            if number == child:
                os.write(life, f"{status} {used.ru_maxrss}".encode())
def children():
    for name in filter(str.isdigit, os.listdir("/proc")):
        with suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:  # unless it has ended
            state, parent = file.read().rpartition(b")")[2].split()[:2]
            if int(parent) == os.getpid() and state != b"Z":
                yield int(name)
_thread.start_new_thread(wait_for_children, ())
with suppress(OSError):  # the end of the program was not read
    os.read(life, 1)
with suppress(OSError):
    os.killpg(child, signal.SIGKILL)
until = time.monotonic() + 4
while linux and time.monotonic() < until and (left := list(children())):
    for each in left:
        with suppress(OSError):  # it has ended
            os.kill(each, signal.SIGKILL)
    time.sleep(0.002)
os._exit(0)
"""
"""Starts the program in its own group of processes and reports how it ended. A socket tells it when its parent is gone,
also one that was killed; then it ends the group, and on Linux all that the program started, wherever that is."""


class CoprocessError(ModsimError):
    """A program that stalled, ended or said too much: the problem, and its last lines of standard error."""

    def __init__(self, problem: str, said: str = "") -> None:
        """Join both into the message."""
        super().__init__(f"{problem}; standard error: {said}" if said else problem)
        self.problem, self.said = problem, said


class Coprocess:
    """A program with a group of processes of its own, none of which outlives this process or the block it is used
    in."""

    def __init__(self, program: str, command: Sequence[str], folder: Path, timeout_s: float) -> None:
        """Start a file as a program with arguments, the first of which is its name, in a folder. It has `timeout_s`
        seconds for each answer."""
        self.seconds = 0.0  # from the last line that it was sent to the end of its answer
        self.peak_memory_mb: float | None = None  # MB of 2²⁰ bytes, once it has ended by itself
        self._timeout_s = timeout_s
        self._life, other_end = socket.socketpair()
        pipe = subprocess.PIPE
        with other_end:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", SUPERVISOR, str(other_end.fileno()), program, *command],
                **{"stdin": pipe, "stdout": pipe, "stderr": pipe, "bufsize": 0},  # type: ignore[call-overload]
                pass_fds=[other_end.fileno()],
                cwd=folder,
                process_group=0,  # so that Ctrl-C reaches it through this process only
            )
        self._asked = memoryview(b"")
        self._said, self._errors = bytearray(), bytearray()
        self._line_end, self._ended = -1, False  # place of the first line end in what it said
        self._selector = selectors.DefaultSelector()
        for pipe, take in ((self._process.stdout, self._take_answer), (self._process.stderr, self._take_error)):
            self._register(pipe.fileno(), selectors.EVENT_READ, take)
        os.set_blocking(self._process.stdin.fileno(), False)

    def __enter__(self) -> Self:
        """The program."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End the program and all that it started."""
        self._selector.close()
        self._life.close()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            with suppress(OSError):
                pipe.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def ask(self, line: bytes) -> bytes:
        """Send a line and wait for the next one of the program, both with their ends; one that came early, which only
        chance tells from others, is the answer too. Raises CoprocessError if it ends or is not done in time."""
        began, self._asked = time.perf_counter(), memoryview(line)
        self._register(self._process.stdin.fileno(), selectors.EVENT_WRITE, self._give)
        self._wait(
            lambda: (self._line_end >= 0 and not self._asked) or self._ended, f"no answer within {self._timeout_s:g} s"
        )
        self.seconds = time.perf_counter() - began
        if self._line_end < 0:
            raise self.error(self._end())
        answer = bytes(self._said[: self._line_end + 1])
        del self._said[: self._line_end + 1]
        self._line_end = self._said.find(b"\n")
        return answer

    def finish(self) -> None:
        """Tell the program that nothing more comes, and wait for its end. Raises CoprocessError if it does not end in
        time, or ends otherwise than with status 0, or says more."""
        self._unregister(self._process.stdin.fileno())
        self._process.stdin.close()
        self._wait(lambda: self._ended, f"did not end within {self._timeout_s:g} s after the end of its input")
        said = self._end()
        if self._said:
            raise self.error(f"it wrote more than was asked: {shown_line(bytes(self._said))}")
        if said != "it ended with status 0":
            raise self.error(f"{said} after the end of its input")

    def error(self, text: str) -> CoprocessError:
        """The error of a problem, with the last lines that the program wrote to standard error."""
        with suppress(OSError):
            self._take_error()  # what has come meanwhile
        lines = bytes(self._errors).decode("utf-8", "replace").splitlines()[-_LAST_LINES:]
        last = [plain for line in lines if (plain := "".join(each for each in line if each.isprintable()).strip())]
        return CoprocessError(text, " | ".join(last))

    def _wait(self, done: Callable[[], bool], late: str) -> None:
        until = time.monotonic() + self._timeout_s
        while not done():
            left_s = until - time.monotonic()
            if left_s <= 0:
                raise self.error(late)
            for key, _ in self._selector.select(left_s):
                key.data()
            if len(self._said) > MAX_LINE_BYTES:
                raise self.error(f"a line of more than {MAX_LINE_BYTES >> 20} MB")

    def _register(self, number: int, events: int, take: Callable[[], None]) -> None:
        os.set_blocking(number, False)
        if number not in self._selector.get_map():
            self._selector.register(number, events, take)

    def _unregister(self, number: int) -> None:
        if number in self._selector.get_map():
            self._selector.unregister(number)

    def _give(self) -> None:
        number = self._process.stdin.fileno()
        try:
            self._asked = self._asked[os.write(number, self._asked[:_CHUNK]) :]
        except BlockingIOError:
            return
        except OSError:  # it reads no more: how it ended is known when its output has ended
            self._asked = memoryview(b"")
        if not self._asked:
            self._unregister(number)

    def _take_answer(self) -> None:
        number = self._process.stdout.fileno()
        more = os.read(number, _CHUNK)
        if not more:
            self._unregister(number)
            self._ended = True
        if self._line_end < 0 and (place := more.find(b"\n")) >= 0:
            self._line_end = len(self._said) + place
        self._said += more

    def _take_error(self) -> None:
        number = self._process.stderr.fileno()
        if not (more := os.read(number, _CHUNK)):
            self._unregister(number)
        self._errors += more
        del self._errors[:-_LAST_BYTES]

    def _end(self) -> str:
        """End of the program in words; it is waited for, for a while."""
        self._life.settimeout(min(_END_S, self._timeout_s))
        try:
            status, used = map(int, self._life.recv(64).split())
        except (OSError, ValueError):
            return "it closed its output"
        self.peak_memory_mb = used / (1 << 20 if sys.platform == "darwin" else 1 << 10)
        code = os.waitstatus_to_exitcode(status)
        if code >= 0:
            return f"it ended with status {code}"
        named = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"{named} ended it"


def shown_line(line: bytes) -> str:
    """A line that a program wrote, cut and without control characters, in quotation marks."""
    text = line.decode("utf-8", "replace").split("\n")[0]
    plain = "".join(each if each.isprintable() else "?" for each in text)
    return f"'{plain[:80]}{'…' if len(plain) > 80 else ''}'"
