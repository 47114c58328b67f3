"""By how much boxes of small vessels change from one frame to the next through the errors of the detector alone.

Known vessels show it: a box of 8 px whose width errs by 3 px is the same vessel with 4 px and with 12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.observed.observed import Observed

_SMALLEST = 0.25
"""Share of the matched boxes that are called small; errors of larger ones are often larger in pixels."""
_LEAST_CHANGES = 20
TO_STD = 1.4826
"""Median absolute deviation to standard deviation of normal numbers."""


@dataclass(frozen=True, eq=False)
class Jitter:
    """Standard deviations of what the error of a small box changes by between two frames.

    Attributes:
        place_px: Of the centre, in x and y, shape (2,).
        size_px: Of width and height, shape (2,).
    """

    place_px: Array
    size_px: Array

    @property
    def off_px(self) -> float:
        """Of the distance between two centres."""
        return float(np.hypot(*self.place_px))


STEADY = Jitter(np.zeros(2), np.zeros(2))


def jitter_of(observed: Observed, longest_s: float) -> Jitter:
    """That of the smallest known vessels, from detections at most so long apart; none where they are too few."""
    pairs, images = observed.pairs, observed.labelled.images
    if not len(pairs):
        return STEADY
    identity = observed.labelled.annotations.identity[pairs.rows]
    sequence, time_s = images.sequence[pairs.image], images.time_s[pairs.image]
    order = np.lexsort((time_s, identity, sequence))
    same = (np.diff(sequence[order]) == 0) & (np.diff(identity[order]) == 0) & (identity[order][1:] >= 0)
    with np.errstate(invalid="ignore"):
        near = same & (np.diff(time_s[order]) <= longest_s)
    area = pairs.sides_px[order, :2].prod(axis=1)
    small = near & (np.maximum(area[1:], area[:-1]) <= np.quantile(area, _SMALLEST))
    changes = np.diff(pairs.error_px[order], axis=0)[small]
    if len(changes) < _LEAST_CHANGES:
        return STEADY
    spread = TO_STD * np.median(np.abs(changes), axis=0)
    return Jitter(spread[:2], spread[2:])
