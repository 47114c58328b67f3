"""What an engine is: something that does tasks, some of them at once, in any order."""

from __future__ import annotations

from typing import Protocol

from modsim3d.campaign.engines.death import Death
from modsim3d.campaign.work.task import Task, TaskReport, Worker


class Engine(Protocol):
    """Does tasks."""

    @property
    def width(self) -> int:
        """How many tasks can be done at once now, at least 1; it may change."""

    def submit(self, task: Task) -> None:
        """Hand in a task."""

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Wait for a task that was handed in, with its report, or how its worker died.

        Raises:
            ModsimError: The work cannot go on: a file cannot be written, or the cluster is gone.
        """

    def close(self) -> None:
        """End the workers."""


class ThisProcess:
    """Does tasks one after the other, in this process."""

    width = 1

    def __init__(self) -> None:
        """Start with nothing to do."""
        self._worker, self._waiting = Worker(), list[Task]()

    def submit(self, task: Task) -> None:
        """Put a task at the end of the queue."""
        self._waiting.append(task)

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Do the first task of the queue."""
        task = self._waiting.pop(0)
        return task, self._worker.do(task)

    def close(self) -> None:
        """Close the OpenGL context."""
        self._worker.close()
