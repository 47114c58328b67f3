"""A worker in a process of its own, so that a run that ends its process ends nothing else. It is a fork where no other
thread runs, which has all modules at once, and else a new interpreter: `multiprocessing` would import the user's script
again."""

from __future__ import annotations

import multiprocessing
import os
import platform
import subprocess
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from signal import Signals
from typing import Any, Protocol, cast
from weakref import WeakSet

from modsim3d.campaign.serving import READY, serve_until_the_end
from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.core.errors import ModsimError
from modsim3d.io.operating_system import Connection, after_fork, may_fork, own_fork, signals
from modsim3d.io.processes import WorkerCount, new_interpreter, worker_count

STOPPING = signals("SIGTERM", "SIGINT", "SIGHUP")  # by which a batch system or a user stops all of a campaign


@dataclass(frozen=True)
class Death:
    """The end of a worker in the middle of a task."""

    run: int | None  # that it had begun; None if that is unknown
    how: str  # exit status or signal
    outside: bool  # something else than the run may have ended it, as the system does for want of memory
    host: str = ""  # name of its machine; empty if that is unknown

    @classmethod
    def of(cls, run: int | None, code: int) -> Death:
        """From an exit status on this machine, or minus the number of a signal."""
        named = Signals(-code).name if -code in set(Signals) else f"signal {-code}"
        return cls(run, f"exit status {code}" if code >= 0 else named, -code in signals("SIGKILL"), platform.node())

    @property
    def error(self) -> str | None:
        """The error of the run; None if it is not known to have ended the process itself."""
        return None if self.outside or self.run is None else f"the run ended its worker process ({self.how})"


LOST = Death(None, "its Dask worker was lost", True)  # a worker that was lost with all that is known of it


_END_S = 10.0  # how long an idle process may take to close its OpenGL context
_STOP_S = 2.0  # a signal that goes to all processes reaches the main one, or the Dask worker, within this time


class ProcessDiedError(Exception):
    """The process of a worker ended while it did a task."""

    def __init__(self, death: Death) -> None:
        """Take how it ended, `death`."""
        super().__init__(death)
        self.death = death


_pipes = WeakSet[Connection]()  # to the workers; a fork that held one would keep a worker from seeing its end


def _close_pipes() -> None:
    for pipe in _pipes:
        pipe.close()


after_fork(_close_pipes)


class CampaignWorker:
    """A process that does tasks one after the other, in one thread, with one OpenGL context. Nobody else holds the
    other end of its pipe, so that the pipe ends when the process does, whatever it was doing."""

    def __init__(self) -> None:
        """Start the process; tasks may be handed to it at once."""
        self.pipe, other_end = multiprocessing.Pipe()
        _pipes.add(self.pipe)
        self._busy = self._ready = False
        self._run: int | None = None
        self._process: subprocess.Popen[bytes] | BaseProcess
        with other_end:
            if may_fork():
                self._process = own_fork(serve_until_the_end, other_end, os.getpid())
            else:
                serving = "modsim3d.campaign.serving", str(other_end.fileno()), str(os.getpid())
                self._process = new_interpreter(other_end, "-m", *serving)

    @property
    def id(self) -> int:
        """Number of the process."""
        return cast(int, self._process.pid)

    def hand(self, task: Task) -> None:
        """Hand it a task; ProcessDiedError if the process has ended."""
        self._busy, self._run = True, None
        try:
            self.pipe.send(task)
        except OSError:
            raise self._died() from None

    def answer(self) -> TaskReport | None:
        """Read one message from the pipe: the report on the task, or None if it is not done yet, since the process also
        says that it is ready, and which run it begins. Raises ProcessDiedError if it ended while it did the task, and
        ModsimError if it could not start or the task cannot be done."""
        try:
            message = self.pipe.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if message == READY:
            self._ready = True
            return None
        if isinstance(message, int):
            self._run = message
            return None
        self._busy = False
        report: TaskReport | None
        report, error = message
        if error is not None:
            raise error
        return report

    def do(self, task: Task) -> TaskReport:
        """Do a task, and wait for it; errors are those of `answer`."""
        self.hand(task)
        while (report := self.answer()) is None:
            pass
        return report

    def kill(self) -> None:
        """End the process, whatever it is doing."""
        self._process.kill()

    def close(self) -> None:
        """End the process: an idle one closes its OpenGL context first, if it has ever done a task."""
        self.pipe.close()
        if self._busy or not self._ready:
            self.kill()
        if self.wait(_END_S) is None:
            self.kill()
            self.wait()

    def wait(self, timeout_s: float | None = None) -> int | None:
        """Exit status of the process, or minus the number of a signal; None if it does not end in time."""
        if not isinstance(self._process, subprocess.Popen):
            self._process.join(timeout_s)
            return self._process.exitcode
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout_s)
        return None

    def _died(self) -> ProcessDiedError | ModsimError:
        code = self.wait(_END_S)
        if code is None:  # it lives, and something in it closed the pipe
            self.kill()
            self.wait()
            return ProcessDiedError(Death(self._run, "it closed the pipe", outside=False))
        if -code in STOPPING:  # if all are to stop, this process ends here, before the run counts as crashed
            time.sleep(_STOP_S)
        if self._ready:
            return ProcessDiedError(Death.of(self._run, code))
        ending = f"it ended with status {code}" if code >= 0 else f"signal {-code} ended it"
        return ModsimError(f"a worker process could not start: {ending}, see above")


class ProcessPool:
    """Does tasks in processes of their own, also if there is one only; one that dies is replaced."""

    def __init__(self, workers: WorkerCount) -> None:
        """Start the processes, `auto` or a number of them; ModsimError if this is no number of workers."""
        self.width = worker_count(workers)
        self._waiting: deque[Task] = deque()
        self._busy: dict[Any, tuple[CampaignWorker, Task]] = {}  # by the pipe
        self._idle = [CampaignWorker() for _ in range(self.width)]

    def submit(self, task: Task) -> None:
        """Hand in a task."""
        self._waiting.append(task)
        self._hand_out()

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Wait for a task that was handed in, with its report, or how its process died. Raises ModsimError if a process
        could not start, or a file cannot be written."""
        while True:
            for pipe in wait(list(self._busy)):
                process, task = self._busy[pipe]
                try:
                    report: TaskReport | Death | None = process.answer()
                    if report is None:
                        continue
                    self._idle.append(process)
                except ProcessDiedError as error:
                    report = error.death
                    process.close()
                    self._idle.append(CampaignWorker())
                del self._busy[pipe]
                self._hand_out()
                return task, report

    def close(self) -> None:
        """End the processes, in the middle of a task too."""
        for process in (*self._idle, *(process for process, _ in self._busy.values())):
            process.close()

    def _hand_out(self) -> None:
        while self._waiting and self._idle:
            process = self._idle.pop()
            try:
                process.hand(self._waiting[0])
            except ProcessDiedError:  # somebody ended it while it was idle
                process.close()
                self._idle.append(CampaignWorker())
                continue
            self._busy[process.pipe] = process, self._waiting.popleft()


class Engine(Protocol):
    """Does tasks."""

    @property
    def width(self) -> int:
        """Number of tasks that can be done at once now, at least 1; it may change."""

    def submit(self, task: Task) -> None:
        """Hand in a task."""

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Wait for a task that was handed in, with its report, or how its worker died. Raises ModsimError if the work
        cannot go on: a file cannot be written, or the cluster is gone."""

    def close(self) -> None:
        """End the workers."""
