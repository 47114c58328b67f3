"""Measured shares and rates: binomial and Poisson numbers, correlated ones counted for fewer."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass

from scipy import special

from modsim3d.verify.measures import POWER, Interval, Noticed
from modsim3d.verify.tails import binomial_interval, binomial_tails, poisson_interval, poisson_tails, two_sided


def _deviance(observed: float, expected: float) -> float:
    return 0.0 if observed <= 0 else observed * math.log(observed / max(expected, 1e-300))


@dataclass(frozen=True)
class Rate:
    """A share of trials; correlated trials count for fewer.

    `inflation` is the variance of the number of successes over that of independent trials.
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
        below = None if few is None else self.asked - (1 - float(special.betaincinv(few, trials - few + 1, POWER)))
        return below, above


def _first(last: int, holds: Callable[[int], bool]) -> int | None:
    """Least k ≤ last for which a condition holds that stays true from there on."""
    place = bisect.bisect_left(range(last + 1), True, key=holds)
    return place if place <= last else None


@dataclass(frozen=True)
class DiscoveryRate:
    """False positives over all detections, where their number is Poisson given the true ones.

    Expected are n·r / (1 − r) false positives at a rate r with n true detections. `inflation` is the variance of their
    number over that of a Poisson number.
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
