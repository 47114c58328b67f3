"""Bounds of a proportion: exact ones for a size fixed beforehand, and a sequence that holds at every size.

All bounds are one-sided: each is wrong with at most the probability `alpha`.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Mask
from modsim3d.campaign.verdicts.bisection import least_whole, lower_end

HALF = 0.5
"""Both parameters of the beta distribution that the sequence mixes over (Jeffreys' prior)."""
_HALVINGS = 52
"""As close to 1 as numbers are."""


def exact_bounds(right: int, seeds: int, alpha: float) -> tuple[float, float]:
    """The lower and the upper bound of Clopper & Pearson (1934) for a number of seeds that was fixed beforehand.

    Args:
        right: Number of seeds that are right.
        seeds: Number of all.
        alpha: The greatest probability of error, of each bound.
    """
    wrong = seeds - right
    low = float(special.betaincinv(right, wrong + 1, alpha)) if right else 0.0
    high = float(special.betainccinv(right + 1, wrong, alpha)) if wrong else 1.0
    return low, high


def clean_seeds_needed(share: float, confidence: float, failures: int = 0) -> int:
    """The least number of seeds, fixed beforehand, that shows a share if so many of them are wrong.

    For 0.99 at 0.95 it is 299 without failures and 473 with one.

    Args:
        share: The least share that must be right, in (0, 1).
        confidence: The confidence of the statement.
        failures: Number of seeds that are wrong.
    """
    return least_whole(lambda seeds: bool(special.bdtr(failures, seeds, 1 - share) <= 1 - confidence), failures + 1)


def mixture_log_capital(right: Mask, share: float) -> Array:
    """How strongly the seeds so far speak against a share being the true one, after each seed.

    The logarithm of a capital that starts at 1 and is a martingale if the share is the true one, so that it ever
    reaches 1/α with probability α at most (Ville's inequality). It is the likelihood of the seeds, mixed over all
    shares by a beta(1/2, 1/2) distribution, divided by their likelihood at this share (Robbins 1970).

    Args:
        right: Which seeds are right, in the order of the plan, shape (…, n).
        share: The share, in (0, 1).

    Returns:
        The logarithms, shape (…, n).
    """
    count = np.arange(1, right.shape[-1] + 1)
    good = np.cumsum(right, axis=-1)
    mixed = special.betaln(good + HALF, count - good + HALF) - special.betaln(HALF, HALF)
    likelihood = good * math.log(share) + (count - good) * math.log1p(-share)
    capital: Array = mixed - likelihood
    return capital


def mixture_bounds(right: Mask, alpha: float) -> tuple[float, float]:
    """The greatest lower bound and the least upper bound after any number of the seeds.

    Args:
        right: Which seeds are right, in the order of the plan, shape (n,).
        alpha: The greatest probability that an upper or a lower bound is ever wrong, of both together.
    """
    return _lower(right, alpha), 1 - _lower(~right, alpha)


def clean_seeds_needed_sequential(share: float, confidence: float) -> int:
    """The least number of seeds, all of them right, after which the sequence shows a share: 680 for 0.99 at 0.95."""

    def shown(seeds: int) -> bool:
        mixed = special.betaln(seeds + HALF, HALF) - special.betaln(HALF, HALF)
        return bool(mixed - seeds * math.log(share) >= -math.log1p(-confidence))

    return least_whole(shown, 1)


def _lower(right: Mask, alpha: float) -> float:
    """Every share that is below that of some first seeds and has a capital of 1/α there is excluded."""
    if not len(right):
        return 0.0
    found = np.cumsum(right) / np.arange(1, len(right) + 1)

    def excluded(share: float) -> bool:
        capital = mixture_log_capital(right, share)
        return bool(np.any((capital >= -math.log(alpha)) & (found > share)))

    return lower_end(excluded, _HALVINGS)
