"""What is known of the correlation between the normal numbers behind a confidence and the one before it.

A clipped confidence leaves its normal number open beyond a bound. Given the number before, the number is normal with
mean ρ·before and variance 1 − ρ² (see `persistence.Autoregressive`), so its density, or the probability that it lies
within its bounds, is the likelihood of ρ.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_LEAST_CHANCE = 1e-300


def pair_likelihood(before: Array, low: Array, high: Array, correlation: Array) -> Array:
    """Log-likelihood of correlations below 1, shapes (n,), of numbers between bounds; equal bounds are the number."""
    spread = np.sqrt(1 - correlation**2)
    below, above = _standard(before, low, high, correlation)
    known = low == high
    density = -(np.where(known, below, 0.0) ** 2) / 2 - np.log(spread)
    chance = np.log(np.maximum(special.ndtr(above) - special.ndtr(below), _LEAST_CHANCE))
    result: Array = np.where(known, density, chance)
    return result


def pair_score(before: Array, low: Array, high: Array, correlation: Array) -> Array:
    """Derivative of `pair_likelihood` by the correlation, shapes (n,)."""
    rest = 1 - correlation**2
    below, above = _standard(before, low, high, correlation)
    known = low == high
    z = np.where(known, below, 0.0)
    of_number = (correlation + z * before * np.sqrt(rest) - correlation * z**2) / rest
    chance = np.maximum(special.ndtr(above) - special.ndtr(below), _LEAST_CHANCE)
    slope_low, slope_high = (_slope(edge, before, correlation, rest) for edge in (below, above))
    result: Array = np.where(known, of_number, (slope_high - slope_low) / chance)
    return result


def _standard(before: Array, low: Array, high: Array, correlation: Array) -> tuple[Array, Array]:
    """Both bounds in standard deviations from the mean that the number before gives."""
    spread = np.sqrt(1 - correlation**2)
    return (low - correlation * before) / spread, (high - correlation * before) / spread


def _slope(edge: Array, before: Array, correlation: Array, rest: Array) -> Array:
    """Derivative of the probability below an edge, 0 where the edge is infinite."""
    finite = np.where(np.isfinite(edge), edge, 0.0)
    moved = -before / np.sqrt(rest) + finite * correlation / rest
    density = np.exp(-(finite**2) / 2) / np.sqrt(2 * np.pi)
    return np.where(np.isfinite(edge), density * moved, 0.0)
