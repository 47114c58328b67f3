"""Bounds of a mean by Student's t, for a number of seeds that was fixed beforehand."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_SAME = 1e-12
"""Values that differ by less than this share of their size are the same: the mean of equal numbers may be off by so
much."""


def all_same(values: Array) -> bool:
    """Whether all values, shape (n,), are the same number."""
    return bool(np.ptp(values) <= _SAME * max(1.0, float(np.max(np.abs(values)))))


def t_bounds(values: Array, alpha: float) -> tuple[float, float] | None:
    """The lower and the upper bound of the mean; None of fewer than two values, or if all are the same.

    Values that are all the same say nothing of how far the next one may be off: an interval of no width would claim
    that none ever differs.

    Args:
        values: A value for each seed, shape (n,).
        alpha: The probability of error, of each bound; exact for normal values, an approximation for others.
    """
    count = len(values)
    if count < 2 or all_same(values):
        return None
    mean, half = values.mean(), special.stdtrit(count - 1, 1 - alpha) * values.std(ddof=1) / np.sqrt(count)
    return float(mean - half), float(mean + half)
