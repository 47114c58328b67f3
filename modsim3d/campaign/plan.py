"""The plan of a campaign: its runs, numbered, each with all that decides its row."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pyarrow as pa

from modsim3d.campaign.keys import MAX_DETECTOR_SEEDS, MAX_SEEDS, CampaignKeys, Factor, Range, Requirement, TrackerKeys
from modsim3d.core.arrays import Array
from modsim3d.core.text import UNKNOWN
from modsim3d.tracking.scores.breakdown import BINS

TRACKER = "tracker"
MISS_RATE = "detector.miss_rate"
OF_DETECTOR = ("detector", "state", "from")
"""Keys of a condition that are no keys of the scene file: a detector file, a state, and where the state is from."""


@dataclass(frozen=True)
class Condition:
    """A scene with values of keys; each key belongs to the first layer that it changes."""

    scene: str  # file, or name of a shipped scene
    values: Mapping[str, Any] = field(default_factory=dict)  # of the keys that are varied
    fixed: Mapping[str, Any] = field(default_factory=dict)  # of those that are the same in all conditions

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
    """Number of combinations, without making them."""
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


_HYPERCUBE, _UNIFORM = 1, 2


def drawn_values(factors: Sequence[Factor], base: int, index: int, count: int) -> dict[str, Any]:
    """Values of the keys drawn for the traffic seed `index`, from 0, of `count`; `base` is the campaign's seed."""
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
    return {key: value_at(span, float(share)) for (key, span), share in zip(ranges.items(), point, strict=True)}


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


def traffic_seed(base: int, index: int) -> int:
    """Seed of the scene of the repetition `index`, from 0: 1000000, 1000001, … for base 1."""
    return base * MAX_SEEDS + index


def detector_seed(traffic: int, index: int) -> int:
    """The detector seed `index`, from 0, of a traffic seed."""
    return traffic * MAX_DETECTOR_SEEDS + index


@dataclass(frozen=True)
class PlannedRun:
    """One run: a row of the results."""

    number: int  # place in the plan, from 0
    seed_index: int  # number of the traffic seed, from 0
    condition_index: int  # from 0
    condition: Condition  # with the values of all varied keys, drawn ones too
    traffic_seed: int  # of the scene
    detector_seed: int
    tracker: TrackerKeys


@dataclass(frozen=True)
class Plan:
    """All runs of a campaign in order: traffic seed, condition, detector seed, tracker, the last one changing first. So
    the first runs are a smaller campaign of the same kind, and all conditions, detectors and trackers meet the same
    seeds."""

    keys: CampaignKeys
    conditions: tuple[Condition, ...]  # all combinations of scenes and values that are not drawn

    @classmethod
    def of(cls, keys: CampaignKeys) -> Plan:
        """The plan of a campaign file."""
        return cls(keys, tuple(conditions(keys.scenes, keys.vary, keys.settings)))

    def __len__(self) -> int:
        """Number of runs."""
        return self.keys.seeds.traffic * self.runs_by_seed

    @property
    def runs_by_seed(self) -> int:
        """Number of runs with each traffic seed."""
        return len(self.conditions) * self.keys.seeds.detector * len(self.keys.trackers)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The keys that are varied, in the order of the file; `scene` first if there are several."""
        named: dict[str, None] = {"scene": None} if len(self.keys.scenes) > 1 else {}
        for condition in self.conditions:
            named |= dict.fromkeys(condition.values)
        for factor in self.keys.vary:
            named |= dict.fromkeys(factor.ranges)
        return tuple(named)

    @property
    def drawn(self) -> tuple[str, ...]:
        """The keys whose values are drawn for each traffic seed."""
        return tuple(key for factor in self.keys.vary for key in factor.ranges)

    def run(self, number: int) -> PlannedRun:
        """The run with a number."""
        return self.runs([number])[0]

    def runs(self, numbers: Sequence[int]) -> list[PlannedRun]:
        """The runs with some numbers."""
        keys, runs = self.keys, []
        # runs of a traffic seed follow each other
        drawn = cache(lambda index: drawn_values(keys.vary, keys.seed, index, keys.seeds.traffic))
        for number in numbers:
            rest, tracker = divmod(number, len(keys.trackers))
            rest, look = divmod(rest, keys.seeds.detector)
            seed_index, place = divmod(rest, len(self.conditions))
            condition = self.conditions[place].with_values(drawn(seed_index))
            traffic = traffic_seed(keys.seed, seed_index)
            seeds = traffic, detector_seed(traffic, look)
            runs.append(PlannedRun(number, seed_index, place, condition, *seeds, keys.trackers[tracker]))
        return runs


# ---- What a requirement is about ----

STATE, CAMERA, SCENE = "state", "camera", "scene"
GROUPS = (STATE, CAMERA, *BINS)  # what divides each run into parts that have scores of their own


@dataclass(frozen=True)
class RunPart:
    """A part of each run."""

    group: str  # what divides the runs, one of `GROUPS`
    name: str  # of a performance state, a camera, or a bin of the breakdown


@dataclass(frozen=True)
class Case:
    """A tracker in a condition: what a requirement is judged for."""

    tracker: int  # place in the file, from 0
    condition: int
    part: RunPart | None = None  # of the runs that counts; None: all of them
    minus: int | None = None  # place of the tracker whose score is taken off; None: of none

    @property
    def group(self) -> str:
        """The property that divides the runs; empty if all of them count."""
        return self.part.group if self.part else ""

    @property
    def within(self) -> str:
        """The part of the runs in words, such as ` in state haze`; empty if all of them count."""
        return f" in {self.part.group} {self.part.name}" if self.part else ""


def labels_of(plan: Plan, case: Case) -> list[str]:
    """Names in tables of the tracker of a case, and of the one whose score is taken off."""
    return [plan.keys.trackers[index].label for index in (case.tracker, case.minus) if index is not None]


def cases_of(plan: Plan, requirement: Requirement) -> list[Case]:
    """Cases of a requirement, by tracker, condition and part of the runs. Drawn keys neither select nor split."""
    wanted = wanted_of(requirement)
    labels = wanted.pop(TRACKER, None) if requirement.of is None else [requirement.of]
    named = [RunPart(key, str(name)) for key in groups_of(plan, requirement) for name in wanted.pop(key)]
    parts: list[RunPart | None] = [*dict.fromkeys(named)]
    chosen = [index for index, condition in enumerate(plan.conditions) if selects(wanted, condition)]
    trackers = [index for index, entry in enumerate(plan.keys.trackers) if labels is None or entry.label in labels]
    minus = next((index for index, entry in enumerate(plan.keys.trackers) if entry.label == requirement.minus), None)
    cases = ((tracker, condition) for tracker in trackers for condition in chosen)
    return [Case(*pair, part, minus) for pair in cases for part in parts or [None]]


def groups_of(plan: Plan, requirement: Requirement) -> list[str]:
    """The keys of `where` that name parts of the runs; a key that is varied selects conditions."""
    return [key for key in GROUPS if key in requirement.where and key not in plan.parameters]


def wanted_of(requirement: Requirement) -> dict[str, list[Any]]:
    """The values that each key of `where` may have, each once."""
    given = {key: value if isinstance(value, list) else [value] for key, value in requirement.where.items()}
    return {
        key: [value for place, value in enumerate(values) if not any(same(value, other) for other in values[:place])]
        for key, values in given.items()
    }


def selects(wanted: dict[str, list[Any]], condition: Condition) -> bool:
    """Whether a condition has one of the values of each key."""
    return all(any(same(value_of(condition, key), value) for value in values) for key, values in wanted.items())


def same(value: Any, wanted: Any) -> bool:
    """Whether two values of a key are equal: 1 and 1.0 are, 1 and true are not."""
    return bool(value == wanted) and isinstance(value, bool) == isinstance(wanted, bool)


def value_of(condition: Condition, key: str) -> Any:
    """The value that a condition has of a key, or the name of its scene; None if it has none."""
    return Path(condition.scene).stem if key == SCENE else condition.values.get(key)


def text_of(value: Any) -> str:
    """A value of a key as a table shows it."""
    return value if isinstance(value, str) else orjson.dumps(value).decode()


def value_text(value: Any) -> str:
    """A value of a key; numbers without zeros at their end, and a dash for none."""
    if value is None:
        return UNKNOWN
    return f"{value:g}" if are_numbers([value]) else text_of(value)


def are_numbers(values: Iterable[Any]) -> bool:
    """Whether all values of a key are numbers, which truth values are not."""
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def value_column(values: Sequence[Any], possible: Iterable[Any]) -> pa.Array:
    """A column of values of a key: numbers if all that are possible are numbers, else text."""
    if are_numbers(possible):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else text_of(value) for value in values], pa.string())


def values_text(values: Mapping[str, Any], keys: Iterable[str] | None = None) -> str:
    """Values of some keys, or of all, in words; a dash if there are none."""
    wanted = values if keys is None else keys
    parts = [f"{key} {value_text(values[key])}" for key in wanted if values.get(key) is not None]
    return ", ".join(parts) or UNKNOWN


MAX_KEYS = 4  # keys that have columns of their own in a table


def key_columns(keys: Sequence[str]) -> list[str]:
    """Names of the columns for some keys: one for all if there are many."""
    return list(keys) if len(keys) <= MAX_KEYS else ["condition"]


def value_cells(values: Mapping[str, Any], keys: Sequence[str]) -> list[str]:
    """The values of some keys as cells under `key_columns`."""
    return [value_text(values.get(key)) for key in keys] if len(keys) <= MAX_KEYS else [values_text(values, keys)]
