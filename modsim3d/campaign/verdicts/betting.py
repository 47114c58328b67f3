"""A sequence of bounds of the mean of values between 0 and 1 that holds after every number of them, by betting.

A gambler bets that the values are above m. If their mean is m or less, the capital is not expected to grow, so that it
ever reaches 1/α times its start with probability α at most (Ville's inequality): if it does, m is excluded
(Waudby-Smith & Ramdas 2024, sections 4 and 5). They bet a share of the capital that follows the variance so far, and
cut it off near ruin. Here the capital is divided among fixed shares instead, each bet throughout. That is as exact,
needs no tuning, excludes every number below one that is excluded, and decides sooner for most distributions
(docs/campaigns/sequences.md).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.campaign.verdicts.bisection import least_whole, lower_end

STAKES: Array = np.exp2(-0.5 * np.arange(21))
"""Shares of the capital that are lost if a value is 0, from all of it to a thousandth."""
_HALVINGS = 30
"""To a billionth."""
_WEIGHTS: Array = 1.0 / np.arange(1, len(STAKES) + 1)
_LOG_WEIGHTS: Array = np.log(_WEIGHTS / _WEIGHTS.sum())
"""How much of the capital is bet so at the start: most on high stakes, which win early if they win."""


def log_capital(values: Array, mean: float) -> Array:
    """The logarithm of the capital after each value, of a gambler who bets that the values are above a mean.

    Args:
        values: Values in [0, 1], in the order of the plan, shape (…, n).
        mean: The mean, in (0, 1].

    Returns:
        Shape (…, n).
    """
    stakes = STAKES.reshape(-1, *(1,) * values.ndim)
    with np.errstate(divide="ignore"):  # all is lost: minus infinity, and so it stays
        grown = np.cumsum(np.log1p(stakes * (values / mean - 1)), axis=-1)
    capital: Array = special.logsumexp(grown + _LOG_WEIGHTS.reshape(stakes.shape), axis=0)
    return capital


def betting_bounds(values: Array, alpha: float) -> tuple[float, float]:
    """The greatest lower bound and the least upper bound of the mean after any number of the values.

    Args:
        values: Values in [0, 1], in the order of the plan, shape (n,).
        alpha: The greatest probability that a lower bound is ever wrong; the same for an upper one.
    """
    return _lower(values, alpha), 1 - _lower(1 - values, alpha)


def perfect_seeds_needed(mean: float, confidence: float) -> float:
    """The least number of values, all of them 1, that shows a mean; infinite for 1, which nothing can show."""
    if mean >= 1:
        return math.inf
    if mean <= 0:
        return 0
    grown = np.log1p(STAKES * (1 / mean - 1))
    return least_whole(
        lambda count: bool(special.logsumexp(count * grown + _LOG_WEIGHTS) >= -math.log1p(-confidence)), 1
    )


def _lower(values: Array, alpha: float) -> float:
    if not len(values):
        return 0.0
    return lower_end(lambda mean: bool(np.max(log_capital(values, mean)) >= -math.log(alpha)), _HALVINGS)
