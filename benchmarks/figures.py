"""The figures of the table in benchmarks/RESULTS.md."""

from __future__ import annotations

import shutil
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import scenes
from benchmarks.detect_again import detect_again
from benchmarks.growth import growth
from benchmarks.measured import Bench, Found, Row, profile_of_run, profile_text, ratios, significant, spread
from benchmarks.processes import ROOT, Answer, child, modsim3d, server
from benchmarks.whole_commands import cold_start, live_step, memory, workers


def id_pass(bench: Bench) -> Found:
    """Boxes of the fast path, and those of ID buffers, each against pyrender's SEG image."""
    frames, samples = 1500, 3 if bench.quick else 15
    found, ours, buffered, theirs = Found(), [], [], []
    with (
        server("ours", "simulation_1") as our,
        server("buffers", "simulation_1") as buffers,
        server("pyrender", "simulation_1") as their,
    ):
        for each in (our, buffers):
            check_boxes(each, their, range(0, 1500, 1500 // samples))
        for number in bench.rounds():
            sampled = range(7 * number, 1500, 1500 // samples)[:samples]
            ours.append(our("time", range(frames)))
            buffered.append(buffers("time", sampled))
            theirs.append(their("time", sampled))
        our_s = [answer["seconds"] / frames for answer in ours]
        buffers_s, their_s = ([answer["seconds"] / samples for answer in answers] for answers in (buffered, theirs))
        render_ms = 1e3 * statistics.median(answer["render_seconds"] for answer in theirs) / samples
        faster = ratios(their_s, our_s)
        met = statistics.median(faster) >= 60
        limit = bench.times_limit(statistics.median(our_s), ours[0]["drawn_bytes"] / frames)
        their_limit = bench.times_limit(statistics.median(their_s), theirs[0]["drawn_bytes"] / samples)
        their_ms = (
            f"against {significant(1e3 * statistics.median(their_s))} ms a frame, {significant(render_ms)} of them in "
            "`render`"
        )
        measured = f"{spread(faster, ' ×')}; {significant(1e3 * statistics.median(our_s))} ms {their_ms}"
        figure = (
            "Pixels of the fast path, Simulation 1's frames: exact spans, no buffer drawn; against "
            "`pyrender.OffscreenRenderer` SEG, same boxes"
        )
        found.rows.append(Row(figure, "≥ 60 × faster", measured, met, f"{limit}; pyrender {their_limit}"))
        drawn = f"{spread(ratios(their_s, buffers_s), ' ×')}; {significant(1e3 * statistics.median(buffers_s))} ms"
        limit = bench.times_limit(statistics.median(buffers_s), buffered[0]["drawn_bytes"] / samples)
        figure = (
            "ID pass, the same frames against the same: a buffer of the whole image with all vessels, and one of each "
            "vessel alone whose box overlaps another's"
        )
        found.rows.append(Row(figure, "", f"{drawn} {their_ms}", None, limit))
        if not met:
            found.profiles.append(profile_text("Fast path", our("profile", range(frames))["rows"]))
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
    """A whole run; without the thesis's JSON; and with corner projection only."""
    steps, found = bench.steps(1500), Found()
    asked = {"scene": "simulation_1", "steps": steps, "mode": 2}
    corners = {"scene": "simulation_1", "steps": steps, "mode": 0, "source": "analytic"}
    commands = {"rendered": ("--mode", "2"), "analytic": ("--mode", "0", "--source", "analytic")}
    by_the_clock: dict[str, list[float]] = {source: [] for source in commands}
    rendered, without_json, analytic = [], [], []
    for _ in bench.rounds():
        rendered.append(child("run", **asked))
        without_json.append(child("run", **asked, thesis_json=False))
        analytic.append(child("run", **corners))
        for source, options in commands.items():
            out = bench.folder / source
            command = ("run", "simulation_1", *options, "--steps", str(steps), "--out", out)
            by_the_clock[source].append(modsim3d(*command).seconds)
            shutil.rmtree(out)
    seconds = [answer["seconds"] for answer in rendered]
    rates, rates_without = (
        ratios([answer["frames"] for answer in answers], [answer["seconds"] for answer in answers])
        for answers in (rendered, without_json)
    )
    slower = ratios(seconds, [answer["seconds"] for answer in analytic])
    whole = by_the_clock["rendered"]
    whole_slower = ratios(whole, by_the_clock["analytic"])
    drawn = rendered[0]["drawn_bytes"]
    limit = bench.times_limit(statistics.median(seconds), drawn)
    limit_without = bench.times_limit(statistics.median(answer["seconds"] for answer in without_json), drawn)
    fast, near = statistics.median(rates) >= 8000, statistics.median(slower) <= 1.5
    fast_without = statistics.median(rates_without) >= 12_000
    run = "`modsim3d run simulation_1 --mode 2`"
    found.rows += [
        Row(f"{run}, all files, one process", "≥ 8,000 frames/s", spread(rates, " frames/s"), fast, limit),
        Row(
            "the same without the thesis's JSON (`--no-json`)",
            "≥ 12,000 frames/s",
            spread(rates_without, " frames/s"),
            fast_without,
            limit_without,
        ),
        Row("the same against `--source analytic --mode 0`", "≤ 1.5 × the time", spread(slower, " ×"), near, limit),
        Row(
            "both commands by the clock: Python's start and the contact sheet too",
            "",
            f"{spread(whole, ' s')} for {steps:,} frames; {spread(whole_slower, ' ×')} the analytic one's time",
            None,
            bench.times_limit(statistics.median(whole), drawn),
        ),
    ]
    if not (fast and fast_without and near):
        found.profiles.append(profile_of_run(f"Simulation 1, {steps:,} frames", **asked))
    return found


def frame_rate(scene: str, what: str, promised: float) -> Callable[[Bench], Found]:
    """The figure of a scene, by its name or its file."""

    def figure(bench: Bench) -> Found:
        return frames_per_second(bench, scene, what, promised, 30 if bench.quick else None)

    return figure


def thousand(bench: Bench) -> Found:
    """A thousand vessels in one image."""
    scene = bench.scene("thousand_vessels", scenes.thousand())
    return frames_per_second(
        bench, scene, "1,000 boats of 4–14 m in one image of 1920 × 1080", 15, bench.steps(scenes.THOUSAND_STEPS)
    )


def frames_per_second(bench: Bench, scene: str, what: str, promised: float, steps: int | None) -> Found:
    """How many frames of a scene are made in a second, with all files; all its steps if `steps` is None."""
    asked = {"scene": scene} if steps is None else {"scene": scene, "steps": steps}
    answers = [child("run", **asked) for _ in bench.rounds()]
    rates = ratios([answer["frames"] for answer in answers], [answer["seconds"] for answer in answers])
    limit = bench.times_limit(statistics.median(answer["seconds"] for answer in answers), answers[0]["drawn_bytes"])
    met, name = statistics.median(rates) >= promised, Path(scene).name
    measured = f"{spread(rates, ' frames/s')}; {shares_text(child('shares', scene=scene))}"
    row = Row(f"`{name}`: {what}, all files, one process", f"≥ {promised:g} frames/s", measured, met, limit)
    profiles = [] if met else [profile_of_run(f"{name}, {answers[0]['frames']} frames", **asked)]
    return Found([row], profiles=profiles)


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


FIGURES: dict[str, Callable[[Bench], Found]] = {
    "id_pass": id_pass,
    "simulation_1": simulation_1,
    "harbour": frame_rate("harbour", "30 vessels with meshes, from kayak to ship, seen from a quay", 500),
    "strait": frame_rate("strait", "meshes, islands, a JONSWAP sea, two cameras", 400),
    "small": frame_rate("benchmarks/small.yaml", "50 boats of 4–14 m at 300–2500 m", 200),
    "dense": frame_rate("benchmarks/dense.yaml", "50 vessels of 5–300 m at 300–2500 m", 200),
    "thousand": thousand,
    "image_size": image_size,
    "growth": growth,
    "detect_again": detect_again,
    "workers": workers,
    "memory": memory,
    "cold_start": cold_start,
    "live_step": live_step,
}
