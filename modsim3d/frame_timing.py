"""When a camera takes its frames: at its own rate, each at the first of the scene's steps that is not too early."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

_EARLY = 1e-6  # of an interval: 0.3 / 0.1 is a hair below 3, and the frame at 0.3 s is due


def frames_due(times_s: Array, rate_hz: float, offset_s: float) -> Indices:
    """How many frames a camera should have taken by each time, shape (n,).

    Frame k is due at offset + k / rate.

    Args:
        times_s: Since the scene's first step, shape (n,).
        rate_hz: Frames a second.
        offset_s: When the first is due.
    """
    due = np.floor((times_s - offset_s) * rate_hz + _EARLY).astype(np.int64) + 1
    return np.maximum(due, 0)


def takes_frame(times_s: Array, rate_hz: float | None, offset_s: float) -> Mask:
    """At which of consecutive steps a camera takes a frame: where one has fallen due since the step before.

    A step gives one frame at most; where several fall due between two steps, the later ones are lost.

    Args:
        times_s: Of the steps, as if there were none before the first, shape (n,).
        rate_hz: Frames a second; None for one at every step from the offset on.
        offset_s: When the first frame is due.

    Returns:
        Shape (n,).
    """
    if rate_hz is None:
        return times_s >= offset_s - _EARLY
    taken: Mask = np.diff(frames_due(times_s, rate_hz, offset_s), prepend=0) > 0
    return taken
