"""The machine loses power at random moments of a command, and the command goes on with what the disk holds."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator

from benchmarks.faults.disk import Disk, Lost
from benchmarks.faults.jobs import Job, Outcome, Tried, after
from benchmarks.faults.tracing import traced
from benchmarks.faults.trees import differences, tree
from benchmarks.faults.two_writers import LOCK

LAST_CALLS = 120
"""Half of the moments are among the last calls, which put the files in place."""


def power_cuts(job: Job, cuts: int, seed: int) -> Iterator[Tried]:
    """Cut the power at random moments.

    The folder beside the job's is the disk, so that nothing else may be in it.
    """
    job.reset()
    disk = Disk(job.folder.parent)
    ended, calls = traced(job.arguments, data=True)
    if ended.status != 0:
        yield Tried("power cut", job.name, Outcome.FAILED, ended.message())
        return
    chance = random.Random(f"{seed} {job.name}")
    changing = [i for i, call in enumerate(calls) if call.result >= 0 and call.name != "lseek"]
    moments = sorted(chance.choice(changing[-LAST_CALLS:] if k % 2 else changing) for k in range(cuts))
    done = 0
    for moment in moments:
        for call in calls[done : moment + 1]:
            disk.replay(call)
        done = max(done, moment + 1)
        for lost in Lost:
            yield _cut(job, disk, lost, chance, f"call {moment + 1} of {len(calls)}")
    for call in calls[done:]:
        disk.replay(call)
    yield _cut_after_success(job, disk, chance)


def _cut(job: Job, disk: Disk, lost: Lost, chance: random.Random, moment: str) -> Tried:
    shutil.rmtree(disk.root)
    disk.root.mkdir()
    disk.crash(chance, lost, disk.root)
    return after(job, f"power cut, changes of folders {lost.value}", f"{job.name}: {moment}")


def _cut_after_success(job: Job, disk: Disk, chance: random.Random) -> Tried:
    """After the command has said that it is done, everything is on the disk; a lock that nobody holds may be, too."""
    shutil.rmtree(disk.root)
    disk.root.mkdir()
    disk.crash(chance, Lost.UNDONE, disk.root)
    found = {name: sha for name, sha in tree(job.folder).items() if not name.endswith(LOCK)}
    wrong = differences(found, job.expected)
    return Tried(
        "power cut after the end", job.name, Outcome.FAILED if wrong else Outcome.SAME_BYTES, f"afterwards {wrong}"
    )
