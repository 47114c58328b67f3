"""The process of a worker: does the tasks that come through a pipe, until the pipe ends.

Started as `python -m modsim3d.campaign.engines.serving PIPE PARENT`.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from contextlib import closing
from multiprocessing.connection import Connection

from modsim3d.campaign.engines.worker_process import READY
from modsim3d.campaign.work.admission import check_worker
from modsim3d.campaign.work.task import Task, TaskReport, Work, Worker
from modsim3d.errors import ModsimError
from modsim3d.worker_process import end_with_parent


def serve(pipe: Connection) -> None:
    """Do what comes through a pipe; each task is answered with its report, or with an error.

    Before a run begins, its number is sent: should it end this process, the other side knows which one did.
    """
    admitted: Work | None = None
    with closing(Worker()) as worker:
        pipe.send(READY)
        while True:
            try:
                task: Task = pipe.recv()
            except EOFError:
                return
            answer: tuple[TaskReport | None, ModsimError | None]
            try:
                if task.work != admitted:
                    check_worker(task.work)
                    admitted = task.work
                answer = worker.do(task, begin=pipe.send), None
            except ModsimError as error:
                answer = None, error
            except Exception as error:  # a defect: what it says must reach the user
                answer = None, ModsimError(f"a task failed: {''.join(traceback.format_exception(error))}")
            pipe.send(answer)


if __name__ == "__main__":
    end_with_parent(int(sys.argv[2]))
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback
    try:
        serve(Connection(int(sys.argv[1])))
    except KeyboardInterrupt:  # no signal raises it: the run did
        os._exit(128 + signal.SIGINT)
    except OSError:  # the parent has gone
        os._exit(1)
