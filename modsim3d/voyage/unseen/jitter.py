"""By how much boxes of small vessels change from one frame to the next through the errors of the detector alone.

Known vessels show it: a box of 8 px whose width errs by 3 px is the same vessel with 4 px and with 12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import sizes
from modsim3d.learn.observed.observed import Observed

_SMALLEST = 0.25
"""Share of the matched boxes that are called small; errors of larger ones are often larger in pixels."""
_LEAST_CHANGES = 20
_MUCH_SMALLER = 1 / 3
"""Boxes of a smaller share of their side err by less in proportion: nothing shows that errors stay as large."""
TO_STD = 1.4826
"""Median absolute deviation to standard deviation of normal numbers."""


@dataclass(frozen=True, eq=False)
class Jitter:
    """Standard deviations of what the error of a small box changes by between two frames.

    Attributes:
        place_px: Of the centre, in x and y, shape (2,).
        size_px: Of width and height, shape (2,).
        side_px: Median of the square root of the area of the boxes that show it.
    """

    place_px: Array
    size_px: Array
    side_px: float

    def off_px(self, side_px: Array | float) -> Array:
        """How far centres of boxes of some sides are apart, for a standard deviation in x and y, shape of the sides."""
        return float(np.hypot(*self.place_px)) * self._share(side_px)

    def resized_px(self, side_px: Array | float) -> Array:
        """Standard deviations of what width and height change by, shape (..., 2)."""
        return self.size_px * self._share(side_px)[..., None]

    def _share(self, side_px: Array | float) -> Array:
        return np.minimum(np.asarray(side_px) / (_MUCH_SMALLER * self.side_px), 1.0)


STEADY = Jitter(np.zeros(2), np.zeros(2), 1.0)


def jitter_of(observed: Observed, longest_s: float) -> Jitter:
    """Jitter of the smallest known vessels in full view, from detections at most so long apart; 0 if they are few."""
    pairs, images = observed.pairs, observed.labelled.images
    if not len(pairs):
        return STEADY
    identity = observed.labelled.annotations.identity[pairs.rows]
    sequence, time_s = images.sequence[pairs.image], images.time_s[pairs.image]
    whole = np.flatnonzero(pairs.edges.known.all(axis=1) & (identity >= 0))
    order = whole[np.lexsort((time_s[whole], identity[whole], sequence[whole]))]
    same = (np.diff(sequence[order]) == 0) & (np.diff(identity[order]) == 0)
    with np.errstate(invalid="ignore"):
        near = same & (np.diff(time_s[order]) <= longest_s)
    side_px = np.sqrt(sizes(pairs.annotated_px[order]).prod(axis=1))
    of_two = np.maximum(side_px[1:], side_px[:-1])[near]
    changes = np.diff(pairs.error_px[order], axis=0)[near]
    small = of_two <= np.quantile(of_two, _SMALLEST) if len(of_two) else near[:0]
    if np.count_nonzero(small) < _LEAST_CHANGES:
        return STEADY
    spread = TO_STD * np.median(np.abs(changes[small]), axis=0)
    return Jitter(spread[:2], spread[2:], float(np.median(of_two[small])))
