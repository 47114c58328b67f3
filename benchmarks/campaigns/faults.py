"""faults: kills, failing calls, full disks, power cuts, two writers and damage, while each command writes its files.

Every command runs undisturbed first; what it writes then is what must be there after each fault and, where needed, one
more command. Needs Linux and strace; the full and the read-only disk need root. Exit status 1 if a fault does harm.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.faults import commands, kills
from benchmarks.faults.damage import damaged, interrupted
from benchmarks.faults.failing_calls import failing_calls
from benchmarks.faults.full_disk import NO_MOUNT, full_disks, limited_files, may_mount, read_only
from benchmarks.faults.jobs import Job, Tried, run_job
from benchmarks.faults.outputs import OVERWRITE, output_jobs
from benchmarks.faults.power_cuts import power_cuts
from benchmarks.faults.results import read_rows, rows_of, table, write_between
from benchmarks.faults.tracing import check_strace
from benchmarks.faults.two_writers import two_writers

ROOT = Path(__file__).resolve().parents[2]
OUT, PAGE = ROOT / "docs" / "campaigns" / "faults.json", ROOT / "docs" / "reliability.md"
TINY = ("--steps", 5, "--source", "analytic")
BLOCKS = ("--steps", 600, "--source", "analytic")
"""Three blocks."""
SCENES = {"simulation_1": 600, "simulation_2": 300, "simulation_3": 300, "harbour": 330, "strait": 300}
"""Steps of each shipped scene: two or three blocks."""
SEED = 0


@dataclass(frozen=True)
class Trial:
    """Where faults are tried, and how many of what is asked for: 1 for all."""

    folder: Path
    share: float

    @property
    def target(self) -> Path:
        """The folder that commands write to; its parent holds nothing else."""
        return self.folder / "disk" / "out"

    def many(self, count: int) -> int:
        return max(1, round(count * self.share))

    def tiny(self, *, overwrite: bool = False, workers: int = 1, scene: str = "simulation_1") -> Job:
        """A run of five steps, perhaps over an older one."""
        old = self.folder / f"old_{scene}"
        if overwrite:
            run_job(old, scene, *TINY, "--seed", 1).known()
        name = f"run {scene}" + " --overwrite" * overwrite + f" --workers {workers}" * (workers > 1)
        return run_job(self.target, scene, *TINY, name=name, start=old if overwrite else None, workers=workers).known()


def killed_runs(trial: Trial) -> Iterator[Tried]:
    """SIGKILL of runs, again and again, of all shipped scenes."""
    for scene, steps in SCENES.items():
        job = run_job(trial.target, scene, "--steps", steps).known()
        yield from kills.chains(job, trial.many(10), SEED)
        yield from kills.killed_workers(job, trial.many(6), SEED)
        yield from kills.ended_by(signal.SIGTERM, (-signal.SIGTERM,), job, trial.many(2))
        yield from kills.ended_by(signal.SIGINT, (130,), job, trial.many(2))


def failing_runs(trial: Trial) -> Iterator[Tried]:
    """Every call of a small run fails in turn; of other runs, some."""
    yield from failing_calls(trial.tiny(), trial.many(1000))
    yield from failing_calls(trial.tiny(overwrite=True), trial.many(120))
    yield from failing_calls(trial.tiny(workers=2), trial.many(30))
    for scene in SCENES:
        yield from failing_calls(trial.tiny(scene=scene), trial.many(20), SEED + 1)
    yield from failing_calls(trial.tiny(), trial.many(20), SEED + 2, "EDQUOT")


def full_and_read_only(trial: Trial) -> Iterator[Tried]:
    """Full disks, read-only disks, limits."""
    job = run_job(trial.target, "simulation_1", *BLOCKS).known()
    largest = max(path.stat().st_size for path in trial.target.iterdir())
    needed = 2 * sum(path.stat().st_size for path in trial.target.rglob("*") if path.is_file())
    small = trial.tiny(overwrite=True)
    yield from limited_files(job, largest, trial.many(12), SEED)
    if not may_mount():
        print(NO_MOUNT, file=sys.stderr)
        return
    yield from full_disks(job, needed, trial.many(12))
    yield from full_disks(small, 100_000, trial.many(12))
    yield from read_only(small)


def power_cut_runs(trial: Trial) -> Iterator[Tried]:
    """Power cuts of runs."""
    yield from power_cuts(trial.tiny(), trial.many(25), SEED)
    yield from power_cuts(trial.tiny(overwrite=True), trial.many(25), SEED)
    yield from power_cuts(trial.tiny(scene="simulation_3"), trial.many(10), SEED)
    yield from power_cuts(run_job(trial.target, "simulation_1", *BLOCKS, workers=2).known(), trial.many(15), SEED)


def two_runs(trial: Trial) -> Iterator[Tried]:
    """Two runs into one folder."""
    for job in (trial.tiny(), trial.tiny(overwrite=True)):
        for second in ((), ("--resume",), OVERWRITE):
            yield from two_writers(job, second, trial.many(8), SEED)


def damaged_runs(trial: Trial) -> Iterator[Tried]:
    """Damaged blocks."""
    kept, other = trial.folder / "kept", trial.folder / "other"
    job = run_job(trial.target, "simulation_1", *BLOCKS).known()
    interrupted(run_job(trial.target, "simulation_1", *BLOCKS, "--seed", 1).known(), other)
    interrupted(job, kept)
    yield from damaged(job, kept, other, trial.many(3), SEED)


def other_commands(trial: Trial) -> Iterator[Tried]:
    """All faults on the commands besides `run`."""
    for job in output_jobs(trial.folder, trial.target):
        second = OVERWRITE if "--overwrite" in job.arguments else ()
        yield from kills.killed_outputs(job, trial.many(6), SEED)
        yield from kills.ended_by(signal.SIGTERM, (-signal.SIGTERM,), job, 1)
        yield from kills.ended_by(signal.SIGINT, (130,), job, 1)
        yield from failing_calls(job, trial.many(25))
        yield from two_writers(job, second, trial.many(3), SEED)
        yield from power_cuts(job, trial.many(5), SEED)


CLASSES: dict[str, Callable[[Trial], Iterator[Tried]]] = {
    "kills": killed_runs,
    "calls": failing_runs,
    "disk": full_and_read_only,
    "power": power_cut_runs,
    "writers": two_runs,
    "damage": damaged_runs,
    "commands": other_commands,
}


def try_class(name: str, share: float, show: bool) -> list[dict[str, Any]]:
    """All faults of a class, as rows of the table."""
    tried = []
    folder = tempfile.mkdtemp(prefix="faults_")  # a `TemporaryDirectory` would be removed by the first fork that ends
    try:
        trial = Trial(Path(folder), share)
        trial.target.parent.mkdir()
        started = time.monotonic()
        for one in CLASSES[name](trial):
            tried.append(one)
            if show or one.outcome.value == "failure":
                said = re.sub(r"\s+", " ", one.said)[-200:]
                print(f"{one.fault}: {one.case}: {one.outcome.value}: {said}", file=sys.stderr, flush=True)
        print(f"{name}: {len(tried)} faults in {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
        return rows_of(tried, folder)
    finally:
        shutil.rmtree(folder)


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign faults", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=CLASSES, help="the others stay as they are written")
    parser.add_argument("--share", type=float, default=1.0, help="of the faults, for a try")
    parser.add_argument("--out", type=Path, default=OUT, help="the result")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page with the table")
    parser.add_argument("--show", action="store_true", help="say each outcome, not failures only")
    options = parser.parse_args()
    check_strace()
    commands.prepare()
    found = read_rows(options.out) if options.only else {}
    for name in options.only or CLASSES:
        found[name] = try_class(name, options.share, options.show)
        versions = {"modsim3d": version("modsim3d"), "Linux": Path("/proc/sys/kernel/osrelease").read_text().strip()}
        ordered = {key: found[key] for key in CLASSES if key in found}
        data = json.dumps({"format": 1, "versions": versions, "classes": ordered}, indent=2)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(data + "\n", encoding="utf-8")
        write_between(options.page, table(ordered))
    return int(any(row["failures"] for rows in found.values() for row in rows))


if __name__ == "__main__":
    sys.exit(main())
