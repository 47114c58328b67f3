"""A program that answers lines on its standard input by lines on its standard output, one by one."""

import selectors
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import RawIOBase
from pathlib import Path
from types import TracebackType
from typing import Self

from modsim3d.core.errors import ModsimError
from modsim3d.io.operating_system import Program

MAX_LINE_BYTES = 64 << 20
_CHUNK = 1 << 16
_LAST_BYTES, _LAST_LINES = 4096, 8  # how much of standard error is kept, and how many of its lines an error has
_END_S = 5.0  # time that a program has to end once its output has ended


class CoprocessError(ModsimError):
    """A program that stalled, ended or said too much: the problem, and its last lines of standard error."""

    def __init__(self, problem: str, stderr: str = "") -> None:
        """Join both into the message."""
        super().__init__(f"{problem}; standard error: {stderr}" if stderr else problem)
        self.problem, self.stderr = problem, stderr


class Coprocess:
    """A program with a group of processes of its own, none of which outlives this process or the `with` block."""

    def __init__(self, program: str, command: Sequence[str], folder: Path, timeout_s: float) -> None:
        """Start a file as a program with arguments, the first of which is its name, in a folder. It has `timeout_s`
        seconds for each answer."""
        self.seconds = 0.0  # from the last line that it was sent to the end of its answer
        self.peak_memory_mb: float | None = None  # MB of 2²⁰ bytes, once it has ended by itself
        self._timeout_s = timeout_s
        try:
            self._program = Program(program, command, folder)
        except OSError as error:
            raise CoprocessError("it cannot be run", error.strerror or str(error)) from None
        self._asked = memoryview(b"")
        self._said, self._errors = bytearray(), bytearray()
        self._line_end, self._ended = -1, False  # place of the first line end in what it said
        self._selector = selectors.DefaultSelector()
        for stream, take in ((self._program.stdout, self._take_answer), (self._program.stderr, self._take_error)):
            self._selector.register(stream, selectors.EVENT_READ, take)

    def __enter__(self) -> Self:
        """The program."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End the program and all that it started."""
        self._selector.close()
        self._program.close()

    def ask(self, line: bytes) -> bytes:
        """Send a line and wait for the next one of the program, both with their ends; one that came early, which only
        chance tells from others, is the answer too. Raises CoprocessError if it ends or is not done in time."""
        began, self._asked = time.perf_counter(), memoryview(line)
        if self._program.stdin not in self._selector.get_map():
            self._selector.register(self._program.stdin, selectors.EVENT_WRITE, self._give)
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
        self._unregister(self._program.stdin)
        self._program.stdin.close()
        self._wait(lambda: self._ended, f"did not end within {self._timeout_s:g} s after the end of its input")
        ending = self._end()
        if self._said:
            raise self.error(f"it wrote more than was asked: {quote(bytes(self._said))}")
        if ending != "it ended with status 0":
            raise self.error(f"{ending} after the end of its input")

    def error(self, text: str) -> CoprocessError:
        """The error of a problem, with the last lines that the program wrote to standard error."""
        with suppress(OSError):
            self._take_error()  # what has come meanwhile
        lines = bytes(self._errors).decode("utf-8", "replace").splitlines()[-_LAST_LINES:]
        last = [plain for line in lines if (plain := "".join(char for char in line if char.isprintable()).strip())]
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

    def _unregister(self, stream: RawIOBase) -> None:
        if stream in self._selector.get_map():
            self._selector.unregister(stream)

    def _give(self) -> None:
        try:
            self._asked = self._asked[self._program.stdin.write(self._asked[:_CHUNK]) or 0 :]
        except OSError:  # it reads no more: how it ended is known when its output has ended
            self._asked = memoryview(b"")
        if not self._asked:
            self._unregister(self._program.stdin)

    def _take_answer(self) -> None:
        more = self._program.stdout.read(_CHUNK)
        if more is None:
            return
        if not more:
            self._unregister(self._program.stdout)
            self._ended = True
        if self._line_end < 0 and (place := more.find(b"\n")) >= 0:
            self._line_end = len(self._said) + place
        self._said += more

    def _take_error(self) -> None:
        more = self._program.stderr.read(_CHUNK)
        if more == b"":
            self._unregister(self._program.stderr)
        self._errors += more or b""
        del self._errors[:-_LAST_BYTES]

    def _end(self) -> str:
        """End of the program in words; it is waited for, for a while."""
        ending = self._program.ending(min(_END_S, self._timeout_s))
        if ending is None:
            return "it closed its output"
        code, self.peak_memory_mb = ending
        if code >= 0:
            return f"it ended with status {code}"
        named = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return f"{named} ended it"


def quote(line: bytes) -> str:
    """A line that a program wrote, cut and without control characters, in quotation marks."""
    text = line.decode("utf-8", "replace").split("\n")[0]
    plain = "".join(char if char.isprintable() else "?" for char in text)
    return f"'{plain[:80]}{'…' if len(plain) > 80 else ''}'"
