"""Text of `modsim3d run` and `modsim3d detect` about a finished run."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from modsim3d.cli.shared import print_line, print_path
from modsim3d.cli.terminal import open_console, warn
from modsim3d.cli.terminal_tables import print_table
from modsim3d.core.text import in_percent

if TYPE_CHECKING:
    from modsim3d.runs.counts import Counts
    from modsim3d.runs.run import RunResult
    from modsim3d.scene.scene import Scene
    from modsim3d.truth.crosscheck.comparison import CheckCounts

Row = tuple[str, str, str]  # name, value and meaning
CAMERA_HEADER = (
    "camera",
    "frames",
    "annotated",
    "detected",
    "false\npositives",
    "wrong\nclass",
    "IoU\n< 0.5",
    "off\nvessel",
)
MODES = ("boxes of whole vessels, hidden ones too", "boxes of whole vessels", "boxes of what is seen of vessels")
NOTICEABLE_SHARE = 0.005  # the bias from resampled box errors is shown from this share of the detections on
WARNING_SHARE = 0.1  # a share of boxes with IoU below 0.5 that changes what an evaluation by IoU says


def print_summary(scene: Scene, result: RunResult, sheet: bool) -> None:
    """Print what happened in a run, and where its files are."""
    console = open_console()
    print_table(console, "", summary_rows(scene, result), right=(1,), styles=("bold", "", "dim"))
    if len(result.camera_counts) > 1:
        header, *rows = camera_rows(result)
        console.print()
        print_table(console, "", rows, header=header, right=range(1, len(header)))
    print_line(console, "")
    print_line(console, f"traffic  {traffic_in_words(scene)}")
    print_path(console, "run directory", result.folder)
    if sheet:
        print_path(console, "contact sheet", result.folder / "contact_sheet.png")
    folder, tracks = shlex.quote(str(result.folder)), shlex.quote(f"{result.folder}_tracks")
    print_line(console, f"\nnext\n  modsim3d report {folder}\n  modsim3d track {folder} --out {tracks}")
    for warning in run_warnings(scene, result):
        warn(warning)


def traffic_in_words(scene: Scene) -> str:
    """Whether a scene's traffic is drawn, and what another seed would change."""
    if scene.traffic_has_seed:
        return f"{scene.traffic}; a run with another seed has another traffic"
    return f"{scene.traffic}; with every seed the same vessels on the same paths, and other waves and detections"


def mode_in_words(scene: Scene) -> str:
    """Annotation mode of a scene, and its boxes."""
    return f"{scene.annotation.mode}: {MODES[scene.annotation.mode]}"


def summary_rows(scene: Scene, result: RunResult) -> list[Row]:
    """Summary of a run; each share is of a number that stands in another row."""
    counts, cameras = result.counts, len(scene.cameras)
    many = f"{cameras} camera{'s' if cameras > 1 else ''}, {result.steps:,} steps, mode {mode_in_words(scene)}"
    rows = [("frames", f"{counts.frames:,}", many), *vessel_rows(counts), *detection_rows(counts)]
    if counts.true_detections:
        iou = result.iou
        rows.append(("mean IoU", f"{iou.mean:.3f}", f"of true detections with their vessels; median {iou.median:.3f}"))
    rows += _bias_rows(result) + gate_rows(counts)
    return rows + _check_rows(scene, result.checked) + _time_rows(result)


def _check_rows(scene: Scene, checked: CheckCounts | None) -> list[Row]:
    """Row on what the cross-check compared: of the truth that was kept, if the detector alone has run."""
    if checked is None:
        return []
    annotation = scene.annotation
    if annotation.source != "rendered":
        return [("cross-checked", "nothing", f"source {annotation.source}: nothing was drawn")]
    if not checked.frames:
        none = "annotation.check: off" if annotation.check == "off" else "no camera took a frame"
        return [("cross-checked", "nothing", none)]
    frames = f"{checked.frames:,} frame{'s' * (checked.frames > 1)}"
    if not checked.vessels:
        return [("cross-checked", frames, "no vessel in them" if checked.frames > 1 else "no vessel in it")]
    ties = f" but for {checked.tie_pixels} tie{'s' * (checked.tie_pixels > 1)}" if checked.tie_pixels else ""
    boxes = f"boxes within {checked.largest_box_px:.2f} px of corner projection"
    tips = f", {checked.sharp_tips} sharp tip{'s' * (checked.sharp_tips > 1)}" if checked.sharp_tips else ""
    meaning = f"{checked.vessels:,} vessel{'s' * (checked.vessels > 1)}: pixels equal{ties}, {boxes}{tips}"
    return [("cross-checked", frames, meaning)]


def vessel_rows(counts: Counts) -> list[Row]:
    """Counts of vessels in the images."""
    return [
        ("vessels seen", f"{counts.seen:,}", "summed over frames"),
        ("partly hidden", f"{counts.partly_hidden:,}", share(counts.partly_hidden, counts.seen, "seen")),
        ("fully hidden", f"{counts.fully_hidden:,}", "vessels, beside those seen"),
        ("annotated", f"{counts.annotated:,}", "vessels given to the detector"),
    ]


def detection_rows(counts: Counts) -> list[Row]:
    """Counts of the detector's output."""
    true = counts.true_detections
    every = true + counts.false_positives
    of_true = [
        ("wrong class", counts.mislabelled),
        ("IoU below 0.5", counts.below_half_iou),
        ("off their vessel", counts.off_vessel),
        ("box resampled", counts.redrawn),
    ]
    return [
        ("detected", f"{counts.detected:,}", share(counts.detected, counts.annotated, "annotated")),
        ("missed", f"{counts.missed:,}", share(counts.missed, counts.annotated, "annotated")),
        ("detections", f"{every:,}", f"in the files: {true:,} true + {counts.false_positives:,} false"),
        ("false positives", f"{counts.false_positives:,}", share(counts.false_positives, every, "detections")),
        *((name, f"{count:,}", share(count, true, "true detections")) for name, count in of_true),
    ]


def camera_rows(result: RunResult) -> list[tuple[str, ...]]:
    """A header, and the counts of each camera."""
    return [CAMERA_HEADER, *(camera_row(name, counts) for name, counts in result.camera_counts.items())]


def camera_row(name: str, counts: Counts) -> tuple[str, ...]:
    """The counts of a camera, under `CAMERA_HEADER`."""
    outcomes = counts.detected, counts.false_positives, counts.mislabelled, counts.below_half_iou, counts.off_vessel
    return (name, *(f"{count:,}" for count in (counts.frames, counts.annotated, *outcomes)))


def _time_rows(result: RunResult) -> list[Row]:
    per_frame_ms = 1e3 * result.seconds / max(result.counts.frames, 1)
    rows = [("time per frame", f"{per_frame_ms:.2f} ms", f"{result.seconds:.1f} s in all")]
    if result.resumed_steps:
        rows.append(("resumed", f"{result.resumed_steps:,}", "steps taken from the interrupted run"))
    if result.damaged_blocks:
        rows.append(("damaged", f"{result.damaged_blocks:,}", "blocks of the interrupted run, made anew"))
    return rows


def gate_rows(counts: Counts) -> list[Row]:
    """Counts of gates and merges, if they did anything."""
    rows: list[Row] = []
    if gated := counts.missed_by_gate:
        rows.append(("gated", f"{gated:,}", share(gated, counts.missed, "missed")))
    if merged := counts.merged:
        rows.append(("merged", f"{merged:,}", share(merged, counts.true_detections, "true detections")))
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
    """Warnings to read before using a run, each a sentence."""
    from modsim3d.runs.camera_sequences import blind_cameras
    from modsim3d.scene.summary import scene_warnings

    counts = result.counts
    warnings = blind_cameras(scene, result.steps, result.camera_counts)
    if len(warnings) == len(scene.cameras) > 1:
        warnings.insert(0, "no camera sees a vessel in this run")
    warnings += scene_warnings(scene)
    warnings += [
        f"the hulls of {' and '.join(pair)} intersect, so geometry does not tell who hides whom; only the rendered "
        "source decides"
        for pair in result.intersecting
    ]
    if counts.off_by_curvature:
        warnings.append(
            f"the sea is flat: {counts.off_by_curvature:,} of {counts.vessel_frames:,} vessels in images are drawn too "
            f"high, by up to {counts.largest_curvature_px:.1f} px; set sea: curved"
        )
    return warnings + iou_warnings(counts)


def iou_warnings(counts: Counts) -> list[str]:
    """That an evaluation by IoU says something else of the detections, where it does."""
    if counts.below_half_iou <= WARNING_SHARE * counts.true_detections:
        return []
    return [
        f"{counts.below_half_iou:,} of {counts.true_detections:,} true detections have IoU below 0.5 with their "
        "vessel: an evaluation by IoU counts each as a miss and a false positive"
    ]


def share(part: int, whole: int, of: str) -> str:
    """A share in words, such as `of 20 seen (5.0 %)`; empty of nothing."""
    return f"of {whole:,} {of} ({in_percent(part / whole, 1)})" if whole else ""
