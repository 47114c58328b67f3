"""Between which probabilities of its law each confidence lies: equal, but for those at the ends of the range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.confidence import NormalScores, QuantileScores

Levels = tuple[Array, Array]
"""Probability of a smaller confidence, and of one that is not larger, shapes (n,)."""

_ROUNDING = 1e-9
"""A value less its shift may miss a step of its law by rounding."""


def _normal(law: NormalScores, values: Array, shift: Array) -> Levels | None:
    if law.std == 0:
        return None
    level = special.ndtr((values - law.mean - shift) / law.std)
    return level, level


def _quantiles(law: QuantileScores, values: Array, shift: Array) -> Levels | None:
    if not np.ptp(law.quantiles):
        return None
    before = values - shift
    return _level(law.quantiles, before - _ROUNDING, "left"), _level(law.quantiles, before + _ROUNDING, "right")


def _level(quantiles: Array, values: Array, side: Literal["left", "right"]) -> Array:
    """Probability of less than each value, or with `right` of no more, under a law straight between quantiles."""
    count = np.searchsorted(quantiles, values, side=side)
    above = np.clip(count, 1, len(quantiles) - 1)
    step = np.diff(quantiles)[above - 1]
    part = (values - quantiles[above - 1]) / np.where(step > 0, step, 1)
    between = (above - 1 + part) / (len(quantiles) - 1)
    level: Array = np.where(count == 0, 0.0, np.where(count == len(quantiles), 1.0, between))
    return level


LEVELS: Mapping[str, Callable[..., Levels | None]] = {"normal": _normal, "quantiles": _quantiles}
"""The levels of values before clipping whose law is shifted, by the name of the distribution; None if it is a point."""


def drawn_levels(levels: Levels, confidence: Array, threshold: float, rng: np.random.Generator) -> Array:
    """One level for each confidence, uniform if they follow their law, shape (n,).

    Where several levels give one confidence, as at both ends of the range, one of them is drawn.
    """
    low = np.where(confidence <= threshold, 0.0, levels[0])
    high = np.where(confidence >= 1, 1.0, levels[1])
    drawn: Array = low + rng.random(len(low)) * (high - low)
    return drawn
