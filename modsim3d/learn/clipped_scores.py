"""The normal distribution behind numbers that were clipped to a range."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_STEPS = 400
_SETTLED = 1e-10
_ROOT_2PI = float(np.sqrt(2 * np.pi))


def clipped_sums(values: Array, low: float, high: float) -> Array:
    """What the fit needs of each number: at the low end, at the high end, between, its value and square; (n, 5)."""
    at_low, at_high = values <= low, values >= high
    inside = ~(at_low | at_high)
    return np.column_stack([at_low, at_high, inside, np.where(inside, values, 0), np.where(inside, values**2, 0)]) * 1.0


def fit_clipped(sums: Array, low: float, high: float) -> tuple[Array, Array]:
    """Mean and standard deviation of largest likelihood, by expectation and maximisation (Dempster et al. (1977)).

    Args:
        sums: Of `clipped_sums`, shape (rows, 5).
        low: End of the range, at which what was below it lies.
        high: The other end.

    Returns:
        Shapes (rows,); NaN where there is nothing.
    """
    below, above, inside, first, second = sums.T
    number = below + above + inside
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (below * low + above * high + first) / number
        std = np.sqrt(np.maximum((below * low**2 + above * high**2 + second) / number - mean**2, 1e-12))
        for _ in range(_STEPS):
            m_low, s_low = _tail((low - mean) / std, -1)
            m_high, s_high = _tail((high - mean) / std, 1)
            total = below * (mean + std * m_low) + above * (mean + std * m_high) + first
            squares = (
                below * (mean**2 + 2 * mean * std * m_low + std**2 * s_low)
                + above * (mean**2 + 2 * mean * std * m_high + std**2 * s_high)
                + second
            )
            new_mean = total / number
            new_std = np.sqrt(np.maximum(squares / number - new_mean**2, 1e-12))
            change = np.nanmax(np.abs(new_mean - mean) + np.abs(new_std - std), initial=0.0)
            mean, std = new_mean, new_std
            if change < _SETTLED:
                break
    return mean, std


def _tail(edge: Array, side: int) -> tuple[Array, Array]:
    """Mean and mean square of a standard normal number below (−1) or above (1) an edge."""
    away = side * edge
    density = np.exp(-0.5 * away**2) / _ROOT_2PI
    mass = np.maximum(special.ndtr(-away), 1e-300)
    hazard = np.where(away > 30, away, density / mass)
    return side * hazard, 1 + away * hazard
