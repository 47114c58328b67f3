"""What the detector is given and what it returns: columns over a run of frames of one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

KINDS = ("true", "false_positive", "persistent_false_positive", "duplicate", "merged", "split", "fragment")
"""Where a detection came from; `Detections.kind` indexes this.

`merged` is one box for two vessels and counts as the larger one's; a vessel in two parts is `split`, the larger part,
which counts as its detection, and `fragment`, the other.
"""
TRUE, FALSE_POSITIVE, PERSISTENT, DUPLICATE, MERGED, SPLIT, FRAGMENT = range(len(KINDS))
FALSE_KINDS = (FALSE_POSITIVE, PERSISTENT, DUPLICATE, FRAGMENT)
"""Kinds that count as false, as in an evaluation: all but the one detection of a vessel."""
_IS_FALSE = np.isin(np.arange(len(KINDS)), FALSE_KINDS)


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
        """Which are not the one detection of a vessel, shape (m,)."""
        return are_false(self.kind)


def are_false(kinds: Indices) -> Mask:
    """Whether each of m kinds is one of `FALSE_KINDS`, shape (m,)."""
    false: Mask = _IS_FALSE[kinds]
    return false
