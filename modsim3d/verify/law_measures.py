"""Measured numbers compared with a whole distribution: the share of a state, and the spread of values."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.stats import kstwo

from modsim3d.arrays import Array
from modsim3d.verify.measures import POWER, Interval, Noticed
from modsim3d.verify.tails import two_sided


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Share of the frames that a state takes, against the law of a Markov chain.

    `found` is the number of its frames, `law` the probability of each number from 0 on, shape (frames + 1,).
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
        """Nothing: the transitions, which this follows from, notice more."""
        return None, None


@dataclass(frozen=True)
class Law:
    """Greatest distance between an empirical distribution function and the one asked for (Kolmogorov (1933))."""

    measured: float
    count: float
    asked: float = 0.0

    @classmethod
    def of(cls, values: Array, quantiles: Array) -> Law:
        """The distance of values from a law that is straight between evenly spaced quantiles, shapes (n,) and (k,).

        Where the law has steps, the test is cautious.
        """
        share, steps = np.linspace(0, 1, len(quantiles)), np.flatnonzero(np.diff(quantiles) > 0)
        ordered = np.sort(values)
        # At equal quantiles the distribution function is the last share from above, and the first from below.
        last, first = np.append(steps, len(quantiles) - 1), np.append(0, steps + 1)
        below = np.interp(ordered, quantiles[last], share[last])
        above = np.interp(ordered, quantiles[first], share[first])
        # A step of the law takes in every rank within it.
        high = np.searchsorted(ordered, ordered, side="right") / len(ordered) - below
        low = above - np.searchsorted(ordered, ordered, side="left") / len(ordered)
        return cls(float(max(high.max(initial=0), low.max(initial=0), 0.0)), len(ordered))

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
        reach = float(kstwo.isf(alpha, int(self.count)) + kstwo.isf(1 - POWER, int(self.count)))
        return None, reach if reach <= 1 else None
