"""Intervals and bounds of means, shares and rates."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from modsim3d.core.arrays import Array

MAD_TO_STD = 1.4826  # median absolute deviation to standard deviation, of normal numbers
_SAME = 1e-12
"""Values that differ by less than this share of their size are the same: the mean of equal numbers may be off by so
much."""


def half_widths(mean: ArrayLike, deviation: ArrayLike, count: ArrayLike, alpha: float) -> Array:
    """Distances of bounds from means, by Student's t; NaN with fewer than two values, or if all are the same. Values
    that are all the same say nothing of how far the next one may be off: an interval of no width would claim that none
    ever differs. `deviation` is the standard deviation with n − 1; all shapes broadcast. `alpha` is the probability of
    error of each bound; exact for normal values, an approximation for others."""
    mean, deviation, count = (np.asarray(numbers, dtype=np.float64) for numbers in (mean, deviation, count))
    differ = (count > 1) & (deviation > _SAME * np.maximum(1.0, np.abs(mean)))
    half = special.stdtrit(np.maximum(count - 1, 1), 1 - alpha) * deviation / np.sqrt(np.maximum(count, 1))
    return np.where(differ, half, np.nan)


def t_bounds(values: Array, alpha: float) -> tuple[float, float] | None:
    """Bounds of a mean by Student's t; None of fewer than two values, if all are the same, or if one is not finite.
    There is a value for each seed, shape (n,); `alpha` is as in `half_widths`."""
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return None
    mean = float(values.mean())
    half = float(half_widths(mean, values.std(ddof=1), len(values), alpha))
    return None if np.isnan(half) else (mean - half, mean + half)


def exact_bounds(count: float, trials: float, alpha: float) -> tuple[float, float]:
    """Bounds of a share for a number of trials that was fixed beforehand, by Clopper & Pearson (1934). Effective counts
    of successes need not be whole. `alpha` is the greatest probability of error of each bound."""
    failures = trials - count
    low = float(special.betaincinv(count, failures + 1, alpha)) if count > 0 else 0.0
    high = float(special.betainccinv(count + 1, failures, alpha)) if failures > 0 else 1.0
    return low, high


def jeffreys_share(share: Array, trials: Array, level: Array | float) -> Array:
    """Quantiles of a share that was seen in a number of trials, by Jeffreys's prior; shapes broadcast."""
    hits = share * trials
    quantile: Array = special.betaincinv(hits + 0.5, trials - hits + 0.5, level)
    return quantile


def jeffreys_rate(rate: Array, units: Array, level: Array | float) -> Array:
    """Quantiles of a rate that was seen in a number of units, by Jeffreys's prior; shapes broadcast."""
    quantile: Array = special.gammaincinv(rate * units + 0.5, level) / units
    return quantile
