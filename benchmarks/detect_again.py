"""Times the detector alone over the truth of a finished run, as `modsim3d detect RUN --detector-seed 7` runs it.

`python -m benchmarks.detect_again RUN` times it in this process, which is warm, and prints the seconds as JSON.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.measured import Bench, Found, Row, significant, spread
from benchmarks.processes import PATIENCE_S, ROOT, environment, modsim3d

GOAL_S = 0.06
WARM_UPS, TIMES = 2, 7


def detect_again(bench: Bench) -> Found:
    """The figure: Simulation 1 with another seed of its detector, all files."""
    steps, out = bench.steps(1500), bench.folder / "detected_again"
    modsim3d("run", "simulation_1", "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", out)
    command = [sys.executable, "-m", "benchmarks.detect_again", str(out)]
    wall, processor = [], []
    for _ in bench.rounds():
        done = subprocess.run(
            command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE_S
        )
        answer = json.loads(done.stdout)
        wall.append(answer["wall_s"])
        processor.append(answer["processor_s"])
    shutil.rmtree(out)
    return Found(
        [
            Row(
                f"`detect_run` over a stored truth, Simulation 1, {steps:,} steps, all files, in a warm process",
                f"≤ {GOAL_S:g} s",
                f"{spread(wall, ' s')}; {significant(statistics.median(processor))} s of the processor",
                statistics.median(wall) <= GOAL_S,
                "nothing is drawn",
            )
        ]
    )


def main() -> None:
    """Run the detector over a finished run a few times; print the median of the seconds."""
    from modsim3d.runs.run import detect_run

    wall, processor = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(WARM_UPS + TIMES):
            started, used = time.perf_counter(), time.process_time()
            detect_run(sys.argv[1], Path(folder) / str(number), seed=7)
            wall.append(time.perf_counter() - started)
            processor.append(time.process_time() - used)
    medians = {"wall_s": statistics.median(wall[WARM_UPS:]), "processor_s": statistics.median(processor[WARM_UPS:])}
    print(json.dumps(medians))


if __name__ == "__main__":
    main()
