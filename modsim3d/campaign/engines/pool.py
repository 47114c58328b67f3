"""Worker processes on this machine."""

from __future__ import annotations

from collections import deque
from multiprocessing.connection import Connection, wait

from modsim3d.campaign.engines.death import Death
from modsim3d.campaign.engines.worker_process import ProcessDiedError, WorkerProcess
from modsim3d.campaign.work.task import Task, TaskReport
from modsim3d.processes import WorkerCount, worker_count


class ProcessPool:
    """Does tasks in processes of their own, also if there is one only; one that dies is replaced."""

    def __init__(self, workers: WorkerCount) -> None:
        """Start the processes.

        Args:
            workers: Number of processes, or `auto`.

        Raises:
            ModsimError: This is no number of workers.
        """
        self.width = worker_count(workers)
        self._waiting: deque[Task] = deque()
        self._busy: dict[Connection, tuple[WorkerProcess, Task]] = {}
        self._idle = [WorkerProcess() for _ in range(self.width)]

    def submit(self, task: Task) -> None:
        """Hand in a task."""
        self._waiting.append(task)
        self._hand_out()

    def next(self) -> tuple[Task, TaskReport | Death]:
        """Wait for a task that was handed in, with its report, or how its process died.

        Raises:
            ModsimError: A process could not start, or a file cannot be written.
        """
        while True:
            for pipe in wait(list(self._busy)):
                assert isinstance(pipe, Connection)
                process, task = self._busy[pipe]
                try:
                    report: TaskReport | Death | None = process.answer()
                    if report is None:
                        continue
                    self._idle.append(process)
                except ProcessDiedError as error:
                    report = error.death
                    process.close()
                    self._idle.append(WorkerProcess())
                del self._busy[pipe]
                self._hand_out()
                return task, report

    def close(self) -> None:
        """End the processes, in the middle of a task too."""
        for process in (*self._idle, *(process for process, _ in self._busy.values())):
            process.close()

    def _hand_out(self) -> None:
        """Hand waiting tasks to idle processes."""
        while self._waiting and self._idle:
            process = self._idle.pop()
            try:
                process.hand(self._waiting[0])
            except ProcessDiedError:  # somebody ended it while it was idle
                process.close()
                self._idle.append(WorkerProcess())
                continue
            self._busy[process.pipe] = process, self._waiting.popleft()
