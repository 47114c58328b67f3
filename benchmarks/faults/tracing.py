"""The system calls of a command, read from strace; and calls that strace makes fail, or answers with a signal."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.faults.commands import Ended, Running, start

INSTALL = "script/campaign faults needs strace: apt install strace"
FAILURES = {
    **dict.fromkeys(("write", "pwrite64", "writev", "pwritev", "sendfile", "copy_file_range"), "ENOSPC"),
    **dict.fromkeys(("fsync", "fdatasync", "rename", "renameat", "renameat2", "ftruncate", "close"), "EIO"),
    **dict.fromkeys(("unlink", "unlinkat", "rmdir"), "EIO"),
    **dict.fromkeys(("openat", "mkdir", "mkdirat"), "ENOSPC"),
}
"""Calls that change files, and how each may fail."""
OTHERS = ("lseek", "dup", "dup2", "dup3", "flock", "fcntl", "truncate", "link", "symlink")
LINE = re.compile(r"^(\d+) +(\w+)\((.*)\) += (-?\w+)(.*)$", re.DOTALL)
UNFINISHED = re.compile(r"^(\d+) +(.*) <unfinished \.\.\.>$")
PATH = re.compile(r'(?:\d<|")(/[^">]*)')
RESUMED = re.compile(r"^(\d+) +<\.\.\. (\w+) resumed>(.*)$")


@dataclass(frozen=True)
class Call:
    """One system call.

    Attributes:
        nth: How many calls of this name on this path its process had made with it.
        arguments: As strace writes them, with the path of each file descriptor.
        result: Negative if it failed.
        rest: What strace says after the result.
    """

    pid: int
    name: str
    nth: int
    arguments: str
    result: int
    rest: str

    def changes(self, folder: Path) -> bool:
        """Whether it may change something in a folder."""
        if self.name not in FAILURES or str(folder) not in self.arguments:
            return False
        return self.name != "openat" or any(flag in self.arguments for flag in ("O_CREAT", "O_WRONLY", "O_RDWR"))

    def path(self) -> str:
        """The path by which strace finds it: the first, of a descriptor or a text; empty if there is none."""
        return first_path(self.arguments)

    def failure(self, error: str) -> tuple[str, str]:
        """For strace: this call fails."""
        return self.path(), f"inject={self.name}:error={error}:when={self.nth}"

    def signalled(self, signal: str) -> tuple[str, str]:
        """For strace: this call brings a signal."""
        return self.path(), f"inject={self.name}:signal={signal}:when={self.nth}"


def first_path(arguments: str) -> str:
    """The first path of a file in a call's arguments."""
    found = PATH.search(arguments)
    return found[1] if found else ""


def check_strace() -> None:
    if shutil.which("strace") is None:
        raise SystemExit(INSTALL)


class Tracer:
    """strace, attached to a command that is held."""

    def __init__(self, running: Running, *, inject: tuple[str, str] | None = None, data: bool = False) -> None:
        """Attach.

        Args:
            running: Held; it is released once strace watches it.
            inject: The only path to watch, and what to do.
            data: Note what is written too.
        """
        with tempfile.NamedTemporaryFile(prefix="trace_", delete=False) as out:
            self._path = Path(out.name)
        length = ["-xx", "-s", str(1 << 28)] if data else ["-s", "0"]
        calls = ",".join([*FAILURES, *OTHERS])
        options = ["-P", inject[0], "-e", inject[1]] if inject else []
        command = ["strace", "-f", "-y", *length, "-e", f"trace={calls}", *options]
        self._process = subprocess.Popen(
            [*command, "-e", "signal=none", "-o", self._path, "-p", str(running.pid)], stderr=subprocess.PIPE, text=True
        )
        assert self._process.stderr
        while "attached" not in (line := self._process.stderr.readline()):
            if not line:
                raise RuntimeError("strace could not be attached")
        running.release()

    def calls(self) -> list[Call]:
        """All calls; waits for the end of what was traced."""
        self._process.communicate()
        text = self._path.read_text("utf-8", errors="replace")
        self._path.unlink()
        return parse(text)


def parse(text: str) -> list[Call]:
    """The calls of a trace; one that another process interrupted counts where it ended."""
    begun: dict[str, str] = {}
    counts: Counter[tuple[int, str, str]] = Counter()
    calls = []
    for line in text.splitlines():
        if match := UNFINISHED.match(line):
            begun[match[1]] = match[2]
            continue
        if (match := RESUMED.match(line)) and match[1] in begun:
            line = f"{match[1]} {begun.pop(match[1])}{match[3]}"
        if match := LINE.match(line):
            pid, name = int(match[1]), match[2]
            key = pid, name, first_path(match[3])
            counts[key] += 1
            result = int(match[4], 0) if re.fullmatch(r"-?(0x)?[0-9a-f]+", match[4]) else -1
            calls.append(Call(pid, name, counts[key], match[3], result, match[5]))
    return calls


def traced(
    arguments: Sequence[object], *, inject: tuple[str, str] | None = None, data: bool = False
) -> tuple[Ended, list[Call]]:
    """Run a command under strace."""
    running = start(arguments, held=True)
    tracer = Tracer(running, inject=inject, data=data)
    ended = running.wait()
    return ended, tracer.calls()


def injected(calls: Sequence[Call], folder: Path) -> Call | None:
    """The first call on a folder that strace made fail."""
    return next((call for call in calls if "(INJECTED" in call.rest and str(folder) in call.arguments), None)
