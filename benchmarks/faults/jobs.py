"""The commands that faults are tried on, with what they should write, and what must be true after a fault."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

from benchmarks.faults.commands import Ended, run
from benchmarks.faults.tracing import Call, traced
from benchmarks.faults.trees import Tree, differences, finished_but_not_whole, tree


class Outcome(str, Enum):  # noqa: UP042
    """What became of a fault."""

    NO_MATTER = "no matter"
    SAME_BYTES = "same bytes"
    OLD_WHOLE = "old output whole"
    REFUSED = "refused clearly"
    FAILED = "failure"


@dataclass(frozen=True)
class Tried:
    """A fault that was tried.

    Attributes:
        fault: Its class, a row of the table.
        case: What exactly, so that it can be tried again.
        said: What went wrong, or what the command said.
    """

    fault: str
    case: str
    outcome: Outcome
    said: str = ""


@dataclass(frozen=True)
class Job:
    """A command that writes into a folder.

    Attributes:
        arguments: The command line; the folder is in it.
        again: What is added to go on after a fault.
        folder: Where it writes.
        start: A folder to begin with, which holds older output; none for an empty place.
        expected: The folder's content after an undisturbed command.
        old: The older content.
        is_run: Whether it is a run directory, whose `run.json` says that all is there.
        calls: Those of an undisturbed command that change something in the folder.
        seconds: How long the undisturbed command takes.
    """

    name: str
    arguments: tuple[object, ...]
    folder: Path
    again: tuple[str, ...] = ()
    start: Path | None = None
    is_run: bool = True
    expected: Tree = field(default_factory=dict)
    old: Tree = field(default_factory=dict)
    calls: tuple[Call, ...] = ()
    seconds: float = 0.0

    def reset(self) -> None:
        """Put the folder into the state before the command."""
        shutil.rmtree(self.folder, ignore_errors=True)
        if self.start is not None:
            shutil.copytree(self.start, self.folder)

    def known(self) -> Job:
        """Run the command undisturbed, and note what it writes and how.

        Raises:
            RuntimeError: It does not succeed, or does not write the same bytes twice.
        """
        found: list[Tree] = []
        calls: list[Call] = []
        seconds = []
        for trace in (False, True):
            self.reset()
            old = tree(self.folder)
            ended, calls = traced(self.arguments) if trace else (run(self.arguments), [])
            if ended.status != 0:
                raise RuntimeError(f"{self.name}: {ended.said}")
            found.append(tree(self.folder))
            seconds.append(ended.seconds)
        if found[0] != found[1]:
            raise RuntimeError(f"{self.name}: {differences(*found)}")
        changing = tuple(call for call in calls if call.changes(self.folder))
        return replace(self, expected=found[0], old=old, calls=changing, seconds=min(seconds))

    def go_on(self) -> Ended:
        """The command after a fault."""
        arguments = self.arguments
        if "--resume" in self.again:
            arguments = tuple(argument for argument in arguments if argument != "--overwrite")
        return run([*arguments, *self.again])


def whole(job: Job) -> str:
    """What is wrong with a folder right after a fault; empty if each output is whole."""
    if job.is_run:
        return finished_but_not_whole(job.folder, [job.expected, job.old])
    found = tree(job.folder)
    half = [
        name
        for name, sha in found.items()
        if name in {**job.expected, **job.old} and sha not in (job.expected.get(name), job.old.get(name))
    ]
    return f"{', '.join(half)} is neither the old nor the new" if half else ""


def after(job: Job, fault: str, case: str, ended: Ended | None = None) -> Tried:
    """Judge a folder after a fault, go on, and judge again.

    Args:
        job: The command.
        fault: The class of the fault.
        case: What exactly.
        ended: How the disturbed command ended, if that is to be judged: with success and the right bytes or with one
            clear error.
    """

    def failed(said: str) -> Tried:
        return Tried(fault, case, Outcome.FAILED, said)

    if ended is not None and not ended.clean():
        return failed(f"exit status {ended.status}: {ended.message()}")
    if ended is not None and ended.left_behind:
        return failed(f"{ended.left_behind} processes did not end")
    if wrong := whole(job):
        return failed(wrong)
    if ended is not None and ended.status == 0:
        wrong = differences(tree(job.folder), job.expected)
        return failed(f"success, but {wrong}") if wrong else Tried(fault, case, Outcome.NO_MATTER)
    return _go_on(job, fault, case, ended)


def _go_on(job: Job, fault: str, case: str, ended: Ended | None) -> Tried:
    said = ended.message() if ended is not None else ""
    outcome = Outcome.SAME_BYTES
    untouched = bool(job.old) and all(tree(job.folder).get(name) == sha for name, sha in job.old.items())
    again = job.go_on()
    if again.refused() and job.is_run and (job.folder / "run.json").exists():
        found = tree(job.folder)
        if found == job.expected:
            return Tried(fault, case, outcome, said)  # it was finished
        again = run([*(a for a in job.arguments if a != "--overwrite"), "--overwrite"])
    if untouched:
        outcome = Outcome.OLD_WHOLE
    if again.status != 0:
        return Tried(fault, case, Outcome.FAILED, f"cannot go on: exit status {again.status}: {again.message()}")
    wrong = differences(tree(job.folder), job.expected)
    return Tried(fault, case, Outcome.FAILED if wrong else outcome, f"afterwards {wrong}" if wrong else said)


def run_job(
    folder: Path, scene: str, *options: object, name: str = "", start: Path | None = None, workers: int = 1
) -> Job:
    """`modsim3d run`; over an older run if there is one."""
    overwrite = ("--overwrite",) if start is not None else ()
    arguments = ("run", scene, "--no-sheet", *options, "--workers", workers, "--out", folder, *overwrite)
    return Job(name or f"run {scene}", arguments, folder, again=("--resume",), start=start)
