"""The figures of commands as a user runs them, by the clock: workers, memory, start, and a live step."""

from __future__ import annotations

import filecmp
import os
import resource
import shutil
import statistics
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.latency import FIRST, latencies_s, live_scene
from benchmarks.measured import Bench, Found, Row, profile_of_run, profile_text, ratios, significant, spread
from benchmarks.processes import ROOT, child, environment, finished, modsim3d, say

MB = 1e6


def workers(bench: Bench) -> Found:
    """Two processes against one, through the command line: a run of seconds, and one ten times as long."""
    short, long = (bench.steps(steps) for steps in (20_000, 200_000))
    found = Found([_workers(bench, short, 5), _workers(bench, long, 3), _two_runs(bench, short)])
    if not all(row.met for row in found.rows[:2]):
        asked = {"scene": "simulation_1", "steps": short, "mode": 2}
        found.profiles += [
            profile_of_run(f"one worker, {short:,} steps", **asked),
            profile_of_run(f"two workers, {short:,} steps: the process that they work for", **asked, workers=2),
        ]
    return found


def _workers(bench: Bench, steps: int, rounds: int) -> Row:
    figure = f"`--workers 2` against 1, Simulation 1, mode 2, {steps:,} steps"
    promise = "≥ 1.8 ×, same bytes"
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        return Row(figure, promise, "not measured: one core", False, "–")
    taken: dict[int, list[float]] = {1: [], 2: []}
    different: set[str] = set()
    for _ in bench.rounds(rounds):
        folders = {count: bench.folder / f"workers{count}" for count in taken}
        for count, out in folders.items():
            command = ("run", "simulation_1", "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", out)
            taken[count].append(modsim3d(*command, "--workers", str(count)).seconds)
        different |= differing_files(folders[1], folders[2])
        for out in folders.values():
            shutil.rmtree(out)
    faster = ratios(taken[1], taken[2])
    same = "all files the same bytes" if not different else f"different: {', '.join(sorted(different))}"
    met = statistics.median(faster) >= 1.8 and not different
    first = child("run", scene="simulation_1", steps=bench.steps(1500), mode=2)  # the regions are as large later on
    drawn = first["drawn_bytes"] * steps / first["frames"]
    limit = bench.times_limit(statistics.median(taken[2]), drawn)
    seconds = f"{significant(statistics.median(taken[1]))} s and {significant(statistics.median(taken[2]))} s"
    return Row(figure, promise, f"{spread(faster, ' ×')}; {seconds}; {same}", met, limit)


def _two_runs(bench: Bench, steps: int) -> Row:
    """Two runs of one process each at the same time: what two processes that share nothing gain on this machine."""
    alone, together = [], []
    command = ("run", "simulation_1", "--mode", "2", "--steps", str(steps), "--no-sheet", "--out")
    folders = [bench.folder / f"run{number}" for number in range(2)]
    for _ in bench.rounds(5):
        alone.append(modsim3d(*command, folders[0]).seconds)
        shutil.rmtree(folders[0])
        with ThreadPoolExecutor(len(folders)) as threads:
            together.append(max(run.seconds for run in threads.map(partial(modsim3d, *command), folders)))
        for out in folders:
            shutil.rmtree(out)
    gain = ratios([2 * seconds for seconds in alone], together)
    seconds = f"{significant(statistics.median(alone))} s and {significant(statistics.median(together))} s"
    figure = f"two such runs of {steps:,} steps at the same time against one after the other, start and end shared too"
    return Row(figure, "", f"{spread(gain, ' ×')}; {seconds}", None, "nothing is drawn")


def differing_files(one: Path, other: Path) -> set[str]:
    """Files of two run directories that are not the same bytes; run.log holds times and may differ."""
    names = {path.relative_to(folder).as_posix() for folder in (one, other) for path in folder.rglob("*")}
    files = {name for name in names if name != "run.log" and not ((one / name).is_dir() and (other / name).is_dir())}
    both = {name for name in files if (one / name).is_file() and (other / name).is_file()}
    return (files - both) | {name for name in both if not filecmp.cmp(one / name, other / name, shallow=False)}


def memory(bench: Bench) -> Found:
    """Peak memory of a long run and of one ten times as long; one round, as the memory does not vary."""
    peaks = {}
    for steps in (bench.steps(20_000), bench.steps(200_000)):
        say(f"  {steps:,} steps")
        out = bench.folder / "memory"
        command = ("run", "simulation_1", "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", out)
        peaks[steps] = modsim3d(*command).peak_bytes
        shutil.rmtree(out)
    # A process starts with what the one that started it held.
    if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 >= min(peaks.values()):
        raise RuntimeError("this process holds more memory than those that it measures")
    (fewer, least), (more, most) = peaks.items()
    change = most / least - 1
    measured = f"{most / MB:.0f} MB, {change:+.1%} against {least / MB:.0f} MB with {fewer:,}; one round"
    met = most <= 300 * MB and abs(change) <= 0.1
    promise = "≤ 300 MB, and within 10 % of a tenth of the steps"
    return Found([Row(f"Peak memory, {more:,} steps, one process", promise, measured, met, "no time")])


def cold_start(bench: Bench) -> Found:
    """From the command to the first frame, and to the help text; and the import of the package."""
    first, help_, imported = [], [], []
    out = bench.folder / "cold"
    command = ("run", "simulation_1", "--mode", "2", "--steps", "1", "--no-sheet", "--out", out)
    modsim3d(*command)  # keeps the byte code
    shutil.rmtree(out)
    for _ in bench.rounds(7):
        first.append(modsim3d(*command).seconds)
        shutil.rmtree(out)
        help_.append(modsim3d("--help").seconds)
        imported.append(finished([sys.executable, "-c", "import modsim3d"]).seconds)
    drawn = child("run", scene="simulation_1", steps=1, mode=2)["drawn_bytes"]
    limit = bench.times_limit(statistics.median(first), drawn)
    found = Found(
        [
            Row(
                "Cold start: `modsim3d run simulation_1 --mode 2 --steps 1 --no-sheet`",
                "≤ 0.6 s",
                spread(first, " s"),
                statistics.median(first) <= 0.6,
                limit,
            ),
            Row(
                "`modsim3d --help`", "< 0.3 s", spread(help_, " s"), statistics.median(help_) < 0.3, "nothing is drawn"
            ),
            Row(
                "`python -c 'import modsim3d'`, Python's start included",
                "≤ 0.6 s",
                spread(imported, " s"),
                statistics.median(imported) <= 0.6,
                "nothing is drawn",
            ),
        ]
    )
    for row, arguments in zip(found.rows, (command, ("--help",), ("--version",)), strict=True):
        if not row.met:
            found.profiles.append(imports_text(arguments))
            shutil.rmtree(out, ignore_errors=True)
    return found


def imports_text(arguments: Sequence[str | Path]) -> str:
    """What a start imports, by Python's own `-X importtime`."""
    command = [sys.executable, "-X", "importtime", "-m", "modsim3d.cli.main", *map(str, arguments)]
    done = subprocess.run(command, env=environment(), cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [line.removeprefix("import time:").split("|") for line in done.stderr.splitlines() if "|" in line]
    timed = sorted(((int(own), int(total), name.strip()) for own, total, name in lines[1:]), reverse=True)[:12]
    title = f"imports of modsim3d {arguments[0]}"
    rows = [[f"{own / 1e6:.3f}", f"{total / 1e6:.3f}", "1", name] for own, total, name in timed]
    return profile_text(title, rows)


def live_step(bench: Bench) -> Found:
    """From a line of poses in to the step's last line out, Simulation 2."""
    steps, seconds = 60 if bench.quick else 1000, []
    poses = live_scene(ROOT / "scenes" / "simulation_2.yaml", bench.folder, steps)
    for _ in bench.rounds(3):
        seconds += latencies_s(bench.folder / "live.yaml", poses, "-")[FIRST:]
    middle_ms, last_ms = (1e3 * float(np.percentile(seconds, share)) for share in (50, 99))
    measured = f"{significant(middle_ms)} ms; {significant(last_ms)} ms; {len(seconds):,} steps"
    figure = "A live step of Simulation 2 (`modsim3d stream`), median; 99th percentile"
    return Found([Row(figure, "≤ 1.5 ms; ≤ 3 ms", measured, middle_ms <= 1.5 and last_ms <= 3, "not counted")])
