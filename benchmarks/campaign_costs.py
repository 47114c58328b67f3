"""Measures what a campaign costs, and writes benchmarks/CAMPAIGNS.md.

Runs benchmarks/thousand.yaml as a user does, a fifth of it with one process and with two, and times the parts from
which the cost of a far larger campaign is worked out. Run it with `python -m benchmarks.campaign_costs`; `--quick` is a
trial that writes nothing, `--keep DIR` keeps the folder of the 1,000 runs.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml

from benchmarks.processes import ROOT, environment
from modsim3d.campaign.file.reading import read_campaign
from modsim3d.campaign.results.folder import opened_campaign
from modsim3d.campaign.results.gather import results_table
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.work.layers import Layers, detected, tracks_of, truth_of_scene
from modsim3d.campaign.work.row import row_of, rules_of

RESULTS = ROOT / "benchmarks" / "CAMPAIGNS.md"
CAMPAIGN = ROOT / "benchmarks" / "thousand.yaml"
MB = 1e6
VERDICTS = (0, 1, 3)
"""Exit statuses of a campaign that ended."""


@dataclass(frozen=True)
class Cost:
    """What a campaign cost."""

    runs: int
    seconds: float
    processor_s: float
    folder_bytes: int
    hours: float
    """Simulated, of all cameras' scenes."""


def campaign(file: Path, folder: Path, workers: int) -> Cost:
    """Run a campaign as a user does."""
    command = [Path(sys.executable).parent / "modsim3d", "campaign", file, "--out", folder, "--workers", str(workers)]
    started = time.perf_counter()
    process = subprocess.Popen([*command, "-q"], env=environment(), cwd=ROOT)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - started
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in VERDICTS:
        raise RuntimeError(f"{file} ended with status {process.returncode}")
    rows = results_table(opened_campaign(folder))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    hours = sum(rows["simulated_s"].to_pylist()) / 3600
    return Cost(len(rows), seconds, usage.ru_utime + usage.ru_stime, size, hours)


def smaller(seeds: int, folder: Path, name: str) -> Path:
    """The campaign with fewer seeds."""
    content = yaml.safe_load(CAMPAIGN.read_text(encoding="utf-8")) | {"seeds": {"traffic": seeds}}
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def layer_seconds(count: int) -> dict[str, float]:
    """Median processor time of each layer of a run, in this process."""
    plan = checked(read_campaign(CAMPAIGN)).plan
    layers, rules = Layers(plan.keys, ROOT), rules_of(plan.keys.score)
    layers.made(plan.run(0))
    times: dict[str, list[float]] = {"truth": [], "detections": [], "tracks": [], "scores": []}

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        started = time.process_time()
        yield
        times[name].append(time.process_time() - started)

    for number in range(plan.runs_by_seed, plan.runs_by_seed + count):
        run = plan.run(number)
        scene = layers.scene(run)
        with timed("truth"):
            blocks = truth_of_scene(scene, layers.renderer(scene))
        with timed("detections"):
            rows = detected(scene, blocks)
        with timed("tracks"):
            tracks_of(rows, layers.tracker(run, scene))
        made = layers.made(run)
        with timed("scores"):
            row_of(number, made, rules)
    layers.close()
    return {name: statistics.median(values) for name, values in times.items()}
