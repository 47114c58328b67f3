"""When a camera takes its frames: at its own rate, each at the first step of the scene at or after its due time."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Mask

_EARLY = 1e-6  # of an interval: 0.3 / 0.1 is a hair below 3, and the frame at 0.3 s is due


def takes_frame(times_s: Array, rate_hz: float | None, offset_s: float) -> Mask:
    """Whether a camera takes a frame at each of consecutive steps, shape (n,): one has become due since the last step.

    Frame k is due at offset + k / rate. A step has one frame at most: if several become due between two steps, the
    later ones are lost.

    Args:
        times_s: Times of the steps since the scene's first step, shape (n,). Frames due by the first are taken there.
        rate_hz: Frames a second; None for one at every step from the offset on.
        offset_s: Due time of the first frame.
    """
    if rate_hz is None:
        return times_s >= offset_s - _EARLY
    due = np.maximum(np.floor((times_s - offset_s) * rate_hz + _EARLY).astype(np.int64) + 1, 0)
    taken: Mask = np.diff(due, prepend=0) > 0
    return taken
