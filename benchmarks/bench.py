"""Times modsim3d against what was promised, and writes benchmarks/RESULTS.md.

Everything that is compared is timed in turn, in processes of its own, one round after another; a figure is the median
of the rounds. A figure that falls short is reported as it is, with a profile. Exit status 0 unless something breaks.
"""

from __future__ import annotations

import argparse
import contextlib
import filecmp
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks import scenes

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "RESULTS.md"
COUNTS = (25, 50, 100, 200)
PATIENCE_S = 3600
BUSY_LOAD = 0.5
"""More than this many processes waiting for a core before the start, and the figures are marked."""

MB = 1e6
Answer = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        figure: What was measured.
        promise: What it should be; empty if nothing was promised.
        measured: What it is.
        met: Whether it is; None if nothing was promised.
        limit: The time over the time that memory needs for the drawn regions, as text.
    """

    figure: str
    promise: str
    measured: str
    met: bool | None
    limit: str

    def cells(self) -> list[str]:
        """Its cells in the table."""
        verdict = {True: "yes", False: "**no**", None: "–"}[self.met]
        return [self.figure, self.promise or "–", self.measured, verdict, self.limit]


@dataclass
class Found:
    """What measuring gave."""

    rows: list[Row] = field(default_factory=list)
    sections: list[str] = field(default_factory=list)
    profiles: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Bench:
    """How much to measure, and where.

    Attributes:
        quick: One round of little work: a trial of the bench and not a measurement.
        folder: For files that are thrown away.
        bytes_per_s: Memory bandwidth of this machine.
    """

    quick: bool
    folder: Path
    bytes_per_s: float

    def rounds(self, wanted: int = 5) -> Iterator[int]:
        """The rounds of a figure."""
        for number in range(1 if self.quick else wanted):
            say(f"  round {number + 1}")
            yield number

    def steps(self, wanted: int) -> int:
        """That many steps, or a tenth of them in a trial."""
        return max(wanted // 10, 1) if self.quick else wanted

    def times_limit(self, seconds: float, drawn_bytes: float) -> str:
        """How many times longer than memory needs to be written with what is drawn."""
        if not drawn_bytes:
            return "nothing is drawn"
        return significant(seconds * self.bytes_per_s / drawn_bytes)

    def scene(self, name: str, text: str) -> str:
        """A scene file of that text, with paths that hold where it is."""
        path = self.folder / f"{name}.yaml"
        detectors = (ROOT / "scenes" / "detectors").as_posix()
        path.write_text(
            text.replace("../scenes/detectors", detectors).replace("detector: detectors", f"detector: {detectors}")
        )
        return str(path)


# ---- processes ---------------------------------------------------------------------------------


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def environment() -> dict[str, str]:
    """That of the processes: as the command line sets it, and the same for the baselines."""
    kept = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    settings = {
        "LP_NUM_THREADS": "0",
        "OPENBLAS_NUM_THREADS": "1",
        "JE_ARROW_MALLOC_CONF": "background_thread:false",
    }
    return {**kept, **settings, "PYTHONPATH": path}


def child(name: str, **given: Any) -> Answer:
    """What benchmarks/child.py answers, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.child", name, json.dumps(given)]
    done = subprocess.run(
        command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE_S
    )
    answer: Answer = json.loads(done.stdout.splitlines()[-1])
    return answer


@contextlib.contextmanager
def server(passes: str, scene: str) -> Iterator[Callable[[str, Sequence[int]], Answer]]:
    """A process that answers one request after another, so that two can be timed in turn."""
    command = [sys.executable, "-m", "benchmarks.child", "serve", json.dumps({"passes": passes, "scene": scene})]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment(), cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin and process.stdout

        def answer() -> Answer:
            line = process.stdout.readline()
            if not line:
                raise RuntimeError(f"the process of the pass '{passes}' died")
            found: Answer = json.loads(line)
            return found

        def ask(what: str, frames: Sequence[int]) -> Answer:
            process.stdin.write(json.dumps({"do": what, "frames": list(frames)}) + "\n")
            process.stdin.flush()
            return answer()

        try:
            answer()
            yield ask
        finally:
            process.stdin.close()


@dataclass(frozen=True)
class Finished:
    """A command that was run: seconds by the clock, and the most memory that it held."""

    seconds: float
    peak_bytes: int


def modsim3d(*arguments: str | Path) -> Finished:
    """Run the program as a user does."""
    command = [Path(sys.executable).parent / "modsim3d", *arguments]
    kept = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    with tempfile.TemporaryFile() as said:
        started = time.perf_counter()
        process = subprocess.Popen(command, env=kept, cwd=ROOT, stdout=said, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise RuntimeError(f"{' '.join(map(str, command))} failed:\n{said.read().decode()}")
    return Finished(seconds, usage.ru_maxrss * 1024)


# ---- numbers -----------------------------------------------------------------------------------


def significant(value: float, digits: int = 3) -> str:
    """A number with three digits, without exponent."""
    if value == 0:
        return "0"
    places = max(digits - 1 - int(f"{value:e}".partition("e")[2]), 0)
    return f"{round(value, places):,.{places}f}" if places else f"{float(f'{value:.{digits}g}'):,.0f}"


def spread(values: Sequence[float], unit: str = "") -> str:
    """Median, and least to greatest."""
    middle = f"{significant(statistics.median(values))}{unit}"
    if len(values) == 1:
        return f"{middle} (one round)"
    return f"{middle} ({significant(min(values))}–{significant(max(values))})"


def ratios(upper: Sequence[float], lower: Sequence[float]) -> list[float]:
    """Round by round."""
    return [a / b for a, b in zip(upper, lower, strict=True)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def profile_text(title: str, rows: Sequence[Sequence[str]]) -> str:
    return f"### {title}\n\n" + table(("own s", "with calls s", "calls", "where"), rows)


def profile_of_run(title: str, **given: Any) -> str:
    say("  profile, because it falls short")
    return profile_text(title, child("profile", **given)["rows"])


# ---- figures -----------------------------------------------------------------------------------


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


def growth(bench: Bench) -> Found:
    """Time per boat and frame as the boats become more; for the dense scene too."""
    steps = {"small": bench.steps(scenes.SMALL_STEPS), "dense": bench.steps(100)}
    makers = {"small": scenes.small, "dense": scenes.dense}
    asked = {
        (kind, count): {
            "scene": bench.scene(f"{kind}{count}", make(count)),
            "steps": steps[kind],
            "warm": True,
        }
        for kind, make in makers.items()
        for count in COUNTS
    }
    answers: dict[tuple[str, int], list[Answer]] = {case: [] for case in asked}
    for _ in bench.rounds():
        for case, given in asked.items():
            answers[case].append(child("run", **given))
    shares = {case: child("shares", scene=given["scene"]) for case, given in asked.items()}
    per_boat = {
        case: [answer["seconds"] / answer["frames"] / case[1] for answer in found] for case, found in answers.items()
    }
    grown = [
        max(per_boat["small", count][number] for count in COUNTS[1:]) / per_boat["small", COUNTS[0]][number]
        for number in range(len(per_boat["small", COUNTS[0]]))
    ]
    limits = {
        case: bench.times_limit(statistics.median(a["seconds"] for a in found), found[0]["drawn_bytes"])
        for case, found in answers.items()
    }
    met = statistics.median(grown) <= 1.2
    percent = [100 * (value - 1) for value in grown]
    middle = f"{statistics.median(percent):+.0f} %" + (
        f" ({min(percent):+.0f} to {max(percent):+.0f})" if len(percent) > 1 else " (one round)"
    )
    counts = ", ".join(map(str, COUNTS))
    row = Row(
        f"`small` with {counts} boats: time per boat, the greatest against that with {COUNTS[0]}",
        "≤ +20 %",
        middle,
        met,
        "; ".join(limits["small", count] for count in COUNTS),
    )
    found = Found([row])
    head = ("vessels", "µs per vessel and frame", "frames/s", "overlapping", "hidden", "wholly hidden", "× the limit")
    for kind, title in (("small", "boats far apart"), ("dense", "ships before ships")):
        lines = [
            [
                str(count),
                spread([1e6 * value for value in per_boat[kind, count]]),
                significant(1 / statistics.median(per_boat[kind, count]) / count),
                *(f"{shares[kind, count][share]:.1%}" for share in ("overlapping", "hidden", "wholly_hidden")),
                limits[kind, count],
            ]
            for count in COUNTS
        ]
        found.sections.append(f"## More vessels: `{kind}`, {title}\n\n" + table(head, lines))
    if not met:
        found.profiles += [
            profile_of_run(f"small with {count} boats, {steps['small']} frames", **asked["small", count])
            for count in (COUNTS[0], COUNTS[-1])
        ]
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
    "workers": workers,
    "memory": memory,
    "cold_start": cold_start,
}

# ---- the page ----------------------------------------------------------------------------------

METHOD = """\
## How it was measured

- What a figure compares was timed in turn, round by round, each time in a new process; a figure is the median, with \
the least and the greatest of the rounds in brackets, and a ratio is the median of the rounds' ratios.
- Frames per second are those of `run_scene` in a process that has not run before: from reading the scene file to the \
finished run directory, the renderer's start included (its context, its shaders), Python's imports and the contact \
sheet not. Where a ratio is \
meant to show how time grows (image size, number of vessels), a few steps are run first, as a constant start-up would \
make the growth look smaller. `--workers`, memory and cold start are those of the command itself, by the clock.
- The ID pass is from poses to full and visible boxes, in a process that is warm, in blocks as a run makes them, \
averaged over all 1,500 frames; pyrender draws 15 of them a round. Its renderer, scene and meshes are made once; timed \
are setting the nodes' poses, one SEG image, and the boxes of its colours. That image shows visible boxes only; those \
of whole vessels take an image of each alone, which are drawn for the check that both give the same boxes (within one \
pixel a side) and not timed. Both have `LP_NUM_THREADS=0`.
- Times the limit: the bytes of colour (4) and depth (4) of the pixels in the regions that were drawn, over the \
bandwidth of a plain NumPy fill, is the least time that drawing could take; the column says how many times that the \
measured time is. Where only overlaps are drawn, it is little, and the time is spent on everything else.
- Overlapping: the share of vessels whose box overlaps another's. The `small` scenes are seen from the higher, the \
more boats there are, so that this share stays."""


def page(found: Found, quick: bool, bytes_per_s: float, load: float) -> str:
    """RESULTS.md."""
    machine = child("machine")
    cores = len(os.sched_getaffinity(0))
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    lines = ["# Benchmarks", "", "Written by `script/bench`; do not edit.", ""]
    if quick:
        lines += ["**A quick trial: one round of little work. These are not the figures.**", ""]
    lines += [
        f"- Processor: {machine['processor']}, {cores} cores; memory: {machine['memory_gib']:.1f} GiB",
        f"- Renderer: {machine['renderer']}",
        f"- {versions}",
        f"- Memory bandwidth, a plain NumPy fill: {bytes_per_s / 1e9:.1f} GB/s",
    ]
    if load > BUSY_LOAD:
        lines.append(f"- **The machine was not idle: a load of {load:.1f} before it began.**")
    lines += ["", table(("Figure", "Promise", "Measured", "Met", "× the limit"), [row.cells() for row in found.rows])]
    for section in (*found.sections, METHOD):
        lines += ["", section]
    if found.profiles:
        lines += ["", "## Profiles of what falls short", "", "Under cProfile, which slows small functions down."]
        for profile in found.profiles:
            lines += ["", profile]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="script/bench", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one round of little work, to try it out")
    parser.add_argument("--only", action="append", choices=FIGURES, metavar="NAME", help=", ".join(FIGURES))
    parser.add_argument("--out", type=Path, help="file (benchmarks/RESULTS.md if everything is measured, else none)")
    asked = parser.parse_args()
    load = os.getloadavg()[0]
    bytes_per_s = child("bandwidth")["bytes_per_s"]
    found = Found()
    with tempfile.TemporaryDirectory(prefix="modsim3d-bench-") as folder:
        for name in asked.only or FIGURES:
            say(name)
            figure = FIGURES[name](Bench(asked.quick, Path(folder), bytes_per_s))
            for kind in ("rows", "sections", "profiles"):
                getattr(found, kind).extend(getattr(figure, kind))
            for row in figure.rows:
                say(f"  {' | '.join(row.cells())}")
    text = page(found, asked.quick, bytes_per_s, load)
    out = asked.out or (RESULTS if not (asked.quick or asked.only) else None)
    if out is not None:
        out.write_text(text, encoding="utf-8", newline="\n")
    print(text, end="")


if __name__ == "__main__":
    main()
