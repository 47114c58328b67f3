"""Locks, forks, limits, signals and descriptors, which not every operating system has, with a fallback for each.

No other module uses what only some systems have; docs/limits.md says what a system without it loses."""

import ctypes
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import RawIOBase
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

try:
    import fcntl
    import resource
except ImportError:  # Windows
    fcntl = resource = None  # type: ignore[assignment]
if sys.platform == "win32":
    Connection = connection.PipeConnection
else:
    Connection = connection.Connection

HAS_LOCKS = fcntl is not None
POSIX = os.name == "posix"
INPUT = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags that open an input file; without O_NONBLOCK opening a pipe waits for somebody who writes into it."""
FOLDER = os.O_RDONLY | os.O_DIRECTORY if hasattr(os, "O_DIRECTORY") else None
"""Flags that open a folder; None where folders are not opened."""


def lock(descriptor: int, *, shared: bool = False) -> None:
    """Lock a file until its descriptor is closed. Raises BlockingIOError if another process has locked it."""
    if sys.platform != "win32" and HAS_LOCKS:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def address_space_limit() -> int | None:
    """Most bytes of addresses that this process may have; None without a limit."""
    if sys.platform == "win32" or resource is None:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit < 0 or limit == resource.RLIM_INFINITY else limit


def usable_cpus() -> int:
    """Number of CPUs that this process may use."""
    if hasattr(os, "process_cpu_count"):  # from Python 3.13 on
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """Signals with some names, without those that this system lacks."""
    return tuple(signal.Signals[name] for name in names if name in signal.Signals.__members__)


def end_with_parent(parent: int | None = None) -> None:
    """Let the system end this process when its parent ends, however it ends: a killed one must not leave workers. If
    the parent of the given number has ended already, this process ends now. Elsewhere than on Linux it ends when it
    next reads from its parent."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
    if POSIX and parent is not None and os.getppid() != parent:  # on Windows an environment's launcher is between
        os._exit(1)


def may_fork() -> bool:
    """Whether this process surely has one thread only; a fork starts at once, but is not safe otherwise. A process of
    `multiprocessing` may not fork others."""
    tasks = Path("/proc/self/task")
    has_parent = multiprocessing.parent_process() is not None
    return hasattr(os, "fork") and not has_parent and tasks.is_dir() and len(list(tasks.iterdir())) == 1


def own_fork(work: Callable[..., None], *arguments: Any) -> BaseProcess:
    """Do work in a fork of this process which keeps nothing that a new interpreter would not have either: neither the
    process group, which Ctrl-C goes to, nor standard input and output, nor what this process does at signals."""
    return forked(_do_on_its_own, work, *arguments, daemon=False)


def _do_on_its_own(work: Callable[..., None], *arguments: Any) -> None:
    if sys.platform != "win32":
        os.setpgid(0, 0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    work(*arguments)


def forked(work: Callable[..., None], *arguments: Any, daemon: bool = True) -> BaseProcess:
    """Do work in a fork of this process, which may start such processes itself if it is no daemon."""
    context: Any = multiprocessing.get_context("fork")
    process: BaseProcess = context.Process(target=work, args=arguments, daemon=daemon)
    process.start()
    return process


def after_fork(work: Callable[[], None]) -> None:
    """Do work in each later fork of this process, at its beginning."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=work)


def passing(pipe: Connection) -> dict[str, Any]:
    """Options of `subprocess.Popen` with which the new process holds a pipe under the same number."""
    if sys.platform == "win32":
        os.set_handle_inheritable(pipe.fileno(), True)
        return {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [pipe.fileno()]})}
    return {"pass_fds": [pipe.fileno()]}


def inherited(pipe_number: int) -> Connection:
    """The pipe that this process was started with, by its number."""
    return Connection(pipe_number)


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
_END_S, _CHUNK = 5.0, 1 << 16  # time that the supervisor has to end; bytes that are carried at once


class Program:
    """A program with three streams, none of which blocks. Where processes fork, a supervisor starts it in a group of
    processes, none of which outlives this one; elsewhere what the program starts may outlive it."""

    def __init__(self, program: str, command: Sequence[str], folder: Path) -> None:
        """Start a file as a program with arguments, the first of which is its name, in a folder. Raises OSError if it
        cannot be run and there is no supervisor to say so."""
        pipes: Any = {"stdin": -1, "stdout": -1, "stderr": -1, "bufsize": 0, "cwd": folder}
        pipes["process_group"] = 0  # so that Ctrl-C reaches it through this process only
        self._life: socket.socket | None = None
        if hasattr(os, "fork"):
            self._life, other_end = socket.socketpair()
            number = other_end.fileno()
            supervisor = [sys.executable, "-I", "-S", "-c", SUPERVISOR, str(number), program]
            with other_end:
                self._process = subprocess.Popen([*supervisor, *command], pass_fds=[number], **pipes)
        else:
            self._process = subprocess.Popen(command, executable=program, **pipes)
        streams: Any = self._process.stdin, self._process.stdout, self._process.stderr
        if sys.platform == "win32" or self._life is None:
            streams = [_pumped(stream) for stream in streams]
        else:
            for stream in streams:
                os.set_blocking(stream.fileno(), False)
        self.stdin, self.stdout, self.stderr = streams

    def ending(self, timeout_s: float) -> tuple[int, float | None] | None:
        """Exit status of the program, or minus the number of a signal, and its most memory in MB of 2²⁰ bytes, if that
        is known; None if it does not end in time."""
        if self._life is None:
            with suppress(subprocess.TimeoutExpired):
                return self._process.wait(timeout_s), None
            return None
        self._life.settimeout(timeout_s)
        try:
            status, used = map(int, self._life.recv(64).split())
        except (OSError, ValueError):
            return None
        return os.waitstatus_to_exitcode(status), used / (1 << 20 if sys.platform == "darwin" else 1 << 10)

    def close(self) -> None:
        """End the program."""
        if self._life is None:
            self._process.kill()
        else:
            self._life.close()
        for stream in (self.stdin, self.stdout, self.stderr):
            with suppress(OSError):
                stream.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _pumped(pipe: RawIOBase) -> RawIOBase:
    """A socket whose bytes a thread carries to or from a pipe: on Windows only sockets can be waited for."""
    here, far_end = socket.socketpair()

    def carry() -> None:
        with suppress(OSError), far_end, pipe:
            if pipe.readable():
                while piece := pipe.read(_CHUNK):
                    far_end.sendall(piece)
            else:
                while piece := far_end.recv(_CHUNK):
                    while piece:
                        piece = piece[pipe.write(piece) :]

    threading.Thread(target=carry, daemon=True).start()
    here.setblocking(False)
    with here:
        return here.makefile("rwb", buffering=0)
