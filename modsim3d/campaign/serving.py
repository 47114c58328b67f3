"""The process of a worker does the tasks of a pipe: `python -m modsim3d.campaign.serving PIPE PARENT`."""

import os
import platform
import signal
import sys
import traceback
from contextlib import closing
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import orjson

from modsim3d.campaign.work.scenes import versions
from modsim3d.campaign.work.task import PLAN, Task, TaskReport, Work, Worker
from modsim3d.core.errors import ModsimError
from modsim3d.io.operating_system import Connection, end_with_parent, inherited
from modsim3d.io.plugins import changed_plugins
from modsim3d.tracking.trackers.command import CHECKSUM

READY = "ready"  # what a process says when it can take tasks


def check_worker(work: Work) -> None:
    """Check that this process may work on a campaign. Raises ModsimError if the campaign's folder is not here or is
    that of another, or packages have other versions."""
    host, plan = platform.node(), Path(work.folder) / PLAN
    try:
        facts = orjson.loads(plan.read_bytes())
        sha256, wanted = facts["sha256"], {**facts["versions"], **_of_trackers(facts)}
    except OSError as error:
        raise ModsimError(
            f"the worker on {host} cannot read {plan} ({error.strerror or error}): every worker needs the folder of "
            "the campaign under the same path"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise ModsimError(f"{plan} is damaged: {error}") from None
    if sha256 != work.plan_sha256:
        raise ModsimError(
            f"the worker on {host} finds another campaign at {plan}: every worker needs the folder of the campaign "
            "under the same path"
        )
    if changed := changed_plugins(work.plugins, "the campaign was planned"):
        raise ModsimError(f"the worker on {host} has other plug-ins than the plan: {'; '.join(changed)}")
    actual = versions() | {name: _version(name) for name in wanted if name not in versions()}
    if differing := [f"{name} {actual[name]} instead of {pin}" for name, pin in wanted.items() if actual[name] != pin]:
        raise ModsimError(
            f"the worker on {host} has {', '.join(differing)}: a campaign needs the same versions everywhere"
        )


def _of_trackers(facts: dict[str, Any]) -> dict[str, str]:
    packages: dict[str, str] = {}
    for condition in facts["conditions"]:
        for tracker in condition["trackers"].values():
            package, _, number = tracker["package"].rpartition(" ")
            # Files of programs are checked by their checksums, as all files are.
            packages |= {name: value for name, value in tracker["versions"].items() if not value.startswith(CHECKSUM)}
            if number[:1].isdigit():  # else a plug-in of no package
                packages[package] = number
    return packages


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def serve(pipe: Connection) -> None:
    """Do what comes through a pipe; each task is answered with its report, or with an error. Before a run begins, its
    number is sent: should it end this process, the other side knows which one did."""
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


def serve_until_the_end(pipe: Connection, parent: int) -> None:
    """Serve a pipe in a process of its own, until it is closed or the parent ends."""
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback
    try:
        serve(pipe)
    except KeyboardInterrupt:  # no signal raises it: the run did
        os._exit(128 + signal.SIGINT)
    except OSError:  # the parent has gone
        os._exit(1)


if __name__ == "__main__":
    serve_until_the_end(inherited(int(sys.argv[1])), int(sys.argv[2]))
