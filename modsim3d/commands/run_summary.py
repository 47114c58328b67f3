"""What `modsim3d run` and `modsim3d detect` print about a finished run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modsim3d.commands.shared import print_line, print_path
from modsim3d.commands.tables import print_table
from modsim3d.commands.terminal import open_console, warn

if TYPE_CHECKING:
    from modsim3d.runs.counts import Counts
    from modsim3d.runs.run import RunResult
    from modsim3d.scene.scene import Scene

Row = tuple[str, str, str]
"""Name, value and meaning."""
NOTICEABLE_SHARE = 0.005
"""The bias from resampled box errors is shown if at least this share of the detections was resampled."""


def print_summary(scene: Scene, result: RunResult, sheet: bool) -> None:
    """Print what happened in a run, and where its files are."""
    rows = _frame_rows(scene, result) + _detection_rows(result.counts) + _time_rows(result) + _model_rows(result)
    console = open_console()
    print_table(console, "", rows, right=(1,), styles=("bold", "", "dim"))
    print_line(console, "")
    print_path(console, "run directory", result.folder)
    if sheet:
        print_path(console, "contact sheet", result.folder / "contact_sheet.png")
    for warning in run_warnings(scene, result):
        warn(warning)


def _frame_rows(scene: Scene, result: RunResult) -> list[Row]:
    counts = result.counts
    frames = f"{len(scene.cameras)} camera(s), {result.steps} steps, mode {scene.annotation.mode}"
    return [
        ("frames", str(counts.frames), frames),
        ("vessels seen", str(counts.seen), "vessels in images, summed over frames"),
        ("occlusions", f"{counts.partly_hidden} partly, {counts.fully_hidden} fully", ""),
        ("annotated", str(counts.annotated), ""),
    ]


def _detection_rows(counts: Counts) -> list[Row]:
    every = counts.detected + counts.false_positives
    true = max(counts.detected, 1)
    below = f"{counts.below_half_iou / true:.1%} of detections: an evaluation by IoU counts them as missed"
    resampled = f"{counts.redrawn / true:.1%}: the first sampled error shrank the box below one pixel"
    return [
        ("detections", str(counts.detected), _share(counts.detected, counts.annotated, "of annotated")),
        ("missed", str(counts.missed), _share(counts.missed, counts.annotated, "of annotated")),
        ("false", str(counts.false_positives), _share(counts.false_positives, every, "of all detections")),
        ("mislabelled", str(counts.mislabelled), ""),
        ("IoU below 0.5", str(counts.below_half_iou), below),
        ("box resampled", str(counts.redrawn), resampled),
    ]


def _time_rows(result: RunResult) -> list[Row]:
    per_frame_ms = 1e3 * result.seconds / max(result.counts.frames, 1)
    rows = [("time per frame", f"{per_frame_ms:.2f} ms", f"{result.seconds:.1f} s in all")]
    if result.resumed_steps:
        rows.append(("resumed", str(result.resumed_steps), "steps taken from the interrupted run"))
    if result.damaged_blocks:
        rows.append(("damaged", str(result.damaged_blocks), "blocks of the interrupted run, made anew"))
    return rows


def _model_rows(result: RunResult) -> list[Row]:
    """What optional parts of the detector did, if they did anything."""
    counts = result.counts
    rows = _bias_rows(result)
    if counts.missed_by_gate:
        gated = _share(counts.missed_by_gate, counts.missed, "of the missed")
        rows.append(("gated", str(counts.missed_by_gate), gated))
    if counts.merged:
        rows.append(("merged", str(counts.merged), "boxes around two vessels"))
    return rows


def _bias_rows(result: RunResult) -> list[Row]:
    """The mean width and height error of the state in which resampling shifts the width most."""
    states = result.truncation
    detections = sum(state["detections"] for state in states.values())
    resampled = sum(state["redrawn"] * state["detections"] for state in states.values()) / max(detections, 1)
    if resampled < NOTICEABLE_SHARE:
        return []
    worst = max(states, key=lambda name: abs(states[name]["mean_shift"][2]))
    width, height = (f"{shift:+.3g}" for shift in states[worst]["mean_shift"][2:])
    unit = "box sides" if states[worst]["unit"] == "relative" else "px"
    meaning = f"mean width and height error in state '{worst}'; run.json has all states"
    return [("truncation bias", f"{width}, {height} {unit}", meaning)]


def run_warnings(scene: Scene, result: RunResult) -> list[str]:
    """What a user should know before the run is used."""
    counts = result.counts
    warnings = [
        f"the boxes of {' and '.join(pair)} intersect, so who hides whom is undefined; only the rendered source decides"
        for pair in result.intersecting
    ]
    if counts.off_by_curvature:
        warnings.append(
            f"the sea is flat: {counts.off_by_curvature} of {counts.vessel_frames} vessels in images are drawn too "
            f"high, by up to {counts.largest_curvature_px:.1f} px; set sea: curved"
        )
    return warnings


def _share(part: int, whole: int, of: str) -> str:
    return f"{part / whole:.1%} {of}" if whole else ""
