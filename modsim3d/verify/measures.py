"""Measured numbers: each knows its law under the asked value, its interval and the changes that it could notice.

This module has the protocol and the plain kinds; `rate_measures` has counts and shares, `law_measures` whole
distributions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from scipy import special

from modsim3d.verify.tails import skewed_quantile, skewed_tails, two_sided

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
        """How far off in standard errors, comparable between measures."""

    def interval(self, alpha: float) -> Interval:
        """Values that a test at level alpha would not have rejected."""

    def noticed(self, alpha: float) -> Noticed:
        """Smallest changes that a test at level alpha notices."""


@dataclass(frozen=True)
class Estimate:
    """A nearly normal number with a standard error.

    Attributes:
        error: Standard error of the test statistic if the asked value holds.
        count: Number of independent observations.
        statistic: Test statistic in standard errors; (measured − asked) / error if None.
        grows: Whether the standard error is in proportion to the value, as that of a standard deviation.
        possible: The least and the greatest value that there can be.
    """

    measured: float
    asked: float
    error: float
    count: float
    skewness: float = 0.0
    statistic: float | None = None
    grows: bool = False
    possible: Interval = ANY

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
        """How often it failed."""
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
