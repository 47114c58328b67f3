"""Normal numbers clipped to a range, those outside moved to its ends (Tobin (1958)): distribution, scores and fit."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_REACH = 9.0  # standard deviations that the integrals go to
_MOST_ROUNDS, _SETTLED = 400, 1e-10


def clipped_score(scores: Array, means: Array | float, std: float, threshold: float) -> Array:
    """Derivatives of the log-likelihood of scores (...) by mean and standard deviation, shape (..., 2)."""
    z = (scores - means) / std
    low, high = (threshold - np.asarray(means)) / std, (1 - np.asarray(means)) / std
    below, above = -_hazard(-low), _hazard(high)
    first = np.where(scores <= threshold, below, np.where(scores >= 1, above, z))
    second = np.where(scores <= threshold, below * low, np.where(scores >= 1, above * high, z**2 - 1))
    return np.stack([first, second], axis=-1) / std


def _hazard(z: Array) -> Array:
    """Normal density over the tail above z."""
    ratio: Array = np.exp(-(z**2) / 2 - special.log_ndtr(-z)) / np.sqrt(2 * np.pi)
    return ratio


def clipped_laws(means: Array, std: float, threshold: float) -> tuple[Array, Array]:
    """Quadrature nodes of the clipped law of each mean (n,), and their probabilities, shapes (n, nodes)."""
    mean = means[:, None]
    low, high = np.maximum((threshold - mean) / std, -_REACH), np.minimum((1 - mean) / std, _REACH)
    half = np.maximum((high - low) / 2, 0)  # none where all is clipped
    nodes = (low + high) / 2 + half * _NODES
    weights = half * _WEIGHTS * np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi)
    inside = np.clip(mean + std * nodes, threshold + 1e-15, 1 - 1e-15)
    places = np.hstack([np.full_like(mean, threshold), inside, np.ones_like(mean)])
    chances = np.hstack([special.ndtr((threshold - mean) / std), weights, special.ndtr(-(1 - mean) / std)])
    return places, chances


def clipped_sums(values: Array, low: float, high: float) -> Array:
    """Each number's (n,) part of the sums that the fit needs, shape (n, 5).

    Whether it is at the low end, at the high end and between; if between, its value and square, else 0.
    """
    at_low, at_high = values <= low, values >= high
    inside = ~(at_low | at_high)
    return np.column_stack([at_low, at_high, inside, inside * values, inside * values**2]) * 1.0


def fit_clipped(sums: Array, low: float, high: float) -> tuple[Array, Array]:
    """Mean and standard deviation of maximum likelihood, by expectation and maximisation (Dempster et al. (1977)).

    For each row of sums from `clipped_sums`, shape (rows, 5); results (rows,) are NaN where there are no numbers.
    """
    below, above, inside, first, second = sums.T
    number = below + above + inside
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (below * low + above * high + first) / number
        std = np.sqrt(np.maximum((below * low**2 + above * high**2 + second) / number - mean**2, 1e-12))
        for _ in range(_MOST_ROUNDS):
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
    """Mean and mean square of a standard normal number below (−1) or above (1) an edge, shapes of the edge."""
    away = side * edge
    hazard = _hazard(away)
    return side * hazard, 1 + away * hazard
