"""Measured patterns: the strongest of many correlations, and how far a sum strays on its way through a run."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy import special

from modsim3d.verify.measures import POWER, Estimate, Interval, Noticed


@dataclass(frozen=True)
class Strongest(Estimate):
    """The estimate that stands out most of `trials`, which share the level of the test (Bonferroni)."""

    trials: int = 1

    def p_value(self) -> float:
        """Of any of the trials."""
        return min(1.0, self.trials * super().p_value())

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def interval(self, alpha: float) -> Interval:
        """At this trial's share of the level."""
        return super().interval(alpha / self.trials)

    def noticed(self, alpha: float) -> Noticed:
        """At this trial's share of the level."""
        return super().noticed(alpha / self.trials)


@dataclass(frozen=True)
class Drift:
    """How far the sum of `count` numbers with mean zero and variance one strays from zero, for each of them.

    The numbers sum to zero in the end, so the sum is a Brownian bridge, and the greatest distance times √count follows
    Kolmogorov's distribution (Kolmogorov (1933)). Of `trials` such sums it is the one that strays most.
    """

    measured: float
    count: float
    trials: int = 1
    asked: float = 0.0

    def p_value(self) -> float:
        """Of any of the trials."""
        return min(1.0, self.trials * float(special.kolmogorov(math.sqrt(self.count) * self.measured)))

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def _reach(self, share: float) -> float:
        return float(special.kolmogi(share)) / math.sqrt(self.count)

    def interval(self, alpha: float) -> Interval:
        """Distances that are no farther from this one than chance may bring it."""
        reach = self._reach(alpha / self.trials)
        return max(self.measured - reach, 0.0), self.measured + reach

    def noticed(self, alpha: float) -> Noticed:
        """A distance that the test does not miss: what chance may bring, from both sides."""
        return None, self._reach(alpha / self.trials) + self._reach(1 - POWER)
