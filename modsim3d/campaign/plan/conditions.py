"""The conditions of a campaign: all combinations of its scenes and of the values of its factors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import prod
from typing import Any

from modsim3d.campaign.file.keys import Factor

TRACKER = "tracker"
MISS_RATE = "detector.miss_rate"
OF_DETECTOR = ("detector", "state", "from")
"""Keys of a condition that are no keys of the scene file: a detector file, a state, and where the state is from."""


@dataclass(frozen=True)
class Condition:
    """A scene with values of keys; each key belongs to the first layer that it changes.

    Attributes:
        scene: The scene file, or the name of a shipped scene.
        values: The values of the keys that are varied.
        fixed: The values of the keys that are the same in all conditions.
    """

    scene: str
    values: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def of_truth(self) -> dict[str, Any]:
        """The keys of the scene without its detector."""
        return self._of("truth")

    def of_detector(self) -> dict[str, Any]:
        """The keys of the detector, and `detector`, `state` and `from`."""
        return self._of("detections")

    def of_tracker(self) -> dict[str, Any]:
        """The settings of the tracker."""
        cut = len(TRACKER) + 1
        return {key[cut:]: value for key, value in self._of("tracks").items()}

    def with_values(self, values: Mapping[str, Any]) -> Condition:
        """The condition with more keys."""
        return replace(self, values={**self.values, **values})

    @property
    def all_values(self) -> dict[str, Any]:
        """The values of all keys."""
        return {**self.fixed, **self.values}

    def _of(self, layer: str) -> dict[str, Any]:
        return {key: value for key, value in self.all_values.items() if layer_of(key) == layer}


def layer_of(key: str) -> str:
    """The first layer that a key changes: `truth`, `detections` or `tracks`."""
    head = key.partition(".")[0]
    if head == TRACKER:
        return "tracks"
    return "detections" if head in OF_DETECTOR else "truth"


def conditions(scenes: Sequence[str], factors: Sequence[Factor], fixed: Mapping[str, Any]) -> list[Condition]:
    """All combinations, the last factor changing first."""
    levels = [list(_levels(factor)) for factor in factors]
    return [
        Condition(scene, {key: value for level in chosen for key, value in level.items()}, fixed)
        for scene in scenes
        for chosen in product(*levels)
    ]


def count_conditions(scenes: Sequence[str], factors: Sequence[Factor]) -> int:
    """How many combinations there are, without making them."""
    return len(scenes) * prod(_count(factor) for factor in factors)


def _count(factor: Factor) -> int:
    if factor.grid is not None:
        return prod(len(values) for values in factor.grid.values())
    if factor.pairs is not None:
        return len(next(iter(factor.pairs.values())))
    return 1 if factor.conditions is None else len(factor.conditions)


def _levels(factor: Factor) -> Iterator[dict[str, Any]]:
    """The values that a factor takes one after the other; one without any if they are drawn."""
    if factor.grid is not None:
        for values in product(*factor.grid.values()):
            yield dict(zip(factor.grid, values, strict=True))
    elif factor.pairs is not None:
        for values in zip(*factor.pairs.values(), strict=True):
            yield dict(zip(factor.pairs, values, strict=True))
    elif factor.conditions is not None:
        yield from factor.conditions
    else:
        yield {}
