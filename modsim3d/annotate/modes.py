"""Which vessels are annotated, and with which box (Jessen & Mohr (2023), §7.5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.annotate.truth_record import Truth
from modsim3d.arrays import Array, Mask
from modsim3d.boxes import sizes

MODES = (0, 1, 2)
SOURCES = ("rendered", "analytic", "rectangles")


@dataclass(frozen=True)
class Annotation:
    """How vessels are annotated.

    Attributes:
        mode: 0: the full box of every vessel in the image, hidden or not; 1: the full box of every vessel with a
            visible pixel; 2: the visible box of every vessel with a visible pixel.
        source: Where the truth comes from: one of `SOURCES`.
        supersample: ID buffer pixels for each image pixel and axis (rendered source).
        render: `regions` draws only where vessels overlap, `full` whole images; the truth is the same.
        min_visible_px: Least number of visible pixels.
        min_visible_fraction: Least visible fraction.
        min_box_px: Least width and height of the annotated box.
        allow_camera_inside: Whether a camera may be inside another vessel's volume.
    """

    mode: int = 0
    source: str = "rendered"
    supersample: int = 1
    render: str = "regions"
    min_visible_px: float = 0.0
    min_visible_fraction: float = 0.0
    min_box_px: float = 0.0
    allow_camera_inside: bool = False


def annotation_boxes(truth: Truth, mode: int) -> Array:
    """The box that a mode annotates for each row, in pixels, shape (n, 4); NaN where it has none."""
    return truth.visible_boxes_px if mode == 2 else truth.full_boxes_px


def annotated_rows(truth: Truth, annotation: Annotation) -> Mask:
    """Whether the mode and the filters keep each row, shape (n,)."""
    boxes = annotation_boxes(truth, annotation.mode)
    big_enough = sizes(boxes) >= annotation.min_box_px  # a missing box is NaN: not kept
    keep: Mask = np.all(big_enough, axis=1)
    # What cannot be told (NaN) is kept only if nobody asks.
    if annotation.min_visible_px > 0:
        keep &= truth.visible_px >= annotation.min_visible_px
    if annotation.min_visible_fraction > 0:
        keep &= truth.visible_fraction >= annotation.min_visible_fraction
    if annotation.mode > 0:
        keep &= truth.visible_px > 0
    return keep
