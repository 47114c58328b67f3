"""Measured numbers: each knows its law under the asked value, its interval and the changes that it could notice. This
module has the protocol, the plain kinds, and counts and shares; `parameters` has whole distributions."""

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from scipy import optimize, special

from modsim3d.core.statistics import exact_bounds

MIN_SKEW = 1e-3  # below this a distribution is taken for normal
RARE_SKEW = 1.0  # above this a statistic counts events of which less than one is expected


def binomial_tails(count: float, trials: float, rate: float) -> tuple[float, float]:
    """Pr(X ≤ count) and Pr(X ≥ count); counts need not be whole, as effective counts are not."""
    below = 1.0 if count >= trials else float(special.betainc(trials - count, count + 1, 1 - rate))
    above = 1.0 if count <= 0 else float(special.betainc(count, trials - count + 1, rate))
    return below, above


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
    Poisson number with mean 1 / skewness²; of rare events it is the law, and that none happens is nothing unusual."""
    if abs(skewness) < MIN_SKEW:
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
    if abs(skewness) < MIN_SKEW:
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


POWER = 0.9
Interval = tuple[float, float]
Noticed = tuple[float | None, float | None]
"""Smallest change below and above the asked value that a test notices with probability `POWER`; None if none is."""


SHARE, CORRELATION, AMOUNT, ANY = (0.0, 1.0), (-1.0, 1.0), (0.0, math.inf), (-math.inf, math.inf)
"""The least and the greatest value of a probability, a correlation, a number without a sign, and any number."""


class Measure(Protocol):
    """One number of a run, compared with the one that was asked for."""

    @property
    def asked(self) -> float:
        """The value in the detector file."""

    @property
    def measured(self) -> float:
        """The value in the run."""

    @property
    def count(self) -> float:
        """Independent observations that it rests on."""

    def p_value(self) -> float:
        """Probability of a number at least as far off as this one, if the run obeys its file."""

    def strength(self) -> float:
        """Distance from the asked value in standard errors, comparable between measures."""

    def interval(self, alpha: float) -> Interval:
        """Values that a test at level alpha would not have rejected."""

    def noticed(self, alpha: float) -> Noticed:
        """Smallest changes that a test at level alpha notices."""


@dataclass(frozen=True)
class Estimate:
    """A nearly normal number with a standard error."""

    measured: float
    asked: float
    error: float  # standard error of the test statistic if the asked value holds
    count: float  # number of independent observations
    skewness: float = 0.0
    statistic: float | None = None  # in standard errors; (measured − asked) / error if None
    grows: bool = False  # whether the standard error is in proportion to the value, as that of a standard deviation
    possible: Interval = ANY  # the least and the greatest value that there can be

    @property
    def z(self) -> float:
        """The statistic."""
        return (self.measured - self.asked) / self.error if self.statistic is None else self.statistic

    def p_value(self) -> float:
        """From the tails of a skewed normal statistic."""
        return two_sided(*skewed_tails(self.z, self.skewness))

    def strength(self) -> float:
        """The statistic, without its sign."""
        return abs(self.z)

    def interval(self, alpha: float) -> Interval:
        """Excludes the asked value exactly where the test fails; infinite where it cannot fail."""
        upper = skewed_quantile(alpha / 2, self.skewness)
        lower = skewed_quantile(alpha / 2, -self.skewness)
        centre = self.asked + self.z * self.error
        return centre - upper * self.error, centre + lower * self.error

    def noticed(self, alpha: float) -> Noticed:
        """The critical value and as much again as the power needs."""
        reach = float(special.ndtri(POWER))
        below = (skewed_quantile(alpha / 2, -self.skewness) + reach) * self.error
        above = (skewed_quantile(alpha / 2, self.skewness) + reach) * self.error
        if self.grows and self.asked > 0:
            critical = above - reach * self.error
            for _ in range(20):
                above = min(critical + reach * self.error * (1 + above / self.asked) ** 2, 10 * self.asked)
        return below if math.isfinite(below) else None, above if math.isfinite(above) else None


@dataclass(frozen=True)
class Exact:
    """A rule that must never fail: how often it did, of how many times."""

    wrong: int
    count: float
    asked: float = 0.0

    @property
    def measured(self) -> float:
        """Number of failures."""
        return float(self.wrong)

    def p_value(self) -> float:
        """Zero if it failed once."""
        return 0.0 if self.wrong else 1.0

    def strength(self) -> float:
        """Beyond every other measure if it failed."""
        return math.inf if self.wrong else 0.0

    def interval(self, alpha: float) -> Interval:
        """The number itself: there is no chance in it."""
        return self.measured, self.measured

    def noticed(self, alpha: float) -> Noticed:
        """A single failure; nothing where nothing was seen."""
        return None, 1.0 if self.count else None


def _deviance(observed: float, expected: float) -> float:
    return 0.0 if observed <= 0 else observed * math.log(observed / max(expected, 1e-300))


@dataclass(frozen=True)
class Rate:
    """A share of trials; `inflation` is the variance of the number of successes over that of independent trials."""

    successes: float
    trials: float
    asked: float
    inflation: float = 1.0

    @property
    def measured(self) -> float:
        """Share of successes."""
        return self.successes / self.trials

    @property
    def count(self) -> float:
        """Independent trials that are worth as much."""
        return self.trials / self.inflation

    def _effective(self) -> tuple[float, float]:
        return self.successes / self.inflation, self.trials / self.inflation

    def p_value(self) -> float:
        """From the binomial tails."""
        if self.asked in (0.0, 1.0):
            return 1.0 if self.measured == self.asked else 0.0
        return two_sided(*binomial_tails(*self._effective(), self.asked))

    def strength(self) -> float:
        """Root of the deviance."""
        hits, trials = self._effective()
        gain = _deviance(hits, trials * self.asked) + _deviance(trials - hits, trials * (1 - self.asked))
        return math.sqrt(max(2 * gain, 0.0))

    def interval(self, alpha: float) -> Interval:
        """Clopper & Pearson's."""
        return exact_bounds(*self._effective(), alpha / 2)

    def noticed(self, alpha: float) -> Noticed:
        """From the least number of successes that is too many, and the greatest that is too few."""
        trials = math.floor(self.count)
        many = _first(trials, lambda k: binomial_tails(k, trials, self.asked)[1] <= alpha / 2)
        few = _first(trials, lambda k: binomial_tails(trials - k, trials, self.asked)[0] <= alpha / 2)
        above = None if many is None else float(special.betaincinv(many, trials - many + 1, POWER)) - self.asked
        below = None if few is None else self.asked - (1 - float(special.betaincinv(few, trials - few + 1, POWER)))
        return below, above


def _first(last: int, holds: Callable[[int], bool]) -> int | None:
    """Least k ≤ last for which a condition holds that stays true from there on."""
    place = bisect.bisect_left(range(last + 1), True, key=holds)
    return place if place <= last else None


@dataclass(frozen=True)
class DiscoveryRate:
    """False positives over all detections, where their number is Poisson given the true ones. Expected are n·r /
    (1 − r) false positives at a rate r with n true detections. `inflation` is the variance of their number over that of
    a Poisson number."""

    false: float
    true: float
    expected: float
    inflation: float = 1.0

    def _share(self, false: float) -> float:
        return false / (false + self.true) if false + self.true > 0 else 0.0

    @property
    def asked(self) -> float:
        """The share expected."""
        return self._share(self.expected)

    @property
    def measured(self) -> float:
        """The share found."""
        return self._share(self.false)

    @property
    def count(self) -> float:
        """Detections that are worth as much."""
        return (self.false + self.true) / self.inflation

    def p_value(self) -> float:
        """From the Poisson tails."""
        if self.expected == 0:
            return 1.0 if self.false == 0 else 0.0
        return two_sided(*poisson_tails(self.false / self.inflation, self.expected / self.inflation))

    def strength(self) -> float:
        """Root of the deviance."""
        false, expected = self.false / self.inflation, self.expected / self.inflation
        return math.sqrt(max(2 * (_deviance(false, expected) - false + expected), 0.0))

    def interval(self, alpha: float) -> Interval:
        """Garwood's, as a share."""
        low, high = poisson_interval(self.false / self.inflation, alpha)
        return self._share(low * self.inflation), self._share(high * self.inflation)

    def noticed(self, alpha: float) -> Noticed:
        """From the least number that is too many, and the greatest that is too few."""
        mean = self.expected / self.inflation
        most = math.ceil(mean + 60 * math.sqrt(mean) + 200)
        many = _first(most, lambda k: poisson_tails(k, mean)[1] <= alpha / 2)
        above = below = None
        if many is not None:
            above = self._share(float(special.gammaincinv(many, POWER)) * self.inflation) - self.asked
        whole = math.ceil(mean)
        few = _first(whole, lambda k: poisson_tails(whole - k, mean)[0] <= alpha / 2)
        if few is not None:
            below = self.asked - self._share(float(special.gammainccinv(whole - few + 1, POWER)) * self.inflation)
        return below, above


@dataclass(frozen=True)
class ImageRate:
    """False positives for each image, a Poisson number with its variance times `inflation`."""

    false: float
    images: float
    asked: float
    inflation: float = 1.0

    @property
    def measured(self) -> float:
        """The rate found."""
        return self.false / self.images

    @property
    def count(self) -> float:
        """Images that are worth as much."""
        return self.images / self.inflation

    def _as_share(self) -> DiscoveryRate:
        """Rate as a share of itself and of as many true detections as there are images."""
        return DiscoveryRate(self.false, self.images, self.asked * self.images, self.inflation)

    def p_value(self) -> float:
        """From the Poisson tails."""
        return self._as_share().p_value()

    def strength(self) -> float:
        """Root of the deviance."""
        return self._as_share().strength()

    def interval(self, alpha: float) -> Interval:
        """Garwood's."""
        low, high = self._as_share().interval(alpha)
        return low / (1 - low), high / (1 - high)

    def noticed(self, alpha: float) -> Noticed:
        """From the share's."""
        share = self._as_share()
        below, above = share.noticed(alpha)
        if below is not None:
            less = share.asked - below
            below = self.asked - less / (1 - less)
        if above is not None:
            more = share.asked + above
            above = more / (1 - more) - self.asked
        return below, above
