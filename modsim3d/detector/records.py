"""Input and output of the detector: columns over a run of frames of one camera."""

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import sizes

KINDS = ("true", "false_positive", "persistent_false_positive", "duplicate", "merged", "split", "fragment", "on_vessel")
"""Where a detection came from; `Detections.kind` indexes this.

`merged` is one box for two vessels and counts as the larger one's; a vessel in two parts is `split`, the larger part,
which counts as its detection, and `fragment`, the other. `on_vessel` is a false positive that lies on a vessel.
"""
TRUE, FALSE_POSITIVE, PERSISTENT, DUPLICATE, MERGED, SPLIT, FRAGMENT, ON_VESSEL = range(len(KINDS))
FALSE_KINDS = (FALSE_POSITIVE, PERSISTENT, DUPLICATE, FRAGMENT, ON_VESSEL)
"""Kinds that count as false, as in an evaluation: all but the one detection of a vessel."""
_IS_FALSE = np.isin(np.arange(len(KINDS)), FALSE_KINDS)


def are_false(kind: Indices) -> Mask:
    """Mask of the kinds that count as false, same shape."""
    return _IS_FALSE[kind]


@dataclass(frozen=True, eq=False)
class CameraFrames:
    """A run of S frames of one camera, one after another; a camera need not take one at each of the scene's steps."""

    camera: str
    steps: Indices  # step of each frame, ascending, not necessarily consecutive, shape (S,)
    times_s: Array  # since the scene's first step, shape (S,)
    image_size_px: tuple[int, int]  # width and height
    sea_half_planes: Array  # (a, b, c): a·x + b·y + c >= 0 on the sea side of the horizon, in pixels, shape (S, 3)
    previous_s: float = -math.inf  # time of the camera's frame before these; −∞ if there is none

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.steps)


@dataclass(frozen=True, eq=False)
class Targets:
    """The annotated vessels of those frames, n rows ordered by frame."""

    frame: Indices  # index into the run of frames, non-decreasing, shape (n,)
    vessel: Indices  # index into `vessel_ids`, shape (n,)
    label: Indices  # index into the detector's labels, shape (n,)
    boxes_px: Array  # x_min, y_min, x_max, y_max of the annotated boxes, shape (n, 4)
    visible_fraction: Array  # NaN where unknown, shape (n,)
    depth_m: Array  # shape (n,)
    vessel_ids: tuple[str, ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class Detections:
    """The output of the simulated detector, m rows ordered by frame and shuffled within each."""

    states: Indices  # index of the performance state of each frame, shape (S,)
    frame: Indices  # index into the run of frames, non-decreasing, shape (m,)
    target: Indices  # row of `Targets` that a detection came from, −1 for a false positive, shape (m,)
    partner: Indices  # row of the smaller vessel in a merged box, else −1, shape (m,)
    kind: Indices  # index into `KINDS`, shape (m,)
    label: Indices  # index into the detector's labels, shape (m,)
    confidence: Array  # in [threshold, 1], shape (m,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, inside the image, shape (m, 4)
    errors_px: Array  # e_x, e_y, e_w, e_h before clipping; NaN for what is not one box of one vessel, (m, 4)
    redrawn: Mask  # whether the first draw of the box error was degenerate and was resampled, shape (m,)
    gated: Mask  # whether a gate, not a draw, kept each of the n targets from being detected, shape (n,)

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
    """Rules before and after the draws; each is off unless given."""

    max_range_m: float | None = None  # vessels at a greater depth are never detected
    min_box_px: float | None = None  # nor are those whose box is narrower or lower
    max_occlusion: float | None = None  # nor those of which a larger share is hidden; unknown shares pass
    update_interval_s: float | None = None  # the detector runs at the first frame at or after each multiple
    max_detections: int | None = None  # in each frame only so many are output, the most confident ones

    def due(self, frames: CameraFrames) -> Mask:
        """At which frames the detector runs, shape (S,)."""
        if self.update_interval_s is None:
            return np.ones(len(frames), dtype=bool)
        previous_s = 0.0 if math.isinf(frames.previous_s) else frames.previous_s
        intervals = np.floor(np.concatenate([[previous_s], frames.times_s]) / self.update_interval_s + _EARLY)
        if math.isinf(frames.previous_s):
            intervals[0] = -1  # a camera's first frame is always due
        return np.diff(intervals) > 0

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
