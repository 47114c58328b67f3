"""What a detector wrote: boxes in frames, with the times of its own clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.errors import ModsimError


@dataclass(frozen=True, eq=False)
class BoxesAtTimes:
    """n detected boxes in F frames of one camera.

    Attributes:
        times_s: Time of each frame by the detector's clock, counted as the scene counts: from its first step on,
            ascending, shape (F,). Frames without boxes are included.
        frame: Index of each box's frame, shape (n,).
        boxes_px: Left, top, right and bottom edge, shape (n, 4).
    """

    times_s: Array
    frame: Indices
    boxes_px: Array

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            ModsimError: Shapes do not fit, times do not ascend, a box has no frame, or a number is not finite.
        """
        count = len(self.frame)
        if self.times_s.ndim != 1 or self.boxes_px.shape != (count, 4):
            found = f"times {self.times_s.shape}, frames {self.frame.shape}, boxes {self.boxes_px.shape}"
            raise ModsimError(f"detections: shapes (F,), (n,) and (n, 4) are needed (got {found})")
        if not (np.isfinite(self.times_s).all() and np.isfinite(self.boxes_px).all()):
            raise ModsimError("detections: a time or an edge of a box is not a finite number")
        if np.any(np.diff(self.times_s) <= 0):
            at = int(np.flatnonzero(np.diff(self.times_s) <= 0)[0])
            after = f"{self.times_s[at + 1]:g} s follows {self.times_s[at]:g} s"
            raise ModsimError(f"detections: the times of frames must ascend, but {after}")
        if count and not 0 <= self.frame.min() <= self.frame.max() < len(self.times_s):
            raise ModsimError(f"detections: a box is in a frame that is not among the {len(self.times_s)} frames")

    def some(self, most_frames: int) -> BoxesAtTimes:
        """At most so many of the frames, evenly spread, with their boxes."""
        if len(self.times_s) <= most_frames:
            return self
        kept = np.unique(np.linspace(0, len(self.times_s) - 1, most_frames).round().astype(int))
        number = np.full(len(self.times_s), -1)
        number[kept] = np.arange(len(kept))
        inside = number[self.frame] >= 0
        return BoxesAtTimes(self.times_s[kept], number[self.frame][inside], self.boxes_px[inside])
