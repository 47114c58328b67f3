"""Intervals and bounds of a mean, for a number of seeds that was fixed beforehand."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.statistics import exact_bounds, half_widths

SKEWNESS = 1.0  # the least skewness that values are taken to have: a few of them seldom show their tail
VARIATION = 1.5  # how much of h/d a half-width h gains of itself, if the values lack d to the best one
VARIATION_FROM_ZERO = 1.1  # of scores that are 0 at best; all three by `script/campaign sequences`


def skewed_bounds(values: Array, alpha: float, greatest: float = math.inf) -> Array:
    """Lower bounds of the means of rows of `values`, (…, n), see `corrected_bounds`."""
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
      from the same bad runs. For v = 1 and small h/d it is the correction for a skewness of three times the coefficient
      of variation of what values lack to the best one, which the inverse Gaussian distribution has; a gamma
      distribution has two, a Poisson distribution one.
    The rule was chosen, and how often it errs measured, by `script/campaign sequences`. Means and the others are of one
    shape, of `count` values each. Standard deviations are with n − 1; skewness is with n and mirrored: positive if
    values are skewed towards low ones. `alpha` is the probability of error that is aimed at, and `greatest` the
    greatest possible value."""
    mean, deviation = np.asarray(mean, dtype=np.float64), np.asarray(deviation, dtype=np.float64)
    half, lacks = half_widths(mean, deviation, count, alpha), greatest - mean
    skewness, variation = np.maximum(skewness, SKEWNESS), VARIATION if greatest else VARIATION_FROM_ZERO
    with np.errstate(divide="ignore", invalid="ignore"):
        error = half / deviation
        cubic = deviation * 3 / skewness * (1 - np.cbrt(1 - skewness * (error + skewness / (6 * count))))
        related = half * (1 + np.minimum(variation * half / lacks, 1))
    return np.where(np.isnan(half), -math.inf, mean - np.maximum(cubic, related))


def lower_end(excluded: Callable[[float], bool], halvings: int) -> float:
    """The greatest number in [0, 1) up to which all are excluded, 0 if none is; if one is excluded, so are all below
    it. It is rounded down by 2**-halvings at most."""
    low, high = 0.0, 1.0
    for _ in range(halvings):
        middle = (low + high) / 2
        if excluded(middle):
            low = middle
        else:
            high = middle
    return low


def least_whole(holds: Callable[[int], bool], first: int) -> int:
    """The least whole number, from the first on, for which a statement holds that then holds for all greater ones."""
    step = 1
    while not holds(first + step - 1):
        step *= 2
    low, high = first + step // 2 - 1, first + step - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


# ---- Bounds of a proportion ----

HALF = 0.5  # both parameters of the beta distribution that the sequence mixes over (Jeffreys' prior)
_HALVINGS = 52  # as close to 1 as numbers are


def clean_seeds(share: float, confidence: float, failures: int = 0) -> int:
    """The least number of seeds, fixed beforehand, that shows at a confidence that a share in (0, 1) is right, although
    `failures` of them are wrong. For 0.99 at 0.95 it is 299 without failures and 473 with one."""
    return least_whole(lambda seeds: bool(special.bdtr(failures, seeds, 1 - share) <= 1 - confidence), failures + 1)


def mixture_log_capital(right: Mask, share: float) -> Array:
    """Evidence of the seeds so far against a share in (0, 1) being the true one, after each seed, shape (…, n). `right`
    says which are right, in the order of the plan, shape (…, n). It is the logarithm of a capital that starts at 1 and
    is a martingale if the share is the true one, so that it ever reaches 1/α with probability α at most (Ville's
    inequality): the likelihood of the seeds, mixed over all shares by a beta(1/2, 1/2) distribution, divided by their
    likelihood at this share (Robbins 1970)."""
    count = np.arange(1, right.shape[-1] + 1)
    good = np.cumsum(right, axis=-1)
    mixed = special.betaln(good + HALF, count - good + HALF) - special.betaln(HALF, HALF)
    likelihood = good * math.log(share) + (count - good) * math.log1p(-share)
    capital: Array = mixed - likelihood
    return capital


def mixture_bounds(right: Mask, alpha: float) -> tuple[float, float]:
    """The greatest lower bound and the least upper bound after any number of the seeds; `right` says which are right,
    (n,) in the order of the plan. `alpha` is the greatest probability that either is ever wrong."""
    return _lower(right, alpha), 1 - _lower(~right, alpha)


def clean_seeds_sequential(share: float, confidence: float) -> int:
    """The least number of seeds, all of them right, after which the sequence shows a share: 680 for 0.99 at 0.95."""

    def shown(seeds: int) -> bool:
        mixed = special.betaln(seeds + HALF, HALF) - special.betaln(HALF, HALF)
        return bool(mixed - seeds * math.log(share) >= -math.log1p(-confidence))

    return least_whole(shown, 1)


def _lower(right: Mask, alpha: float) -> float:
    """Every share that is below that of some first seeds and has a capital of 1/α there is excluded."""
    if not len(right):
        return 0.0
    shares = np.cumsum(right) / np.arange(1, len(right) + 1)

    def excluded(share: float) -> bool:
        capital = mixture_log_capital(right, share)
        return bool(np.any((capital >= -math.log(alpha)) & (shares > share)))

    return lower_end(excluded, _HALVINGS)


# ---- A sequence of bounds of the mean of values between 0 and 1 ----

STAKES: Array = np.exp2(-0.5 * np.arange(21))  # shares of the capital lost if a value is 0, from all to a thousandth
_BETTING_HALVINGS = 30  # to a billionth
_WEIGHTS: Array = 1.0 / np.arange(1, len(STAKES) + 1)
_LOG_WEIGHTS: Array = np.log(_WEIGHTS / _WEIGHTS.sum())
"""How much of the capital is bet so at the start: most on high stakes, which win early if they win."""


def log_capital(values: Array, mean: float) -> Array:
    """Logarithm of the capital after each value, (…, n), of a gambler who bets that the values, in [0, 1] and in the
    order of the plan, are above a mean in (0, 1]."""
    stakes = STAKES.reshape(-1, *(1,) * values.ndim)
    with np.errstate(divide="ignore"):  # all is lost: minus infinity, and so it stays
        grown = np.cumsum(np.log1p(stakes * (values / mean - 1)), axis=-1)
    grown += _LOG_WEIGHTS.reshape(stakes.shape)
    most = grown.max(axis=0)
    capital: Array = most + np.log(np.exp(grown - most).sum(axis=0))  # as `logsumexp` of SciPy, which takes far longer
    return capital


def betting_bounds(values: Array, alpha: float) -> tuple[float, float]:
    """The greatest lower bound and the least upper bound of the mean after any number of the values, (n,) in [0, 1] in
    the order of the plan. `alpha` is the greatest probability that one of them is ever wrong."""
    return _lower_by_betting(values, alpha), 1 - _lower_by_betting(1 - values, alpha)


def perfect_seeds(mean: float, confidence: float) -> float:
    """The least number of values, all of them 1, that shows a mean; infinite for 1, which nothing can show."""
    if mean >= 1:
        return math.inf
    if mean <= 0:
        return 0
    grown = np.log1p(STAKES * (1 / mean - 1))
    return least_whole(
        lambda count: bool(special.logsumexp(count * grown + _LOG_WEIGHTS) >= -math.log1p(-confidence)), 1
    )


def _lower_by_betting(values: Array, alpha: float) -> float:
    if not len(values):
        return 0.0
    return lower_end(lambda mean: bool(np.max(log_capital(values, mean)) >= -math.log(alpha)), _BETTING_HALVINGS)


# ---- Bounds of the mean of shares ----

WHOLE = 0.8  # part of the probability of an error that is for the number of values that are 1


def mean_share_low(shares: Array, alpha: float) -> float:
    """Lower bound of the mean of values in [0, 1], (n,), looked at once, whatever their distribution. A mean is at
    least the probability of a 1, which has the bound of Clopper & Pearson (1934); where few are 1, betting on the
    values says more. Both share the probability of an error."""
    whole = exact_bounds(int((shares == 1).sum()), len(shares), WHOLE * alpha)[0]
    return max(whole, _lower_by_betting(shares, (1 - WHOLE) * alpha))


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper bound, each one-sided at the confidence; infinite where there is none."""

    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether there is one at all."""
        return math.isfinite(self.low) or math.isfinite(self.high)


UNKNOWN = Bounds(-math.inf, math.inf)


def share_bounds(right: Mask, confidence: float, stop: str) -> Bounds:
    """Bounds of the share of seeds that are right, each at the confidence. `right` says which are, (n,) in the order of
    the plan; `stop` is how often the campaign is looked at, as in its file."""
    alpha = 1 - confidence
    if stop == "once":
        return Bounds(*exact_bounds(int(right.sum()), len(right), alpha))
    return _consistent(lambda count: Bounds(*mixture_bounds(right[:count], alpha)), len(right))


def mean_bounds(worst: Array, best: Array, confidence: float, stop: str, limits: tuple[float, float]) -> Bounds:
    """Bounds of the mean of all seeds, each at the confidence. `worst` has a value for each seed, (n,) in the order of
    the plan, with the least possible value in place of each one that is lost, minus infinity if there is none; `best`
    has the greatest in its place. `limits` are the least and the greatest possible value; both finite if the campaign
    is looked at more than once; `stop` is as in its file."""
    alpha, (least, greatest) = 1 - confidence, limits
    if stop == "once":
        return Bounds(_low(worst, alpha, limits), -_low(-best, alpha, (-greatest, -least)))

    def after(count: int) -> Bounds:
        low, _ = betting_bounds(_scaled(worst[:count], limits), alpha)
        _, high = betting_bounds(_scaled(best[:count], limits), alpha)
        return Bounds(least + low * (greatest - least), least + high * (greatest - least))

    return _consistent(after, len(worst))


def _low(values: Array, alpha: float, limits: tuple[float, float]) -> float:
    bound = float(skewed_bounds(values, alpha, limits[1])) if np.all(np.isfinite(values)) else -math.inf
    return max(bound, limits[0]) if math.isfinite(bound) else bound


def _scaled(values: Array, limits: tuple[float, float]) -> Array:
    least, greatest = limits
    return np.clip((values - least) / (greatest - least), 0, 1)


def _consistent(after: Callable[[int], Bounds], count: int) -> Bounds:
    """Bounds after all seeds, or after the most first ones whose bounds do not contradict each other. If they ever
    cross, which has the probability of an error, nothing that comes later moves them."""
    limits = after(count)
    if limits.low <= limits.high:
        return limits
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        bounds = after(middle)
        low, high = (middle, high) if bounds.low <= bounds.high else (low, middle)
    return after(low)
