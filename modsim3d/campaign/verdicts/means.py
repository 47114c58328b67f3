"""Intervals and bounds of a mean, for a number of seeds that was fixed beforehand."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from modsim3d.arrays import Array

_SAME = 1e-12
"""Values that differ by less than this share of their size are the same: the mean of equal numbers may be off by so
much."""
SKEWNESS = 1.0
"""The least skewness that values are taken to have: a few of them seldom show the tail that they come from."""
VARIATION = 1.5
"""How much of h/d a half-width h gains of itself, if the values lack d to the best one."""
VARIATION_FROM_ZERO = 1.1
"""The same of scores that are 0 at best, as numbers, times and errors are; all three by `script/campaign sequences`."""


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
    """The bounds of the mean; None of fewer than two values, if all are the same, or if one is not finite.

    Args:
        values: A value for each seed, shape (n,).
        alpha: The probability of error of each bound, as in `half_widths`.
    """
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return None
    mean = float(values.mean())
    half = float(half_widths(mean, values.std(ddof=1), len(values), alpha))
    return None if np.isnan(half) else (mean - half, mean + half)


def skewed_bounds(values: Array, alpha: float, greatest: float = math.inf) -> Array:
    """Lower bounds of means of values that may be skewed towards low ones, see `corrected_bounds`.

    Args:
        values: Shape (…, n); those of each row have a mean.
        alpha: The probability of error that is aimed at.
        greatest: The greatest possible value.
    """
    count, mean = values.shape[-1], values.mean(axis=-1)
    falls = mean[..., None] - values
    variance, cubed = (falls**2).mean(axis=-1), (falls**3).mean(axis=-1)
    deviation = np.sqrt(variance * count / max(count - 1, 1))
    scale = variance**1.5
    skewness = np.divide(cubed, scale, out=np.zeros_like(cubed), where=scale > 0)
    return corrected_bounds(mean, deviation, skewness, count, alpha, greatest)


def corrected_bounds(
    mean: ArrayLike, deviation: ArrayLike, skewness: ArrayLike, count: int, alpha: float, greatest: float = math.inf
) -> Array:
    """Lower bounds of means, the lesser of two; minus infinity where there is none. They are approximations.

    - Student's t, corrected by the cubic of Hall (1992), "On the removal of skewness by transformation", J. R. Stat.
      Soc. B 54, 221-228, for the skewness of the sample, and one of at least `SKEWNESS`.
    - Student's t with h·(1 + v·h/d) for the half-width h, at most 2·h, where d is what the mean lacks to the best value
      and v is `VARIATION` or `VARIATION_FROM_ZERO`. In scores that cannot be better than best, spread and skewness come
      from the same bad runs. For v = 1 and small h/d it is the correction for a skewness of three times the
      coefficient of variation of what values lack to the best one, which the inverse Gaussian distribution has; a gamma
      distribution has two, a Poisson distribution one.

    The rule was chosen, and how often it errs measured, by `script/campaign sequences`.

    Args:
        mean: Means, all of one shape.
        deviation: Standard deviations of the values, with n − 1.
        skewness: Skewness of the values, with n, mirrored: positive if they are skewed towards low ones.
        count: Number of values.
        alpha: The probability of error that is aimed at.
        greatest: The greatest possible value.
    """
    mean, deviation = np.asarray(mean, dtype=np.float64), np.asarray(deviation, dtype=np.float64)
    half, lacks = half_widths(mean, deviation, count, alpha), greatest - mean
    skewness, variation = np.maximum(skewness, SKEWNESS), VARIATION if greatest else VARIATION_FROM_ZERO
    with np.errstate(divide="ignore", invalid="ignore"):
        error = half / deviation
        cubic = deviation * 3 / skewness * (1 - np.cbrt(1 - skewness * (error + skewness / (6 * count))))
        related = half * (1 + np.minimum(variation * half / lacks, 1))
    bounds: Array = np.where(np.isnan(half), -math.inf, mean - np.maximum(cubic, related))
    return bounds
