"""What an interrupted run has kept is damaged before it is resumed."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from benchmarks.faults.commands import start
from benchmarks.faults.jobs import Job, Outcome, Tried, after
from benchmarks.faults.tracing import Tracer

KEPT = "truth_"
"""Begins the name of a file that holds the truth of a block."""


def interrupted(job: Job, target: Path) -> None:
    """Leave an interrupted run in a folder, which holds several finished blocks."""
    job.reset()
    # Of the last file that is put in place, so that all blocks are kept.
    call = [call for call in job.calls if KEPT in call.arguments and call.name.startswith("rename")][-1]
    later = next(c for c in job.calls[job.calls.index(call) + 1 :] if c.name == "write")
    running = start(job.arguments, held=True)
    tracer = Tracer(running, inject=later.signalled("SIGKILL"))
    running.wait()
    tracer.calls()
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(job.folder, target)


Damage = Callable[[Path, Path, random.Random], None]
"""Given a file, the same file of another run, and chance."""


def empty(path: Path, other: Path, chance: random.Random) -> None:
    path.write_bytes(b"")


def cut(path: Path, other: Path, chance: random.Random) -> None:
    path.write_bytes(path.read_bytes()[:5000])


def zeros(path: Path, other: Path, chance: random.Random) -> None:
    path.write_bytes(bytes(path.stat().st_size))


def flip(path: Path, other: Path, chance: random.Random) -> None:
    content = bytearray(path.read_bytes() or b"\0")
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def swap(path: Path, _: Path, chance: random.Random) -> None:
    """Exchange it with another block's, if there is one."""
    others = sorted(
        p for p in path.parent.iterdir() if p != path and p.name.startswith(KEPT) and p.suffix == path.suffix
    )
    if others:
        third = chance.choice(others)
        content = path.read_bytes()
        path.write_bytes(third.read_bytes())
        third.write_bytes(content)


def exchange(path: Path, other: Path, chance: random.Random) -> None:
    if other.exists():
        shutil.copy(other, path)


def remove(path: Path, other: Path, chance: random.Random) -> None:
    path.unlink()


DAMAGES: dict[str, Damage] = {
    "emptied": empty,
    "cut at 5000 bytes": cut,
    "zeros in place of its bytes": zeros,
    "one bit flipped": flip,
    "swapped with another block's": swap,
    "replaced by another run's": exchange,
    "removed": remove,
}


def damaged(job: Job, kept: Path, other: Path, rounds: int, seed: int) -> Iterator[Tried]:
    """Damage each file that an interrupted run left, in each way.

    Args:
        job: The run.
        kept: What it left when it was interrupted.
        other: The same of a run with another seed.
        rounds: How often, with other places and partners.
        seed: Of these.
    """
    chance = random.Random(f"{seed} {job.name}")
    work = kept / "unfinished"
    for name in sorted(str(path.relative_to(work)) for path in work.rglob("*") if path.is_file()):
        block = Path(name).name.startswith(KEPT)
        for way, damage in DAMAGES.items():
            if way.startswith("swapped") and not block:
                continue
            for _ in range(rounds if block else 1):
                resumed = replace(job, start=kept)
                resumed.reset()
                damage(job.folder / "unfinished" / name, other / "unfinished" / name, chance)
                fault = f"kept block {way}" if block else "another unfinished file damaged"
                yield _judged(after(resumed, fault, f"{job.name}: {name} {way}"), block)


def _judged(tried: Tried, block: bool) -> Tried:
    """Other files than blocks may make the run refuse, if it says clearly why."""
    refused = "cannot go on: exit status 2: modsim3d: "
    if not block and tried.outcome is Outcome.FAILED and tried.said.startswith(refused):
        return replace(tried, outcome=Outcome.REFUSED)
    return tried
