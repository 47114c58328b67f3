"""A short campaign engine."""

from modsim3d.campaign.work.task import Task, TaskReport, Worker
from modsim3d.campaign.workers import Death


class ThisProcess:
    """Does tasks one after the other, in this process."""

    width = 1

    def __init__(self) -> None:
        self._worker, self._waiting = Worker(), list[Task]()

    def submit(self, task: Task) -> None:
        self._waiting.append(task)

    def next(self) -> tuple[Task, TaskReport | Death]:
        task = self._waiting.pop(0)
        return task, self._worker.do(task)

    def close(self) -> None:
        self._worker.close()
