"""Frames without detections, of logs that only say what was detected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.budgets import MAX_FRAMES

_OFF = 0.25
"""A gap may be so much of an interval away from a whole number of them: times are often those of the file's writing."""
_MOST_OFF = 0.05
"""Share of the gaps that may be further off where the interval is taken from the times themselves."""


@dataclass(frozen=True, eq=False)
class Filled:
    """Times of all frames of a camera: those with detections, and those that must have been between.

    Attributes:
        time_s: The times that were added, shape (k,).
        rate_hz: The frame rate.
        longest_s: The longest time without any detection.
    """

    time_s: Array
    rate_hz: float
    longest_s: float


def filled(time_s: Array, rate_hz: float | None, source: str) -> Filled:
    """The frames without detections between those with.

    Args:
        time_s: Ascending times of the frames with detections, shape (n,).
        rate_hz: The frame rate; if None, that of the usual gap between two frames.
        source: What messages call the log.

    Raises:
        InputError: The times do not fit a frame rate, or there would be too many frames.
    """
    gaps = np.diff(time_s)
    if not len(gaps):
        return Filled(np.empty(0), rate_hz or 1.0, 0.0)
    interval = 1 / rate_hz if rate_hz else _usual(gaps)
    count = np.maximum(np.rint(gaps / interval), 1)
    off = np.abs(gaps / interval - count) > _OFF
    if off.mean() > (0 if rate_hz else _MOST_OFF):
        first = int(np.flatnonzero(off)[0])
        found = f"frames {gaps[first]:g} s apart after {time_s[first]:.12g} s"
        if rate_hz:
            problem = f"{found} do not fit --frame-rate {rate_hz:g}, which is a frame every {interval:g} s"
        else:
            problem = (
                f"its frames without detections cannot be known: the usual gap is {interval:g} s, with {found}; "
                "give --frame-rate, or a row with empty cells for each frame without detections"
            )
        raise InputError(source, [problem])
    if len(time_s) + count.sum() > MAX_FRAMES:
        problem = f"spans {len(time_s) + int(count.sum()):,} frames of {1 / interval:g} Hz, at most {MAX_FRAMES:,}"
        raise InputError(source, [problem])
    between = [time_s[k] + gaps[k] * np.arange(1, count[k]) / count[k] for k in np.flatnonzero(count > 1).tolist()]
    return Filled(np.concatenate([np.empty(0), *between]), 1 / interval, float(gaps.max()))


def _usual(gaps: Array) -> float:
    """The gap that most of those that are no multiple of it are near to, shape (n,): the median of the short half."""
    short = np.sort(gaps)[: max(1, (len(gaps) + 1) // 2)]
    return float(np.median(short))
