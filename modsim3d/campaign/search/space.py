"""The space that is searched: a dimension for each key, and one for the traffic seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from modsim3d.campaign.file.keys import Range, SearchKeys

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution

SEED = "traffic seed"
"""Name of the dimension of the traffic seed; no key of a scene has a space in it."""


@dataclass(frozen=True)
class Point:
    """A point of the space that is searched.

    Attributes:
        seed_index: Number of the traffic seed, from 0.
        places: For each key its number, or the index of its choice.
    """

    seed_index: int
    places: Mapping[str, float | int]

    def values(self, ranges: Mapping[str, Range]) -> dict[str, Any]:
        """The values of the keys."""
        return {key: _value(each, self.places[key]) for key, each in ranges.items()}


def distributions(search: SearchKeys) -> dict[str, BaseDistribution]:
    """The dimensions as Optuna knows them.

    Traffic seeds are categories: two seeds with neighbouring numbers have no more in common than any others.
    """
    from optuna.distributions import CategoricalDistribution

    found = {key: _distribution(each) for key, each in search.over.items()}
    return {**found, SEED: CategoricalDistribution(range(search.seeds))} if search.seeds > 1 else found


def point_of(parameters: Mapping[str, Any], search: SearchKeys) -> Point:
    """The point that Optuna proposes, without the last digits, which depend on the processor.

    Args:
        parameters: Its values of the dimensions.
        search: The search.
    """
    places = {key: _rounded(each, parameters[key]) for key, each in search.over.items()}
    return Point(int(parameters.get(SEED, 0)), places)


def parameters_of(point: Point, search: SearchKeys) -> dict[str, Any]:
    """The point as Optuna knows it."""
    return {**point.places, SEED: point.seed_index} if search.seeds > 1 else dict(point.places)


def _distribution(values: Range) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if values.choices is not None:
        return CategoricalDistribution(range(len(values.choices)))
    assert values.low is not None and values.high is not None
    log = values.scale == "log"
    if values.whole:
        return IntDistribution(int(values.low), int(values.high), log=log)
    return FloatDistribution(values.low, values.high, log=log)


def _rounded(values: Range, place: float | int) -> float | int:
    if values.choices is not None or values.whole:
        return int(place)
    assert values.low is not None and values.high is not None
    return min(max(float(f"{place:.12g}"), float(values.low)), float(values.high))


def _value(values: Range, place: float | int) -> Any:
    return place if values.choices is None else values.choices[int(place)]
