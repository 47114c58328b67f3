"""A frame as a matplotlib figure, for notebooks and papers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from modsim3d.block import Frame
from modsim3d.errors import ModsimError
from modsim3d.frames import Array
from modsim3d.view import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 9.0
MARGIN = 0.35
"""Of the boxes' width and height, around them when zoomed in."""
LEAST_VIEW_PX = 240.0


def plot_frame(frame: Frame, axes: Axes | None = None, *, zoom: bool = False, labels: bool = True) -> Figure:
    """Draw sea, sky, truth, detections, misses and false positives of a frame.

    Args:
        frame: What to draw.
        axes: Where; a figure of its own if None.
        zoom: Show only the part of the image in which there are vessels.
        labels: Write names, classes and confidences.

    Raises:
        ModsimError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ModsimError("frame.plot() needs matplotlib: pip install 'modsim3d[view]'") from None
    if axes is None:
        width, height = frame.image_size_px
        figure = Figure(figsize=(WIDTH_IN, WIDTH_IN * height / width), layout="constrained")
        axes = figure.add_subplot()
    _background(axes, frame)
    _truth(axes, frame, labels)
    _detections(axes, frame, labels)
    _frame_view(axes, frame, zoom)
    axes.set_title(f"{frame.camera}, {frame.timestamp} s, detector {frame.state}")
    return cast("Figure", axes.figure)


def _background(axes: Axes, frame: Frame) -> None:
    from matplotlib.patches import Polygon

    width, height = frame.image_size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    axes.add_patch(Polygon(corners, facecolor=_unit(palette.SKY), zorder=0))
    sea = below_horizon(corners, frame.sea_half_plane)
    if len(sea):
        axes.add_patch(Polygon(sea, facecolor=_unit(palette.SEA), zorder=0))


def below_horizon(corners_px: Array, sea_half_plane: Array) -> Array:
    """The part of a convex polygon on the sea's side of the horizon.

    Args:
        corners_px: Shape (n, 2).
        sea_half_plane: (a, b, c), shape (3,).

    Returns:
        Shape (m, 2); empty if there is no sea in it.
    """
    depths = corners_px @ sea_half_plane[:2] + sea_half_plane[2]
    kept = []
    for i in range(len(corners_px)):
        start, end = depths[i - 1], depths[i]
        if (start >= 0) != (end >= 0):
            kept.append(corners_px[i - 1] + start / (start - end) * (corners_px[i] - corners_px[i - 1]))
        if end >= 0:
            kept.append(corners_px[i])
    return np.array(kept).reshape(-1, 2)


def _truth(axes: Axes, frame: Frame, labels: bool) -> None:
    truth = frame.truth
    for i, name in enumerate(truth.vessels):
        _box(axes, truth.full_boxes_px[i], palette.TRUTH, 1.0, dashed=True)
        missed = truth.annotated[i] and not truth.detected[i]
        if not np.isnan(truth.visible_boxes_px[i]).any():
            _box(axes, truth.visible_boxes_px[i], palette.TRUTH, 1.0)
        if missed:
            _box(axes, truth.boxes_px[i], palette.ALARM, 1.8)
            if labels:
                _label(axes, truth.boxes_px[i], f"{name} missed", palette.ALARM, below=True)


def _detections(axes: Axes, frame: Frame, labels: bool) -> None:
    found = frame.detections
    for i, vessel in enumerate(found.vessels):
        colour = palette.ALARM if vessel is None else palette.vessel_colour(frame.scene_vessels.index(vessel))
        _box(axes, found.boxes_px[i], colour, 1.8, dashed=vessel is None)
        if labels:
            what = f"{found.labels[i]} {found.confidence[i]:.2f}"
            _label(axes, found.boxes_px[i], f"{vessel or 'false'}: {what}", colour)


def _frame_view(axes: Axes, frame: Frame, zoom: bool) -> None:
    """Pixels as in an image: rows downwards, equal in both directions."""
    width, height = frame.image_size_px
    left, top, right, bottom = 0.0, 0.0, float(width), float(height)
    true = [vessel is not None for vessel in frame.detections.vessels]
    boxes = np.concatenate([frame.truth.full_boxes_px, frame.detections.boxes_px[true]])
    if zoom and len(boxes):
        low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        half = np.maximum((high - low) * (0.5 + MARGIN), LEAST_VIEW_PX / 2)
        (left, top), (right, bottom) = (low + high) / 2 - half, (low + high) / 2 + half
    axes.set_xlim(max(left, 0.0), min(right, float(width)))
    axes.set_ylim(min(bottom, float(height)), max(top, 0.0))
    axes.set_aspect("equal")
    axes.set_xlabel("column [px]")
    axes.set_ylabel("row [px]")


def _box(axes: Axes, box_px: Array, colour: palette.Colour, width: float, *, dashed: bool = False) -> None:
    from matplotlib.patches import Rectangle

    x0, y0, x1, y1 = box_px
    line: Any = "--" if dashed else "-"
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor=_unit(colour), lw=width, ls=line))


def _label(axes: Axes, box_px: Array, text: str, colour: palette.Colour, below: bool = False) -> None:
    """Text on a plate of its colour; a vessel's name is text, not mathematics."""
    axes.annotate(
        text,
        (box_px[0], box_px[3 if below else 1]),
        xytext=(0, -3 if below else 3),
        textcoords="offset points",
        va="top" if below else "bottom",
        fontsize=7,
        color=_unit(palette.INK),
        parse_math=False,
        bbox={"boxstyle": "square,pad=0.15", "facecolor": _unit(colour), "edgecolor": "none"},
        annotation_clip=True,
        clip_on=True,
    )


def _unit(colour: palette.Colour) -> tuple[float, float, float]:
    r, g, b = (channel / 255 for channel in colour)
    return r, g, b
