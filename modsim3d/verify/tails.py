"""Tail probabilities and their inverses: binomial and Poisson with real counts, and skewed normal statistics."""

from __future__ import annotations

import math

from scipy import optimize, special

LEAST_SKEW = 1e-3
"""Below this a distribution is taken for normal."""
RARE_SKEW = 1.0
"""Above this a statistic counts events of which less than one is expected."""


def binomial_tails(count: float, trials: float, rate: float) -> tuple[float, float]:
    """Pr(X ≤ count) and Pr(X ≥ count); counts need not be whole, as effective counts are not."""
    below = 1.0 if count >= trials else float(special.betainc(trials - count, count + 1, 1 - rate))
    above = 1.0 if count <= 0 else float(special.betainc(count, trials - count + 1, rate))
    return below, above


def binomial_interval(count: float, trials: float, alpha: float) -> tuple[float, float]:
    """Clopper & Pearson (1934): the rates that a two-sided test at level alpha would not reject."""
    low = 0.0 if count <= 0 else float(special.betaincinv(count, trials - count + 1, alpha / 2))
    high = 1.0 if count >= trials else float(special.betaincinv(count + 1, trials - count, 1 - alpha / 2))
    return low, high


def poisson_tails(count: float, mean: float) -> tuple[float, float]:
    """Pr(X ≤ count) and Pr(X ≥ count)."""
    below = float(special.gammaincc(count + 1, mean))
    above = 1.0 if count <= 0 else float(special.gammainc(count, mean))
    return below, above


def poisson_interval(count: float, alpha: float) -> tuple[float, float]:
    """Garwood (1936): the means that a two-sided test at level alpha would not reject."""
    low = 0.0 if count <= 0 else float(special.gammaincinv(count, alpha / 2))
    return low, float(special.gammainccinv(count + 1, alpha / 2))


def skewed_tails(z: float, skewness: float) -> tuple[float, float]:
    """Pr(Z ≤ z) and Pr(Z ≥ z) of a standardised sum with some skewness, by a shifted gamma or a Poisson distribution.

    Pearson's type III has the first three moments right; of a sample variance of normal numbers it is the law. So has a
    Poisson number with mean 1 / skewness²; of rare events it is the law, and that none happens is nothing unusual.
    """
    if abs(skewness) < LEAST_SKEW:
        return float(special.ndtr(z)), float(special.ndtr(-z))
    if skewness < 0:
        above, below = skewed_tails(-z, -skewness)
        return below, above
    if skewness > RARE_SKEW:
        mean = skewness**-2
        return poisson_tails(max(mean + z / skewness, 0.0), mean)
    shape = 4 / skewness**2
    place = max(shape + z * math.sqrt(shape), 0.0)
    return float(special.gammainc(shape, place)), float(special.gammaincc(shape, place))


def skewed_quantile(tail: float, skewness: float) -> float:
    """The z with Pr(Z ≥ z) = tail < 1/e; infinite where none is so rare: less than nothing cannot happen."""
    if abs(skewness) < LEAST_SKEW:
        return -float(special.ndtri(tail))
    if skewness < -RARE_SKEW:
        return math.inf
    if skewness > RARE_SKEW:
        mean = skewness**-2
        most = 10 * mean + 200
        count = optimize.brentq(lambda count: poisson_tails(count, mean)[1] - tail, 0.0, most, xtol=1e-12)
        return (float(count) - mean) * skewness
    shape = 4 / skewness**2
    if skewness < 0:
        return (shape - float(special.gammaincinv(shape, tail))) / math.sqrt(shape)
    return (float(special.gammainccinv(shape, tail)) - shape) / math.sqrt(shape)


def two_sided(below: float, above: float) -> float:
    """A two-sided p-value from both tails."""
    return min(1.0, 2 * min(below, above))
