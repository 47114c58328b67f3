"""Times trackers in frames per second of the camera, and writes benchmarks/TRACKING.md.

All trackers follow the same detections of one run in memory, in turn in each round, so that what else the machine does
meets all of them. Run it with `python -m benchmarks.tracking`; `--quick` is a trial that writes nothing, names choose
some of the trackers.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.measured import BUSY_LOAD, significant, table
from benchmarks.processes import ROOT, child, say
from modsim3d.runs.camera_sequences import CameraSequence, camera_sequences
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, Tracker
from modsim3d.tracking.trackers.registry import named_tracker

RESULTS = ROOT / "benchmarks" / "TRACKING.md"
SCENE, STEPS, QUICK_STEPS, ROUNDS = "fairway", 600, 60, 5
TRACKERS = ("reference", "sort", "bytetrack", "ocsort", "stonesoup_gnn", "stonesoup_jpda")


def sensed(sequence: CameraSequence) -> list[SensedFrame]:
    """What a tracker is given of a camera."""
    found = sequence.detections
    edges = np.searchsorted(found.frame, np.arange(len(sequence.steps) + 1)).tolist()
    spans = zip(sequence.times_s.tolist(), edges, edges[1:], strict=False)
    return [
        SensedFrame(time_s, found.boxes_px[first:stop], found.label[first:stop], found.confidence[first:stop])
        for time_s, first, stop in spans
    ]


def seconds(tracker: Tracker, cameras: Sequence[tuple[CameraFacts, list[SensedFrame]]]) -> float:
    """Time that a tracker takes for all frames."""
    started = time.perf_counter()
    for facts, frames in cameras:
        for _ in tracker.follow(frames, facts):
            pass
    return time.perf_counter() - started


def cameras_of(folder: Path, steps: int) -> list[tuple[CameraFacts, list[SensedFrame]]]:
    """The cameras of a run of the scene, with what they sense."""
    scene = load_scene(SCENE, steps=steps)
    run_scene(scene, folder)
    sequences = camera_sequences(open_run(folder), tuple(range(len(scene.cameras))))
    labels = tuple(scene.detector.labels)
    return [(CameraFacts(each.camera.name, each.size_px, each.rate_hz, labels), sensed(each)) for each in sequences]


def measured(names: Sequence[str], quick: bool) -> tuple[list[list[str]], int, float]:
    """The rows of the table, the number of frames, and detections a frame."""
    with tempfile.TemporaryDirectory(prefix="modsim3d-tracking-") as folder:
        cameras = cameras_of(Path(folder) / "run", QUICK_STEPS if quick else STEPS)
    frames = sum(len(each) for _, each in cameras)
    detections = sum(len(frame.boxes_px) for _, each in cameras for frame in each)
    trackers = {name: named_tracker(name, {}, SCENE).tracker for name in names}
    found: dict[str, list[float]] = {name: [] for name in names}
    for number in range(1 if quick else ROUNDS):
        for name, tracker in trackers.items():
            say(f"round {number + 1}: {name}")
            found[name].append(seconds(tracker, cameras))
    rows = []
    for name, times in found.items():
        ratios = [own / base for own, base in zip(times, found[names[0]], strict=True)]
        cells = [significant(frames / max(times)), significant(frames / min(times)), significant(min(ratios))]
        rows.append([name, significant(frames / statistics.median(times)), *cells, significant(max(ratios))])
    return rows, frames, detections / frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    parser.add_argument("trackers", nargs="*", default=TRACKERS, metavar="TRACKER", help="trackers to time")
    arguments, load = parser.parse_args(), os.getloadavg()[0]
    machine = child("machine")
    rows, frames, detections = measured(arguments.trackers, arguments.quick)
    lines = [
        "# Speed of the trackers",
        "",
        "Written by `python -m benchmarks.tracking`; do not edit.",
        "",
        f"- Processor: {machine['processor']}, {len(os.sched_getaffinity(0))} cores",
    ]
    if load > BUSY_LOAD:
        lines.append(f"- **The machine was not idle: a load of {load:.1f} before it began.**")
    lines += [
        "",
        f"Frames per second of one camera after the other in `{SCENE}`: {frames:,} frames with {detections:.1f} "
        f"detections each, all in memory. {ROUNDS} rounds, in each the trackers in turn, with the settings that they "
        f"have for this scene. The ratio is the time over that of `{arguments.trackers[0]}` in the same round.",
        "",
    ]
    head = ("Tracker", "Median, frames/s", "Slowest", "Fastest", "Least ratio of time", "Greatest")
    text = "\n".join([*lines, table(head, rows)]) + "\n"
    print(text)
    if not arguments.quick and tuple(arguments.trackers) == TRACKERS:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
