"""A frame as a matplotlib figure, for notebooks and papers."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import ModsimError
from modsim3d.runs.blocks import Frame
from modsim3d.runs.outcomes import NOTHING_WRONG, Outcome, detected_rows, frame_outcomes
from modsim3d.view import palette
from modsim3d.view.outcome_words import NAMES, is_a
from modsim3d.view.palette import unit_rgb
from modsim3d.view.pictures.plain import below_horizon

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

WIDTH_IN, BESIDE_IN, ABOVE_AND_BELOW_IN = 9.0, 0.7, 1.2
"""Width of a figure of its own, and the width and the height of what stands around the image in it."""
FARTHEST_ROWS = 5
"""How many rows of text a label may move away from its box."""
MARGIN = 0.35
"""Margin around the boxes when zoomed in, as a share of their width and height."""
LEAST_VIEW_PX = 240.0
Style = str | tuple[float, tuple[float, ...]]
"""A line style of matplotlib."""
BAD_BOX: Style = (0, (6, 3))
"""Longer dashes than those of a false positive."""
FLAG: dict[str, Any] = {
    "marker": "v",
    "ms": 7,
    "mfc": unit_rgb(palette.ALARM),
    "mec": unit_rgb(palette.INK),
    "mew": 0.5,
}
TETHER: dict[str, Any] = {"lw": 1.2, "marker": "o", "ms": 4, "markevery": [0]}
BELOW_AXIS_EM = 6.0
"""Distance from the image to the legend, in sizes of its font: there stand the axis's numbers and name."""


def plot_frame(frame: Frame, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
    """Draw sea, sky, truth, detections, misses and false positives of a frame.

    Args:
        frame: The frame to draw.
        axes: Axes to draw on; those of a new figure if None.
        zoom: Show only the part of the image in which vessels are.
        labels: Write names, classes and confidences.

    Raises:
        ModsimError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ModsimError("frame.plot() needs matplotlib: pip install 'modsim3d[view]'") from None
    left, top, right, bottom = _view(frame, zoom)
    if axes is None:
        height_in = (WIDTH_IN - BESIDE_IN) * (bottom - top) / (right - left) + ABOVE_AND_BELOW_IN
        axes = Figure(figsize=(WIDTH_IN, height_in), layout="constrained").add_subplot()
    figure = axes.figure.figure  # the whole one, where the axes are in a part of it
    _background(axes, frame)
    outcomes = frame_outcomes(frame)
    notes = _truth(axes, frame, labels) + _detections(axes, frame, outcomes, labels)
    _legend(axes, frame, reduce(or_, outcomes, NOTHING_WRONG))
    # Rows run downwards, as in an image.
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="column [px]", ylabel="row [px]")
    axes.set_title(f"{frame.camera}, {frame.timestamp} s, detector {frame.state}")
    figure.draw_without_rendering()
    _keep_apart(notes, axes.get_window_extent().x1, figure.dpi / 72)
    return figure


def _background(axes: Axes, frame: Frame) -> None:
    from matplotlib.patches import Polygon

    width, height = frame.image_size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    axes.add_patch(Polygon(corners, facecolor=unit_rgb(palette.SKY), zorder=0))
    sea = below_horizon(corners, corners, frame.sea_half_plane)
    if len(sea):
        axes.add_patch(Polygon(sea, facecolor=unit_rgb(palette.SEA), zorder=0))


def _truth(axes: Axes, frame: Frame, labels: bool) -> list[Annotation]:
    truth, notes = frame.truth, []
    for i, name in enumerate(truth.vessels):
        _box(axes, truth.full_boxes_px[i], palette.TRUTH, 1.0, "--")
        if not np.isnan(truth.visible_boxes_px[i]).any():
            _box(axes, truth.visible_boxes_px[i], palette.TRUTH, 1.0)
        if truth.annotated[i] and not truth.detected[i]:
            _box(axes, truth.boxes_px[i], palette.ALARM, 1.8)
            if labels:
                notes.append(_label(axes, truth.boxes_px[i], f"{name} missed", palette.ALARM, below=True))
    return notes


def _detections(axes: Axes, frame: Frame, outcomes: list[Outcome], labels: bool) -> list[Annotation]:
    found, notes = frame.detections, []
    for i, (outcome, row) in enumerate(zip(outcomes, detected_rows(frame), strict=True)):
        box, vessel = found.boxes_px[i], found.vessels[i]
        known = row is not None and vessel is not None
        colour = palette.vessel_colour(frame.scene_vessels.index(vessel)) if known else palette.ALARM
        if row is None:
            axes.plot(box[[[0, 0], [2, 2]]], box[[[1, 3], [3, 1]]], color=unit_rgb(colour), lw=0.6)
        elif outcome & Outcome.OFF_VESSEL:
            _tether(axes, box, frame.truth.boxes_px[row])
        style = "--" if outcome & Outcome.FALSE_POSITIVE else BAD_BOX if outcome & Outcome.BELOW_HALF_IOU else "-"
        _box(axes, box, colour, 1.8, style)
        who = vessel if known else f"false{f', {found.kinds[i]} of {vessel}' if vessel else ''}"
        what, plate = f"{who}: {found.labels[i]} {found.confidence[i]:.2f}", colour
        if row is not None and outcome & Outcome.MISLABELLED:
            what, plate = f"{what}, {is_a(frame.truth.labels[row])}", palette.ALARM
            _flag(axes, box)
        if labels:
            notes.append(_label(axes, box, what, plate))
    return notes


def _legend(axes: Axes, frame: Frame, mistakes: Outcome) -> None:
    """A legend below the image, of what is there."""
    from matplotlib.lines import Line2D

    alarm, box, truth = unit_rgb(palette.ALARM), unit_rgb(palette.VESSELS[0]), frame.truth
    entries: list[tuple[Any, str, dict[str, Any]]] = [
        (len(truth), "truth", {"color": unit_rgb(palette.TRUTH), "lw": 1.0}),
        (any(frame.detections.vessels), "detection, in its vessel's colour", {"color": box}),
        (mistakes & Outcome.MISLABELLED, NAMES[Outcome.MISLABELLED], {"color": box, **FLAG}),
        (mistakes & Outcome.BELOW_HALF_IOU, NAMES[Outcome.BELOW_HALF_IOU], {"color": box, "ls": BAD_BOX}),
        (mistakes & Outcome.OFF_VESSEL, NAMES[Outcome.OFF_VESSEL], {"color": alarm, **TETHER}),
        (np.any(truth.annotated & ~truth.detected), "missed", {"color": alarm}),
        (mistakes & Outcome.FALSE_POSITIVE, NAMES[Outcome.FALSE_POSITIVE], {"color": alarm, "ls": "--"}),
    ]
    handles = [Line2D([], [], label=text, **{"lw": 1.8, **style}) for there, text, style in entries if there]
    if not handles:
        return
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0),
        borderaxespad=BELOW_AXIS_EM,
        ncols=len(handles),
        fontsize=7,
        columnspacing=1.2,
        handlelength=3.2,
        framealpha=1,
        facecolor=unit_rgb(palette.SEA),
        labelcolor=unit_rgb(palette.PAPER),
    )


def _tether(axes: Axes, box_px: Array, true_px: Array) -> None:
    """A line from the centre of a box to the box of its vessel."""
    centre = (box_px[:2] + box_px[2:]) / 2
    end = np.clip(centre, true_px[:2], true_px[2:])
    axes.plot(*np.transpose([centre, end]), color=unit_rgb(palette.ALARM), **TETHER)


def _flag(axes: Axes, box_px: Array) -> None:
    """A triangle at the upper right corner of a box of a wrong class."""
    axes.plot(box_px[2], box_px[1], **FLAG)


def _view(frame: Frame, zoom: bool) -> tuple[float, float, float, float]:
    """The part of the image that is shown: left, top, right, bottom."""
    width, height = map(float, frame.image_size_px)
    true = [vessel is not None for vessel in frame.detections.vessels]
    boxes = np.concatenate([frame.truth.full_boxes_px, frame.detections.boxes_px[true]])
    if not (zoom and len(boxes)):
        return 0.0, 0.0, width, height
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    half = np.maximum((high - low) * (0.5 + MARGIN), LEAST_VIEW_PX / 2)
    (left, top), (right, bottom) = ((low + high) / 2 - half).tolist(), ((low + high) / 2 + half).tolist()
    return max(left, 0.0), max(top, 0.0), min(right, width), min(bottom, height)


def _keep_apart(notes: list[Annotation], right_px: float, point_px: float) -> None:
    """Move labels left into the image, and away from their boxes until none lies on another; or leave one out."""
    taken: list[Bbox] = []
    for note in notes:
        plate = note.get_window_extent().padded(2 * point_px)
        left = max(0.0, plate.x1 - right_px)
        away = 1 if note.get_verticalalignment() == "bottom" else -1
        for row in range(FARTHEST_ROWS + 1):
            moved = plate.translated(-left, away * row * plate.height)
            if not any(moved.overlaps(other) for other in taken):
                note.xyann = (-left / point_px, away * (3 + row * plate.height / point_px))
                taken.append(moved)
                break
        else:
            note.remove()


def _box(axes: Axes, box_px: Array, colour: palette.Colour, width: float, style: Style = "-") -> None:
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = box_px
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=unit_rgb(colour), lw=width, ls=style))


def _label(axes: Axes, box_px: Array, text: str, colour: palette.Colour, below: bool = False) -> Annotation:
    """Text on a plate of its colour; a vessel's name is text, not mathematics."""
    return axes.annotate(
        text,
        (box_px[0], box_px[3 if below else 1]),
        xytext=(0, -3 if below else 3),
        textcoords="offset points",
        va="top" if below else "bottom",
        fontsize=7,
        color=unit_rgb(palette.INK),
        parse_math=False,
        bbox={"boxstyle": "square,pad=0.15", "facecolor": unit_rgb(colour), "edgecolor": "none"},
        annotation_clip=True,
        clip_on=True,
    )
