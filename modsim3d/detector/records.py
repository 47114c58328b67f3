"""Input and output of the detector: columns over a run of frames of one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import sizes

KINDS = ("true", "false_positive", "persistent_false_positive", "duplicate", "merged", "split", "fragment")
"""Where a detection came from; `Detections.kind` indexes this.

`merged` is one box for two vessels and counts as the larger one's; a vessel in two parts is `split`, the larger part,
which counts as its detection, and `fragment`, the other.
"""
TRUE, FALSE_POSITIVE, PERSISTENT, DUPLICATE, MERGED, SPLIT, FRAGMENT = range(len(KINDS))
FALSE_KINDS = (FALSE_POSITIVE, PERSISTENT, DUPLICATE, FRAGMENT)
"""Kinds that count as false, as in an evaluation: all but the one detection of a vessel."""
_IS_FALSE = np.isin(np.arange(len(KINDS)), FALSE_KINDS)


def are_false(kind: Indices) -> Mask:
    """Mask of the kinds that count as false, same shape."""
    false: Mask = _IS_FALSE[kind]
    return false


@dataclass(frozen=True, eq=False)
class CameraFrames:
    """A run of S frames of one camera, one after another; a camera need not take one at each of the scene's steps.

    Attributes:
        steps: Step of each frame, ascending, not necessarily consecutive, shape (S,).
        times_s: Time of each frame since the scene's first step, shape (S,).
        image_size_px: Width and height.
        sea_half_planes: (a, b, c) for each frame, shape (S, 3): a·x + b·y + c >= 0 on the sea side of the
            horizon, in pixels.
        previous_s: Time of the camera's frame before these; −∞ if there is none.
    """

    camera: str
    steps: Indices
    times_s: Array
    image_size_px: tuple[int, int]
    sea_half_planes: Array
    previous_s: float = -math.inf

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.steps)


@dataclass(frozen=True, eq=False)
class Targets:
    """The annotated vessels of those frames, n rows ordered by frame.

    Attributes:
        frame: Index into the run of frames, non-decreasing, shape (n,).
        vessel: Index into `vessel_ids`, shape (n,).
        label: Index into the detector's labels, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max of the annotated boxes, shape (n, 4).
        visible_fraction: NaN where unknown, shape (n,).
        depth_m: Shape (n,).
    """

    frame: Indices
    vessel: Indices
    label: Indices
    boxes_px: Array
    visible_fraction: Array
    depth_m: Array
    vessel_ids: tuple[str, ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class Detections:
    """The output of the simulated detector, m rows ordered by frame and shuffled within each.

    Attributes:
        states: Index of the performance state of each frame, shape (S,).
        frame: Index into the run of frames, non-decreasing, shape (m,).
        target: Row of `Targets` that a detection came from, -1 for a false positive, shape (m,).
        partner: Row of the smaller vessel in a merged box, else -1, shape (m,).
        kind: Index into `KINDS`, shape (m,).
        label: Index into the detector's labels, shape (m,).
        confidence: In [threshold, 1], shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, inside the image, shape (m, 4).
        errors_px: e_x, e_y, e_w, e_h before clipping; NaN for what is not one box of one vessel, shape (m, 4).
        redrawn: Whether the first draw of the box error was degenerate and was resampled, shape (m,).
        gated: Whether a gate, not a draw, kept each of the n targets from being detected, shape (n,).
    """

    states: Indices
    frame: Indices
    target: Indices
    partner: Indices
    kind: Indices
    label: Indices
    confidence: Array
    boxes_px: Array
    errors_px: Array
    redrawn: Mask
    gated: Mask

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    def false(self) -> Mask:
        """Mask of all but the one detection of each vessel, shape (m,)."""
        return are_false(self.kind)


# ---- Hard limits of a detector ----

_EARLY = 1e-6  # of an interval: 0.6 / 0.2 is a hair below 3, and the frame at 0.6 s is due


@dataclass(frozen=True)
class Gates:
    """Rules before and after the draws; each is off unless given.

    Attributes:
        max_range_m: Vessels at a greater depth are never detected.
        min_box_px: Vessels whose box is narrower or lower are never detected.
        max_occlusion: Vessels of which a larger share is hidden are never detected; unknown shares pass.
        update_interval_s: The detector runs at the first frame at or after each multiple of this.
        max_detections: Only so many detections of each frame are output, the most confident ones.
    """

    max_range_m: float | None = None
    min_box_px: float | None = None
    max_occlusion: float | None = None
    update_interval_s: float | None = None
    max_detections: int | None = None

    def due(self, frames: CameraFrames) -> Mask:
        """At which frames the detector runs, shape (S,)."""
        if self.update_interval_s is None:
            return np.ones(len(frames), dtype=bool)
        previous_s = 0.0 if math.isinf(frames.previous_s) else frames.previous_s
        intervals = np.floor(np.concatenate([[previous_s], frames.times_s]) / self.update_interval_s + _EARLY)
        if math.isinf(frames.previous_s):
            intervals[0] = -1  # a camera's first frame is always due
        due: Mask = np.diff(intervals) > 0
        return due

    def passed(self, frames: CameraFrames, targets: Targets) -> Mask:
        """Mask of the targets that can be detected at all, shape (n,)."""
        passed = self.due(frames)[targets.frame]
        if self.max_range_m is not None:
            passed &= targets.depth_m <= self.max_range_m
        if self.min_box_px is not None:
            passed &= np.all(sizes(targets.boxes_px) >= self.min_box_px, axis=1)
        if self.max_occlusion is not None:
            passed &= ~(1 - targets.visible_fraction > self.max_occlusion)
        return passed

    def most_confident(self, frame: Indices, confidence: Array, key: Array) -> Mask:
        """Mask of the detections that are output, given frame, confidence and a key that breaks ties, shapes (m,)."""
        if self.max_detections is None:
            return np.ones(len(frame), dtype=bool)
        order = np.lexsort((key, -confidence, frame))
        ordered = frame[order]
        rank = np.arange(len(frame)) - np.searchsorted(ordered, ordered)
        kept = np.empty(len(frame), dtype=bool)
        kept[order] = rank < self.max_detections
        return kept
