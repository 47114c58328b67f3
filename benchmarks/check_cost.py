"""What the cross-check costs: the command `run` with and without it, in turn, at the shipped length of each scene.

    python -m benchmarks.check_cost [ROUNDS]

It prints the processor seconds of the command, contact sheet included, and what the check adds: the medians of the
rounds, which a busy machine changes less than the clock.
"""

from __future__ import annotations

import resource
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

import orjson

from benchmarks.processes import modsim3d

SCENES = ("simulation_1", "simulation_2", "simulation_3", "harbour", "fairway", "strait")
ROUNDS = 5
MOST_SHARE = 0.10
"""Of the command's time."""


def processor_s(scene: str, check: str, out: Path) -> float:
    """Processor time of a run."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    modsim3d("run", scene, "--set", f"annotation.check={check}", "--quiet", "--out", out, "--overwrite")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row(scene: str, rounds: int, folder: Path) -> tuple[str, bool]:
    """A row of the table, and whether the check costs little enough."""
    taken: dict[str, list[float]] = {"off": [], "sample": []}
    for _ in range(rounds):
        for check, seconds in taken.items():
            seconds.append(processor_s(scene, check, folder / f"{scene}_{check}"))
    checked = orjson.loads((folder / f"{scene}_sample" / "run.json").read_bytes())["crosscheck"]
    shutil.rmtree(folder / f"{scene}_off")
    off = statistics.median(taken["off"])
    added = statistics.median(one - other for one, other in zip(taken["sample"], taken["off"], strict=True))
    cells = (scene, checked["frames"], checked["vessels"], f"{off:.2f}", f"{added:.3f}", f"{added / off:.1%}")
    return "| " + " | ".join(map(str, cells)) + " |", added <= MOST_SHARE * off


def main() -> None:
    """Print the table; exit status 1 if the check of a scene costs too much."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    print("| scene | frames | vessels | without, s | check, s | share |\n|---|---|---|---|---|---|", flush=True)
    met = True
    with tempfile.TemporaryDirectory() as folder:
        for scene in SCENES:
            line, good = row(scene, rounds, Path(folder))
            print(line, flush=True)
            met &= good
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
