"""Values of keys that are drawn from ranges, a point for each traffic seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.campaign.file.keys import Factor, Range

_HYPERCUBE, _UNIFORM = 1, 2


def drawn_values(factors: Sequence[Factor], base: int, index: int, count: int) -> dict[str, Any]:
    """The values that the traffic seed `index` of `count` gets.

    Args:
        factors: The factors of the campaign; those that are not drawn give nothing.
        base: Seed of the campaign.
        index: Number of the traffic seed, from 0.
        count: Number of traffic seeds.
    """
    values: dict[str, Any] = {}
    for place, factor in enumerate(factors):
        if factor.latin_hypercube is not None:
            point = _hypercube(len(factor.latin_hypercube), count, base, place)[index]
            values |= at(factor.latin_hypercube, point)
        elif factor.uniform is not None:
            rng = np.random.default_rng([_UNIFORM, base, place, index])
            values |= at(factor.uniform, rng.random(len(factor.uniform)))
    return values


def at(ranges: Mapping[str, Range], point: Array) -> dict[str, Any]:
    """The values at a point of the unit cube, shape (number of ranges,)."""
    return {key: value_at(each, float(share)) for (key, each), share in zip(ranges.items(), point, strict=True)}


def value_at(values: Range, share: float) -> Any:
    """The value below which a share, in [0, 1), of a range lies."""
    if values.choices is not None:
        return values.choices[int(share * len(values.choices))]
    assert values.low is not None and values.high is not None
    if values.whole:
        return int(values.low + np.floor(share * (values.high - values.low + 1)))
    if values.scale == "log":
        exponent = np.log10(values.low) + share * (np.log10(values.high) - np.log10(values.low))
        return float(f"{10**exponent:.12g}")  # without the last bits, which depend on the library
    return float(f"{values.low + share * (values.high - values.low):.12g}")


@lru_cache(maxsize=4)
def _hypercube(dimensions: int, count: int, base: int, place: int) -> Array:
    from scipy.stats import qmc  # slow to import, and few campaigns need it

    rng = np.random.default_rng([_HYPERCUBE, base, place])
    points: Array = qmc.LatinHypercube(d=dimensions, rng=rng).random(count)
    return points
