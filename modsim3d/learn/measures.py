"""Kinds of measured numbers: each knows its law under the asked value, its interval and what it could have noticed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import special
from scipy.stats import kstwo

from modsim3d.detector.records import Array
from modsim3d.learn.tails import (
    binomial_interval,
    binomial_tails,
    poisson_interval,
    poisson_tails,
    skewed_quantile,
    skewed_tails,
    two_sided,
)

POWER = 0.9
Interval = tuple[float, float]
Noticed = tuple[float | None, float | None]
"""Smallest change below and above the asked value that a test notices with probability `POWER`; None if none is."""


class Measure(Protocol):
    """One number of a run, held against the one that was asked for."""

    @property
    def asked(self) -> float:
        """What the detector file says."""

    @property
    def measured(self) -> float:
        """What the run shows."""

    @property
    def count(self) -> float:
        """Independent observations that it rests on."""

    def p_value(self) -> float:
        """Chance of a number as far off as this one or farther, if the run obeys its file."""

    def strength(self) -> float:
        """How far off in standard errors, comparable between measures."""

    def interval(self, alpha: float) -> Interval:
        """Values that a test at level alpha would not have rejected."""

    def noticed(self, alpha: float) -> Noticed:
        """Smallest changes that a test at level alpha notices."""


def _deviance(observed: float, expected: float) -> float:
    return 0.0 if observed <= 0 else observed * math.log(observed / max(expected, 1e-300))


@dataclass(frozen=True)
class Rate:
    """A share of trials; correlated trials count for fewer.

    Attributes:
        successes: How many.
        trials: Of how many.
        asked: The probability asked for.
        inflation: Variance of the number of successes over that of independent trials.
    """

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
        return binomial_interval(*self._effective(), alpha)

    def noticed(self, alpha: float) -> Noticed:
        """From the least number of successes that is too many, and the greatest that is too few."""
        trials = math.floor(self.count)
        many = _first(trials, lambda k: binomial_tails(k, trials, self.asked)[1] <= alpha / 2)
        few = _first(trials, lambda k: binomial_tails(trials - k, trials, self.asked)[0] <= alpha / 2)
        above = None if many is None else float(special.betaincinv(many, trials - many + 1, POWER)) - self.asked
        below = None
        if few is not None:
            least = trials - few
            below = self.asked - (1 - float(special.betaincinv(trials - least, least + 1, POWER)))
        return below, above


def _first(last: int, holds) -> int | None:  # type: ignore[no-untyped-def]
    """Least k ≤ last for which a condition holds that stays true once it is; by halving."""
    if not holds(last):
        return None
    low, high = 0, last
    while low < high:
        middle = (low + high) // 2
        if holds(middle):
            high = middle
        else:
            low = middle + 1
    return high


@dataclass(frozen=True)
class DiscoveryRate:
    """False positives over all detections, where their number is Poisson given the true ones.

    Attributes:
        false: Number of false positives.
        true: Number of true detections.
        expected: False positives expected; of the asked rate r with n true detections n·r / (1 − r).
        inflation: Variance of the number over that of a Poisson number.
    """

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
        above = None
        if many is not None:
            above = self._share(float(special.gammaincinv(many, POWER)) * self.inflation) - self.asked
        whole = math.ceil(mean)
        few = _first(whole, lambda k: poisson_tails(whole - k, mean)[0] <= alpha / 2)
        below = None
        if few is not None:
            mean_below = float(special.gammainccinv(whole - few + 1, POWER))
            below = self.asked - self._share(mean_below * self.inflation)
        return below, above


@dataclass(frozen=True)
class ImageRate:
    """False positives for each image, a Poisson number.

    Attributes:
        false: Number of false positives.
        images: In how many images.
        asked: The rate asked for.
        inflation: Variance of the number over that of a Poisson number.
    """

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
        """The same number as a share of itself and of as many true ones as there are images."""
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
        less = None if below is None else share.asked - below
        more = None if above is None else share.asked + above
        return (
            None if less is None else self.asked - less / (1 - less),
            None if more is None else more / (1 - more) - self.asked,
        )


@dataclass(frozen=True)
class Estimate:
    """A number with a standard error, nearly normal.

    Attributes:
        measured: The estimate.
        asked: The value asked for.
        error: Standard error of the test statistic if the asked value holds.
        count: Observations.
        skewness: Of the statistic.
        statistic: Of the test, in standard errors; (measured − asked) / error if None.
        grows: Whether the standard error is in proportion to the value, as that of a standard deviation.
    """

    measured: float
    asked: float
    error: float
    count: float
    skewness: float = 0.0
    statistic: float | None = None
    grows: bool = False

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
        """Such that the asked value is outside just where the test fails."""
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
        return below, above


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Share of the frames that a state takes, against the law of a Markov chain.

    Attributes:
        found: Number of frames.
        law: Probability of each number from 0 on, shape (frames + 1,).
    """

    found: int
    law: Array

    @property
    def asked(self) -> float:
        """Expected share."""
        return float(np.arange(len(self.law)) @ self.law) / self._frames

    @property
    def measured(self) -> float:
        """Share found."""
        return self.found / self._frames

    @property
    def _frames(self) -> int:
        return max(len(self.law) - 1, 1)

    @property
    def _deviation(self) -> float:
        counts = np.arange(len(self.law))
        return math.sqrt(max(float(((counts / self._frames - self.asked) ** 2) @ self.law), 0.0))

    @property
    def count(self) -> float:
        """Independent frames that are worth as much."""
        variance = self._deviation**2
        return self.asked * (1 - self.asked) / variance if variance > 0 else float(self._frames)

    def p_value(self) -> float:
        """From the law itself."""
        return two_sided(float(self.law[: self.found + 1].sum()), float(self.law[self.found :].sum()))

    def strength(self) -> float:
        """In standard deviations of the law."""
        return abs(self.measured - self.asked) / self._deviation if self._deviation > 0 else 0.0

    def interval(self, alpha: float) -> Interval:
        """The share found, and as far to each side as the law may reach to the other."""
        cumulative = np.cumsum(self.law)
        low = int(np.searchsorted(cumulative, alpha / 2)) / self._frames
        high = int(np.searchsorted(cumulative, 1 - alpha / 2)) / self._frames
        return max(self.measured + self.asked - high, 0.0), min(self.measured + self.asked - low, 1.0)

    def noticed(self, alpha: float) -> Noticed:
        """None: it follows from the transitions, which notice more."""
        return None, None


@dataclass(frozen=True)
class Law:
    """Greatest distance between an empirical distribution function and the one asked for (Kolmogorov (1933)).

    Attributes:
        measured: The distance.
        count: Numbers.
        asked: None.
    """

    measured: float
    count: float
    asked: float = 0.0

    @classmethod
    def of(cls, values: Array, quantiles: Array) -> Law:
        """Against a law that is straight between evenly spaced quantiles; where it has steps the test is cautious."""
        share = np.linspace(0, 1, len(quantiles))
        ordered = np.sort(values)
        below = np.interp(ordered, *_last(quantiles, share))
        above = np.interp(ordered, *_first_of(quantiles, share))
        rank = np.arange(len(ordered))
        # A step of the law takes in every rank within it.
        high = np.searchsorted(ordered, ordered, side="right") / len(ordered) - below
        low = above - np.searchsorted(ordered, ordered, side="left") / len(ordered)
        return cls(float(max(high.max(initial=0), low.max(initial=0), 0.0)), len(rank))

    def p_value(self) -> float:
        """Of the two-sided test."""
        return float(kstwo.sf(self.measured, int(self.count)))

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def interval(self, alpha: float) -> Interval:
        """Distances that are no farther from this one than chance may bring it."""
        reach = float(kstwo.isf(alpha, int(self.count)))
        return max(self.measured - reach, 0.0), min(self.measured + reach, 1.0)

    def noticed(self, alpha: float) -> Noticed:
        """A distance that the test does not miss: what chance may bring, from both sides."""
        return None, float(kstwo.isf(alpha, int(self.count)) + kstwo.isf(1 - POWER, int(self.count)))


def _last(values: Array, share: Array) -> tuple[Array, Array]:
    """Distribution function from above: at equal values the last."""
    place = np.append(np.flatnonzero(np.diff(values) > 0), len(values) - 1)
    return values[place], share[place]


def _first_of(values: Array, share: Array) -> tuple[Array, Array]:
    """Distribution function from below: at equal values the first."""
    place = np.append(0, np.flatnonzero(np.diff(values) > 0) + 1)
    return values[place], share[place]


@dataclass(frozen=True)
class Exact:
    """Something that may never fail.

    Attributes:
        wrong: How often it did.
        count: Of how often.
    """

    wrong: int
    count: float
    asked: float = 0.0

    @property
    def measured(self) -> float:
        """How often it failed."""
        return float(self.wrong)

    def p_value(self) -> float:
        """Zero if it failed once."""
        return 0.0 if self.wrong else 1.0

    def strength(self) -> float:
        """Beyond every other measure if it failed."""
        return math.inf if self.wrong else 0.0

    def interval(self, alpha: float) -> Interval:
        """No doubt about it."""
        return self.measured, self.measured

    def noticed(self, alpha: float) -> Noticed:
        """A single failure."""
        return None, 1.0
