"""Student's t: intervals of a mean, for a number of seeds that was fixed beforehand."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from modsim3d.arrays import Array

_SAME = 1e-12
"""Values that differ by less than this share of their size are the same: the mean of equal numbers may be off by so
much."""


def half_widths(mean: ArrayLike, deviation: ArrayLike, count: ArrayLike, alpha: float) -> Array:
    """How far the bounds of means lie from them; NaN with fewer than two values, or if all are the same.

    Values that are all the same say nothing of how far the next one may be off: an interval of no width would claim
    that none ever differs.

    Args:
        mean: Means, all of one shape.
        deviation: Standard deviations of the values, with n − 1.
        count: Numbers of values.
        alpha: The probability of error, of each bound; exact for normal values, an approximation for others.
    """
    mean, deviation, count = (np.asarray(each, dtype=np.float64) for each in (mean, deviation, count))
    differ = (count > 1) & (deviation > _SAME * np.maximum(1.0, np.abs(mean)))
    half = special.stdtrit(np.maximum(count - 1, 1), 1 - alpha) * deviation / np.sqrt(np.maximum(count, 1))
    widths: Array = np.where(differ, half, np.nan)
    return widths


def t_bounds(values: Array, alpha: float) -> tuple[float, float] | None:
    """The lower and the upper bound of the mean; None of fewer than two values, or if all are the same.

    Args:
        values: A value for each seed, shape (n,).
        alpha: The probability of error of each bound, as in `half_widths`.
    """
    if len(values) < 2:
        return None
    mean = float(values.mean())
    half = float(half_widths(mean, values.std(ddof=1), len(values), alpha))
    return None if np.isnan(half) else (mean - half, mean + half)
