"""The bounds that a verdict is held against: those of a campaign looked at once, or after every seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.campaign.verdicts.betting import betting_bounds
from modsim3d.campaign.verdicts.means import skewed_bounds
from modsim3d.campaign.verdicts.proportions import exact_bounds, mixture_bounds


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper bound, each one-sided at the confidence; infinite where there is none.

    Attributes:
        low: The lower bound.
        high: The upper bound.
    """

    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether there is one at all."""
        return math.isfinite(self.low) or math.isfinite(self.high)


UNKNOWN = Bounds(-math.inf, math.inf)


def share_bounds(right: Mask, confidence: float, stop: str) -> Bounds:
    """The bounds of the share of seeds that are right.

    Args:
        right: Which seeds are right, in the order of the plan, shape (n,).
        confidence: The confidence of each bound.
        stop: How often the campaign is looked at, as in its file.
    """
    alpha = 1 - confidence
    if stop == "once":
        return Bounds(*exact_bounds(int(right.sum()), len(right), alpha))
    return _consistent(lambda count: Bounds(*mixture_bounds(right[:count], alpha)), len(right))


def mean_bounds(worst: Array, best: Array, confidence: float, stop: str, limits: tuple[float, float]) -> Bounds:
    """The bounds of the mean of all seeds.

    Args:
        worst: A value for each seed, in the order of the plan, with the least possible value in place of each one that
            is lost; minus infinity if there is none; shape (n,).
        best: The same with the greatest possible value.
        confidence: The confidence of each bound.
        stop: How often the campaign is looked at, as in its file.
        limits: The least and the greatest possible value; both finite if the campaign is looked at more than once.
    """
    alpha, (least, greatest) = 1 - confidence, limits
    if stop == "once":
        return Bounds(_low(worst, alpha, limits), -_low(-best, alpha, (-greatest, -least)))

    def after(count: int) -> Bounds:
        low, _ = betting_bounds(_scaled(worst[:count], limits), alpha)
        _, high = betting_bounds(_scaled(best[:count], limits), alpha)
        return Bounds(least + low * (greatest - least), least + high * (greatest - least))

    return _consistent(after, len(worst))


def _low(values: Array, alpha: float, limits: tuple[float, float]) -> float:
    found = float(skewed_bounds(values, alpha, limits[1])) if np.all(np.isfinite(values)) else -math.inf
    return max(found, limits[0]) if math.isfinite(found) else found


def _scaled(values: Array, limits: tuple[float, float]) -> Array:
    least, greatest = limits
    scaled: Array = np.clip((values - least) / (greatest - least), 0, 1)
    return scaled


def _consistent(after: Callable[[int], Bounds], count: int) -> Bounds:
    """The bounds after all seeds, or after the most first ones whose bounds do not contradict each other.

    Bounds only move towards each other. If they ever cross, which has the probability of an error, nothing that comes
    later moves them.
    """
    found = after(count)
    if found.low <= found.high:
        return found
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        bounds = after(middle)
        low, high = (middle, high) if bounds.low <= bounds.high else (low, middle)
    return after(low)
