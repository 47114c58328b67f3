"""Commands of modsim3d in processes that can be held, traced, stopped and killed.

The modules are imported once; each command then runs in a fork of this process, so that hundreds of commands take
minutes. Orphans come to this process, so that it knows when the last process of a command has ended.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h
PATIENCE_S = 180
PREPARED = (
    "modsim3d.cli.main",
    "modsim3d.runs.run",
    "modsim3d.runs.run",
    "modsim3d.scene.reading",
    "modsim3d.truth.rendered",
    "modsim3d.scene.ais.traffic",
    "modsim3d.scene.ais.scene_folder",
    "modsim3d.formats.writing.coco",
    "modsim3d.learn.report_page",
    "modsim3d.verify.verify_run",
    "modsim3d.view.report.report",
    "modsim3d.view.films.film",
)


def prepare() -> None:
    """Import what the commands need, and adopt their orphans; call it before anything starts a thread."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("JE_ARROW_MALLOC_CONF", "background_thread:false")
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    for name in PREPARED:
        __import__(name)
    threads = len(list(Path("/proc/self/task").iterdir()))
    if threads != 1:
        raise RuntimeError(f"{threads} threads run after the imports, so this process cannot be forked safely")


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit status, or −signal; what it said; how many of its processes did not end."""

    status: int
    said: str
    seconds: float
    left_behind: int

    def clean(self) -> bool:
        """Whether it succeeded, or failed with one message."""
        return self.status == 0 or self.refused()

    def refused(self) -> bool:
        """Whether it ended with exit status 2, one message and no traceback."""
        messages = [line for line in self.said.splitlines() if line.startswith("modsim3d: ")]
        return self.status == 2 and len(messages) == 1 and "Traceback" not in self.said

    def message(self) -> str:
        """The error message, or the last lines."""
        at = self.said.find("modsim3d: ")
        return self.said[at:].strip() if at >= 0 else "\n".join(self.said.splitlines()[-4:])


class Running:
    """A command in a process group of its own."""

    def __init__(self, pid: int, gate: int, said: Path) -> None:
        self.pid = pid
        self._gate = gate
        self._said = said
        self._started = time.monotonic()

    def release(self) -> None:
        """Let a held command begin."""
        os.write(self._gate, b"x")
        self._started = time.monotonic()

    def send(self, number: signal.Signals, *, group: bool = False) -> None:
        """Send a signal to the process or to all of its group, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.pid, number)

    def children(self) -> list[int]:
        """Its worker processes."""
        with contextlib.suppress(OSError):
            return [int(pid) for pid in Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()]
        return []

    def stopped(self) -> bool:
        """Whether the process is stopped by a signal."""
        with contextlib.suppress(OSError):
            state = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]
            return state in "tT"
        return False

    def ended(self) -> bool:
        """Whether the process has ended; it is not waited for."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def wait(self, *, for_group: bool = True, patience_s: float = PATIENCE_S) -> Ended:
        """Wait for the end of the process, and of its workers.

        Args:
            for_group: Wait for the workers too.
            patience_s: Afterwards it is killed.
        """
        deadline = time.monotonic() + patience_s
        while not self.ended():
            if time.monotonic() > deadline:
                self.send(signal.SIGKILL, group=True)
            time.sleep(0.002)
        seconds = time.monotonic() - self._started
        _, status = os.waitpid(self.pid, 0)
        os.close(self._gate)
        left_behind = reap_group(self.pid) if for_group else 0
        said = self._said.read_text("utf-8", errors="replace")
        self._said.unlink()
        return Ended(os.waitstatus_to_exitcode(status), said, seconds, left_behind)


def reap_group(group: int, patience_s: float = 10) -> int:
    """Wait until no process of a group is left; those that do not end are killed and counted."""
    deadline, killed = time.monotonic() + patience_s, 0
    while True:
        try:
            pid, _ = os.waitpid(-group, os.WNOHANG)
        except ChildProcessError:
            return killed
        if pid == 0:
            if time.monotonic() > deadline:
                killed += 1
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(group, signal.SIGKILL)
            time.sleep(0.002)


def start(arguments: Sequence[object], *, held: bool = False, first: Callable[[], object] | None = None) -> Running:
    """Start a command.

    Args:
        arguments: What follows `modsim3d` on the command line.
        held: Wait for `release` before anything is done.
        first: Called in the new process before the command, to set limits.
    """
    handle, name = tempfile.mkstemp(prefix="said_")
    wait_here, gate = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        os.setpgid(0, 0)
        os.close(gate)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        os.close(handle)
        os.read(wait_here, 1)
        os.close(wait_here)
        _run([str(argument) for argument in arguments], first)
    with contextlib.suppress(OSError):
        os.setpgid(pid, pid)
    os.close(handle)
    os.close(wait_here)
    running = Running(pid, gate, Path(name))
    if not held:
        running.release()
    return running


def _run(arguments: list[str], first: Callable[[], object] | None) -> NoReturn:
    from modsim3d.cli.main import main

    status = 1
    try:
        if first is not None:
            first()
        sys.argv = ["modsim3d", *arguments]
        main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(BaseException):
            atexit._run_exitfuncs()
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def run(arguments: Sequence[object], first: Callable[[], object] | None = None) -> Ended:
    """Run a command to its end."""
    return start(arguments, first=first).wait()
