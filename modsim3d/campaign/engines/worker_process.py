"""A worker in a process of its own, so that a run that ends its process ends nothing else.

It is a new interpreter and no fork: a fork is not safe where threads run, and `multiprocessing` would import the
user's script again. This module imports little, because a Dask worker imports it only to hand tasks on.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from modsim3d.campaign.engines.death import STOPPING, Death
from modsim3d.errors import ModsimError
from modsim3d.worker_process import new_interpreter

if TYPE_CHECKING:
    from modsim3d.campaign.work.task import Task, TaskReport

READY = "ready"
"""What a process says when it can take tasks."""
_END_S = 10.0
"""How long an idle process may take to close its OpenGL context."""
_STOP_S = 2.0
"""A signal that goes to all processes reaches the main one, or the Dask worker, within this time."""


class ProcessDiedError(Exception):
    """The process of a worker ended while it did a task."""

    def __init__(self, death: Death) -> None:
        """Take how it ended, `death`."""
        super().__init__(death)
        self.death = death


class WorkerProcess:
    """A process that does tasks one after the other, in one thread, with one OpenGL context.

    Nobody else holds the other end of its pipe, so that the pipe ends when the process does, whatever it was doing.
    """

    def __init__(self) -> None:
        """Start the process; tasks may be handed to it at once."""
        self.pipe, other_end = multiprocessing.Pipe()
        self._busy = self._ready = False
        self._run: int | None = None
        with other_end:
            serving = "modsim3d.campaign.engines.serving", str(other_end.fileno()), str(os.getpid())
            self._process = new_interpreter(other_end, "-m", *serving)

    @property
    def id(self) -> int:
        """Number of the process."""
        return self._process.pid

    def hand(self, task: Task) -> None:
        """Hand it a task.

        Raises:
            ProcessDiedError: The process has ended.
        """
        self._busy, self._run = True, None
        try:
            self.pipe.send(task)
        except OSError:
            raise self._died() from None

    def answer(self) -> TaskReport | None:
        """Read one message from the pipe: the report on the task, or None if it is not done yet.

        The process also says that it is ready, and which run it begins.

        Raises:
            ProcessDiedError: The process ended while it did the task.
            ModsimError: It could not start, or the task cannot be done.
        """
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
        """Do a task, and wait for it.

        Raises:
            ProcessDiedError: The process ended while it did the task.
            ModsimError: It could not start, or the task cannot be done.
        """
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
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self.kill()
        self._process.wait()

    def _died(self) -> ProcessDiedError | ModsimError:
        """What a broken pipe means."""
        try:
            code = self._process.wait(_END_S)
            if -code in STOPPING:  # if all are to stop, this process ends here, before the run counts as crashed
                time.sleep(_STOP_S)
            death = Death.of(self._run, code)
        except subprocess.TimeoutExpired:  # it lives, and something in it closed the pipe
            self.kill()
            code = self._process.wait()
            death = Death(self._run, "it closed the pipe", outside=False)
        if self._ready:
            return ProcessDiedError(death)
        return ModsimError(f"a worker process could not start: {_said(code)}, see above")


def _said(code: int) -> str:
    return f"it ended with status {code}" if code >= 0 else f"signal {-code} ended it"
