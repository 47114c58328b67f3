"""What `modsim3d run` and `modsim3d detect` say of a finished run."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from modsim3d.run import RunResult
    from modsim3d.scene import Scene


def summarise(scene: Scene, result: RunResult, sheet: bool) -> None:
    """Print what happened in a run, and where its files are."""
    from rich.console import Console
    from rich.table import Table

    counts = result.counts
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    table.add_column(style="dim")
    true = max(counts.detected, 1)
    rows: list[tuple[str, str, str]] = [
        (
            "frames",
            str(counts.frames),
            f"{len(scene.cameras)} camera(s), {result.steps} steps, mode {scene.annotation.mode}",
        ),
        (
            "vessels seen",
            str(counts.seen),
            "vessels in images, summed over frames",
        ),
        ("occlusions", f"{counts.partly_hidden} partly, {counts.fully_hidden} fully", ""),
        ("annotated", str(counts.annotated), ""),
        ("detections", str(counts.detected), _share(counts.detected, counts.annotated, "of annotated")),
        ("missed", str(counts.missed), _share(counts.missed, counts.annotated, "of annotated")),
        (
            "false",
            str(counts.false_positives),
            _share(counts.false_positives, counts.detected + counts.false_positives, "of all detections"),
        ),
        ("mislabelled", str(counts.mislabelled), ""),
        (
            "IoU below 0.5",
            str(counts.below_half_iou),
            f"{counts.below_half_iou / true:.1%} of detections: a matching evaluation misses these",
        ),
        (
            "box redrawn",
            str(counts.redrawn),
            f"{counts.redrawn / true:.1%}: the first error left less than a pixel of the box",
        ),
        (
            "time per frame",
            f"{1e3 * result.seconds / max(counts.frames, 1):.2f} ms",
            f"{result.seconds:.1f} s in all",
        ),
    ]
    rows += _model_rows(result)
    if result.resumed_steps:
        rows.append(("resumed", str(result.resumed_steps), "steps taken from the interrupted run"))
    for row in rows:
        table.add_row(*row)
    console = Console()
    console.print(table)
    for pair in result.intersecting:
        message = f"{' and '.join(pair)} intersect: what is seen of them is left open; only the rendered source decides"
        console.print(message, highlight=False, soft_wrap=True, style="yellow")
    if counts.off_by_curvature:
        console.print(
            f"the sea is flat: {counts.off_by_curvature} of {counts.vessel_frames} vessels in images are drawn too "
            f"high, by up to {counts.largest_curvature_px:.1f} px; set sea: curved",
            highlight=False,
            soft_wrap=True,
            style="yellow",
        )
    console.print(f"\nrun directory  {result.folder}", highlight=False, soft_wrap=True)
    if sheet:
        console.print(f"contact sheet  {result.folder / 'contact_sheet.png'}", highlight=False, soft_wrap=True)


def _model_rows(result: RunResult) -> list[tuple[str, str, str]]:
    """What the detector's own rules did, where they did anything."""
    counts, rows = result.counts, []
    total = sum(state["detections"] for state in result.truncation.values())
    redrawn = sum(state["redrawn"] * state["detections"] for state in result.truncation.values()) / max(total, 1)
    if redrawn >= 0.005:
        worst = max(result.truncation, key=lambda name: abs(result.truncation[name]["mean_shift"][2]))
        state = result.truncation[worst]
        width, height = (f"{shift:+.3g}" for shift in state["mean_shift"][2:])
        of = "box sides" if state["unit"] == "relative" else "px"
        rows.append(
            ("truncation bias", f"{width}, {height} {of}", f"mean width, height error in '{worst}'; all in run.json")
        )
    if counts.missed_by_gate:
        rows.append(
            ("gated", str(counts.missed_by_gate), _share(counts.missed_by_gate, counts.missed, "of the missed"))
        )
    if counts.merged:
        rows.append(("merged", str(counts.merged), "boxes around two vessels"))
    return rows


def _share(part: int, whole: int, of: str) -> str:
    return f"{part / whole:.1%} {of}" if whole else ""
