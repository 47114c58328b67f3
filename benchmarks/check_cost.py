"""What the cross-check costs: the command `run` with and without it, in turn, at the shipped length of each scene.

    python -m benchmarks.check_cost [ROUNDS]

It prints processor seconds, since a busy machine changes them less than the clock: of the command without the check,
contact sheet included, and of the check within the command, the loading of OpenGL included if the check is the first
to use it. They are the medians of the rounds.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import orjson

SCENES = ("simulation_1", "simulation_2", "simulation_3", "harbour", "fairway", "strait")
ROUNDS = 5
MAX_SHARE = 0.10
"""Of the command's time."""
COMMAND = """
import sys, time
from modsim3d.cli import main as cli
from modsim3d.runs import workers

spent, check = [0.0], workers.check_block
def timed(*arguments):
    began = time.process_time()
    try:
        return check(*arguments)
    finally:
        spent[0] += time.process_time() - began
workers.check_block = timed
try:
    cli.main()
finally:
    print(spent[0], time.process_time())
"""


def seconds(scene: str, check: str, out: Path) -> tuple[float, float]:
    """Processor time of the check in a run, and of the whole command."""
    options = ("--set", f"annotation.check={check}", "--quiet", "--overwrite", "--out", str(out))
    line = [sys.executable, "-c", COMMAND, "run", scene, *options]
    said = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()
    return float(said[-2]), float(said[-1])


def row(scene: str, rounds: int, folder: Path) -> tuple[str, bool]:
    """A row of the table, and whether the check costs little enough."""
    whole, checks = [], []
    for _ in range(rounds):
        whole.append(seconds(scene, "off", folder / "off")[1])
        checks.append(seconds(scene, "sample", folder / "sample")[0])
    checked = orjson.loads((folder / "sample" / "run.json").read_bytes())["crosscheck"]
    command_s, check_s = statistics.median(whole), statistics.median(checks)
    figures = (
        checked["frames"],
        checked["vessels"],
        f"{command_s:.2f}",
        f"{check_s:.3f}",
        f"{check_s / command_s:.1%}",
    )
    return f"| {scene} | " + " | ".join(map(str, figures)) + " |", check_s <= MAX_SHARE * command_s


def main() -> None:
    """Print the table; exit status 1 if the check of a scene costs too much."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    print("| scene | frames | vessels | command, s | check, s | share |\n|---|---|---|---|---|---|", flush=True)
    met = True
    with tempfile.TemporaryDirectory() as folder:
        for scene in SCENES:
            line, good = row(scene, rounds, Path(folder))
            print(line, flush=True)
            met &= good
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
