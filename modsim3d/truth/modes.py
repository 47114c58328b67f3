"""Which vessels are annotated, and with which box (Jessen & Mohr (2023), §7.5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.boxes import sizes
from modsim3d.truth.truth_record import Truth

SOURCES = ("rendered", "analytic", "rectangles")


@dataclass(frozen=True)
class Annotation:
    """How vessels are annotated.

    Attributes:
        mode: 0: the full box of every vessel in the image, hidden or not; 1: the full box of every vessel with a
            visible pixel; 2: the visible box of every vessel with a visible pixel.
        source: Where the truth comes from: one of `SOURCES`.
        supersample: Buffer pixels per image pixel and axis (rendered source).
        render: `regions` draws only where vessels overlap, `full` draws whole images; the truth is the same.
        min_visible_px: A vessel with fewer visible pixels is not annotated.
        min_visible_fraction: A vessel with a smaller visible fraction is not annotated.
        min_box_px: A vessel whose box is narrower or lower is not annotated.
        check: How many frames the cross-check draws: a `sample`, `all`, or none (`off`).
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
    check: str = "sample"


def annotation_boxes(truth: Truth, mode: int) -> Array:
    """The box that a mode annotates in each of n rows, in pixels, shape (n, 4); NaN where there is none."""
    return truth.visible_boxes_px if mode == 2 else truth.full_boxes_px


def annotated_rows(truth: Truth, annotation: Annotation) -> Mask:
    """Whether the mode and the filters keep each of n rows, shape (n,)."""
    boxes = annotation_boxes(truth, annotation.mode)
    big_enough = sizes(boxes) >= annotation.min_box_px  # false for a missing box, which is NaN
    keep: Mask = np.all(big_enough, axis=1)
    # An unknown value (NaN) fails a filter, so it is compared only if the filter is set.
    if annotation.min_visible_px > 0:
        keep &= truth.visible_px >= annotation.min_visible_px
    if annotation.min_visible_fraction > 0:
        keep &= truth.visible_fraction >= annotation.min_visible_fraction
    if annotation.mode > 0:
        keep &= truth.visible_px > 0
    return keep
