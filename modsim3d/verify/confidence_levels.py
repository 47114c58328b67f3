"""Between which probabilities of its law each confidence lies: equal, but for those at the ends of the range."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.confidence import NormalScores, QuantileScores

Levels = tuple[Array, Array]
"""Probability of a smaller confidence, and of one that is not larger, shapes (n,)."""


def _normal(law: NormalScores, values: Array, shift: Array) -> Levels | None:
    if law.std == 0:
        return None
    level = special.ndtr((values - law.mean - shift) / law.std)
    return level, level


def _quantiles(law: QuantileScores, values: Array, shift: Array) -> Levels | None:
    quantiles = law.quantiles
    share, steps = np.linspace(0, 1, len(quantiles)), np.flatnonzero(np.diff(quantiles) > 0)
    if not len(steps):
        return None
    last, first = np.append(steps, len(quantiles) - 1), np.append(0, steps + 1)
    return (
        np.interp(values - shift, quantiles[first], share[first]),
        np.interp(values - shift, quantiles[last], share[last]),
    )


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
