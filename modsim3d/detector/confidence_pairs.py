"""What is known of the correlation between the normal numbers behind a confidence and the one before it.

A clipped confidence leaves its normal number open beyond a bound. Given the number before, the number is normal with
mean ρ·before and variance 1 − ρ² (see `persistence.Autoregressive`), so its density, or the probability that it lies
within its bounds, is the likelihood of ρ. The standard deviation of confidences that persist is not known well, so all
numbers may be too large by a factor, which is left free.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_LEAST_CHANCE, _NEAR = 1e-300, 1e-4


def pair_likelihood(before: Array, low: Array, high: Array, correlation: Array, factor: float = 1.0) -> Array:
    """Log-likelihood of correlations below 1, shapes (n,), of numbers between bounds; equal bounds are the number."""
    spread = np.sqrt(1 - correlation**2)
    below, above = (part / factor for part in _standard(before, low, high, correlation))
    known = low == high
    density = -(np.where(known, below, 0.0) ** 2) / 2 - np.log(spread * factor)
    chance = np.log(np.maximum(special.ndtr(above) - special.ndtr(below), _LEAST_CHANCE))
    result: Array = np.where(known, density, chance)
    return result


def pair_score(before: Array, low: Array, high: Array, correlation: Array) -> Array:
    """Derivatives of `pair_likelihood` by the correlation, less what a factor explains as well, shape (n,)."""
    reach = np.minimum(_NEAR, (1 - correlation) / 2)

    def at(moved: Array, factor: float = 1.0) -> Array:
        return pair_likelihood(before, low, high, moved, factor)

    by_correlation = (at(correlation + reach) - at(correlation - reach)) / (2 * reach)
    by_factor = (at(correlation, 1 + _NEAR) - at(correlation, 1 - _NEAR)) / (2 * _NEAR)
    squares = float((by_factor**2).sum())
    share = float((by_correlation * by_factor).sum()) / squares if squares > 0 else 0.0
    result: Array = by_correlation - share * by_factor
    return result


def _standard(before: Array, low: Array, high: Array, correlation: Array) -> tuple[Array, Array]:
    """Both bounds in standard deviations from the mean that the number before gives."""
    spread = np.sqrt(1 - correlation**2)
    return (low - correlation * before) / spread, (high - correlation * before) / spread
