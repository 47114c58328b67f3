"""The figures of the table in benchmarks/RESULTS.md."""

from __future__ import annotations

import filecmp
import os
import resource
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.detect_again import detect_again
from benchmarks.growth import growth
from benchmarks.measured import Bench, Found, Row, profile_of_run, profile_text, ratios, significant, spread
from benchmarks.processes import ROOT, Answer, child, environment, modsim3d, say, server

MB = 1e6


def id_pass(bench: Bench) -> Found:
    """The ID pass against pyrender's SEG image."""
    frames, samples = 1500, 3 if bench.quick else 15
    found, ours, theirs = Found(), [], []
    with server("ours", "simulation_1") as our, server("pyrender", "simulation_1") as their:
        check_boxes(our, their, range(0, 1500, 1500 // samples))
        for number in bench.rounds():
            ours.append(our("time", range(frames)))
            theirs.append(their("time", range(7 * number, 1500, 1500 // samples)[:samples]))
        our_s = [answer["seconds"] / frames for answer in ours]
        their_s = [answer["seconds"] / samples for answer in theirs]
        render_ms = 1e3 * statistics.median(answer["render_seconds"] for answer in theirs) / samples
        faster = ratios(their_s, our_s)
        met = statistics.median(faster) >= 60
        limit = bench.times_limit(statistics.median(our_s), ours[0]["drawn_bytes"] / frames)
        their_limit = bench.times_limit(statistics.median(their_s), theirs[0]["drawn_bytes"] / samples)
        measured = (
            f"{spread(faster, ' ×')}; {significant(1e3 * statistics.median(our_s))} ms against "
            f"{significant(1e3 * statistics.median(their_s))} ms a frame, {significant(render_ms)} of them in `render`"
        )
        figure = "ID pass, Simulation 1's frames, against `pyrender.OffscreenRenderer` SEG, same boxes"
        found.rows.append(Row(figure, "≥ 60 × faster", measured, met, f"{limit}; pyrender {their_limit}"))
        if not met:
            found.profiles.append(profile_text("ID pass", our("profile", range(frames))["rows"]))
    return found


def check_boxes(
    our: Callable[[str, Sequence[int]], Answer], their: Callable[[str, Sequence[int]], Answer], frames: Sequence[int]
) -> None:
    """Both give the same vessels, and full and visible boxes within one pixel a side."""
    for frame, mine, other in zip(frames, our("boxes", frames)["boxes"], their("boxes", frames)["boxes"], strict=True):
        if mine.keys() != other.keys():
            raise RuntimeError(f"frame {frame}: the ID pass shows {sorted(mine)}, pyrender {sorted(other)}")
        for vessel in mine:
            for kind, a, b in zip(("full", "visible"), mine[vessel], other[vessel], strict=True):
                same = a is b is None or (a and b and max(abs(p - q) for p, q in zip(a, b, strict=True)) <= 1)
                if not same:
                    raise RuntimeError(f"frame {frame}, {vessel}, {kind} box: ID pass {a}, pyrender {b}")


def simulation_1(bench: Bench) -> Found:
    """A whole run, and the same with corner projection only."""
    steps, found = bench.steps(1500), Found()
    asked = {"scene": "simulation_1", "steps": steps, "mode": 2}
    corners = {"scene": "simulation_1", "steps": steps, "mode": 0, "source": "analytic"}
    commands = {"rendered": ("--mode", "2"), "analytic": ("--mode", "0", "--source", "analytic")}
    by_the_clock: dict[str, list[float]] = {source: [] for source in commands}
    rendered, analytic = [], []
    for _ in bench.rounds():
        rendered.append(child("run", **asked))
        analytic.append(child("run", **corners))
        for source, options in commands.items():
            out = bench.folder / source
            command = ("run", "simulation_1", *options, "--steps", str(steps), "--out", out)
            by_the_clock[source].append(modsim3d(*command).seconds)
            shutil.rmtree(out)
    seconds = [answer["seconds"] for answer in rendered]
    rates = ratios([answer["frames"] for answer in rendered], seconds)
    slower = ratios(seconds, [answer["seconds"] for answer in analytic])
    whole = by_the_clock["rendered"]
    whole_slower = ratios(whole, by_the_clock["analytic"])
    drawn = rendered[0]["drawn_bytes"]
    limit = bench.times_limit(statistics.median(seconds), drawn)
    fast, near = statistics.median(rates) >= 1000, statistics.median(slower) <= 1.5
    run = "`modsim3d run simulation_1 --mode 2`"
    found.rows += [
        Row(f"{run}, all files, one process", "≥ 1,000 frames/s", spread(rates, " frames/s"), fast, limit),
        Row("the same against `--source analytic --mode 0`", "≤ 1.5 × the time", spread(slower, " ×"), near, limit),
        Row(
            "both commands by the clock: Python's start and the contact sheet too",
            "",
            f"{spread(whole, ' s')} for {steps:,} frames; {spread(whole_slower, ' ×')} the analytic one's time",
            None,
            bench.times_limit(statistics.median(whole), drawn),
        ),
    ]
    if not (fast and near):
        found.profiles.append(profile_of_run(f"Simulation 1, {steps:,} frames", **asked))
    return found


def frame_rate(name: str, what: str, promised: float) -> Callable[[Bench], Found]:
    """The figure of one of the scene files beside this one."""

    def figure(bench: Bench) -> Found:
        asked = {"scene": f"benchmarks/{name}.yaml"}
        if bench.quick:
            asked["steps"] = 30
        answers = [child("run", **asked) for _ in bench.rounds()]
        rates = ratios([answer["frames"] for answer in answers], [answer["seconds"] for answer in answers])
        limit = bench.times_limit(statistics.median(answer["seconds"] for answer in answers), answers[0]["drawn_bytes"])
        shares = child("shares", scene=asked["scene"])
        met = statistics.median(rates) >= promised
        measured = f"{spread(rates, ' frames/s')}; {shares_text(shares)}"
        found = Found([Row(f"`{name}.yaml`: {what}", f"≥ {promised:g} frames/s", measured, met, limit)])
        if not met:
            found.profiles.append(profile_of_run(f"{name}.yaml, {answers[0]['frames']} frames", **asked))
        return found

    return figure


def shares_text(shares: Answer) -> str:
    seen_in_part = (shares["hidden"] - shares["wholly_hidden"]) / (1 - shares["wholly_hidden"])
    return (
        f"the boxes of {shares['overlapping']:.0%} overlap another's, {shares['hidden']:.0%} are hidden in part or "
        f"wholly; of those seen {seen_in_part:.0%} in part"
    )


def image_size(bench: Bench) -> Found:
    """Four times the pixels, same view."""
    text = (ROOT / "scenes" / "simulation_1.yaml").read_text(encoding="utf-8")
    changes = {
        "pixel_size_m: [1.0e-5, 1.0e-5]": "pixel_size_m: [0.5e-5, 0.5e-5]",
        "principal_point_px: [1800, 1200]": "principal_point_px: [3600, 2400]",
        "image_size_px: [3600, 2400]": "image_size_px: [7200, 4800]",
    }
    for old, new in changes.items():
        if text.count(old) != 1:
            raise RuntimeError(f"scenes/simulation_1.yaml has no '{old}'")
        text = text.replace(old, new)
    asked = {"steps": bench.steps(1500), "mode": 2, "warm": True}
    large = {"scene": bench.scene("simulation_1_large", text), **asked}
    usual, larger = [], []
    for _ in bench.rounds():
        usual.append(child("run", scene="simulation_1", **asked))
        larger.append(child("run", **large))
    large_s = [answer["seconds"] for answer in larger]
    longer = ratios(large_s, [answer["seconds"] for answer in usual])
    met = statistics.median(longer) <= 1.5
    limit = bench.times_limit(statistics.median(large_s), larger[0]["drawn_bytes"])
    figure = "Simulation 1 at 7200 × 4800 instead of 3600 × 2400"
    found = Found([Row(figure, "≤ 1.5 × the time", spread(longer, " ×"), met, limit)])
    if not met:
        found.profiles.append(profile_of_run("Simulation 1 at 7200 × 4800", **large))
    return found


def workers(bench: Bench) -> Found:
    """Two processes against one, through the command line."""
    steps = bench.steps(20_000)
    figure = f"`--workers 2` against 1, Simulation 1, mode 2, {steps:,} steps"
    promise = "≥ 1.7 ×, same bytes"
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        return Found([Row(figure, promise, "not measured: one core", False, "–")])
    taken: dict[int, list[float]] = {1: [], 2: []}
    different: set[str] = set()
    for _ in bench.rounds():
        folders = {count: bench.folder / f"workers{count}" for count in taken}
        for count, out in folders.items():
            command = ("run", "simulation_1", "--mode", "2", "--steps", str(steps), "--no-sheet", "--out", out)
            taken[count].append(modsim3d(*command, "--workers", str(count)).seconds)
        different |= differing_files(folders[1], folders[2])
        for out in folders.values():
            shutil.rmtree(out)
    faster = ratios(taken[1], taken[2])
    same = "all files the same bytes" if not different else f"different: {', '.join(sorted(different))}"
    met = statistics.median(faster) >= 1.7 and not different
    first = child("run", scene="simulation_1", steps=bench.steps(1500), mode=2)  # the regions are as large later on
    drawn = first["drawn_bytes"] * steps / first["frames"]
    limit = bench.times_limit(statistics.median(taken[2]), drawn)
    seconds = f"{significant(statistics.median(taken[1]))} s and {significant(statistics.median(taken[2]))} s"
    found = Found([Row(figure, promise, f"{spread(faster, ' ×')}; {seconds}; {same}", met, limit)])
    if not met:
        asked = {"scene": "simulation_1", "steps": steps, "mode": 2}
        found.profiles += [
            profile_of_run(f"one worker, {steps:,} steps", **asked),
            profile_of_run(f"two workers, {steps:,} steps: the process that they work for", **asked, workers=2),
        ]
    return found


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
    met = most < 600 * MB and abs(change) <= 0.1
    promise = "< 600 MB, and within 10 % of a tenth of the steps"
    return Found([Row(f"Peak memory, {more:,} steps, one process", promise, measured, met, "no time")])


def cold_start(bench: Bench) -> Found:
    """From the command to the first frame, and to the help text."""
    first, help_ = [], []
    out = bench.folder / "cold"
    command = ("run", "simulation_1", "--mode", "2", "--steps", "1", "--no-sheet", "--out", out)
    for _ in bench.rounds(7):
        first.append(modsim3d(*command).seconds)
        shutil.rmtree(out)
        help_.append(modsim3d("--help").seconds)
    drawn = child("run", scene="simulation_1", steps=1, mode=2)["drawn_bytes"]
    limit = bench.times_limit(statistics.median(first), drawn)
    found = Found(
        [
            Row(
                "Cold start: `modsim3d run simulation_1 --mode 2 --steps 1 --no-sheet`",
                "< 1.5 s",
                spread(first, " s"),
                statistics.median(first) < 1.5,
                limit,
            ),
            Row(
                "`modsim3d --help`", "< 0.3 s", spread(help_, " s"), statistics.median(help_) < 0.3, "nothing is drawn"
            ),
        ]
    )
    for row, arguments in zip(found.rows, (command, ("--help",)), strict=True):
        if not row.met:
            found.profiles.append(imports_text(arguments))
            shutil.rmtree(out, ignore_errors=True)
    return found


def imports_text(arguments: Sequence[str | Path]) -> str:
    """What a start imports, by Python's own `-X importtime`."""
    command = [sys.executable, "-X", "importtime", "-m", "modsim3d.cli", *map(str, arguments)]
    done = subprocess.run(command, env=environment(), cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [line.removeprefix("import time:").split("|") for line in done.stderr.splitlines() if "|" in line]
    timed = sorted(((int(own), int(total), name.strip()) for own, total, name in lines[1:]), reverse=True)[:12]
    title = f"imports of modsim3d {arguments[0]}"
    rows = [[f"{own / 1e6:.3f}", f"{total / 1e6:.3f}", "1", name] for own, total, name in timed]
    return profile_text(title, rows)


FIGURES: dict[str, Callable[[Bench], Found]] = {
    "id_pass": id_pass,
    "simulation_1": simulation_1,
    "small": frame_rate("small", "50 boats of 4–14 m at 300–2500 m, all files, one process", 200),
    "dense": frame_rate("dense", "50 vessels of 5–300 m at 300–2500 m, all files, one process", 60),
    "image_size": image_size,
    "growth": growth,
    "detect_again": detect_again,
    "workers": workers,
    "memory": memory,
    "cold_start": cold_start,
}
