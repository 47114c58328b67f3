"""What the detector is given and what it returns: columns over a run of frames of one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TRUE, FALSE_POSITIVE = 0, 1
KINDS = ("true", "false_positive")
"""Where a detection came from; `Detections.kind` indexes this."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A run of S frames of one camera, one after another.

    Attributes:
        camera: The camera's ID.
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
        vessel_ids: Names of the scene's vessels.
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
    """What the simulated detector put out, m rows ordered by frame and shuffled within each.

    Attributes:
        states: Index of the performance state of each frame, shape (S,).
        frame: Index into the run of frames, non-decreasing, shape (m,).
        target: Row of `Targets` that a detection came from, -1 for a false positive, shape (m,).
        kind: Index into `KINDS`, shape (m,).
        label: Index into the detector's labels, shape (m,).
        confidence: In [threshold, 1], shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, inside the image, shape (m, 4).
        errors_px: e_x, e_y, e_w, e_h before clipping, NaN for false positives, shape (m, 4).
        redrawn: Whether the first draw of the box error was degenerate and drawn anew, shape (m,).
    """

    states: Indices
    frame: Indices
    target: Indices
    kind: Indices
    label: Indices
    confidence: Array
    boxes_px: Array
    errors_px: Array
    redrawn: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)
