"""The parameters that a campaign varies, and the levels at which scores are shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array, Indices
from modsim3d.campaign.file.keys import Range
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.done_rows import text_of

MOST_LEVELS = 12
"""Numbers of a grid that are shown one by one."""
BINS = 6
"""Stretches into which drawn numbers are put."""
DECADES = 1.5
"""From so many between the least and the greatest number on, an axis is logarithmic."""


@dataclass(frozen=True, eq=False)
class Parameter:
    """A key that is varied.

    Attributes:
        key: The key.
        levels: Names of the levels: values, or stretches of numbers.
        index: The level of each traffic seed and condition, −1 where the key is not set, shape (seeds, conditions).
        numbers: The numbers of each, NaN where the key is not set, shape (seeds, conditions); None if they are none.
        places: Numbers of the levels, shape (levels,); middles of stretches; None without numbers.
        binned: Whether levels are stretches.
        log: Whether numbers belong on a logarithmic axis.
    """

    key: str
    levels: tuple[str, ...]
    index: Indices
    numbers: Array | None = None
    places: Array | None = None
    binned: bool = False
    log: bool = False

    @cached_property
    def on_axis(self) -> Array:
        """Places of the levels on the axis of a chart, shape (levels,)."""
        assert self.places is not None
        return np.log10(self.places) if self.log else self.places


def parameters_of(plan: Plan, table: pa.Table) -> list[Parameter]:
    """The parameters with more than one value, in the order of the file.

    Args:
        plan: The plan.
        table: Rows of the campaign.
    """
    seed = table["run"].to_numpy() // plan.runs_by_seed
    seeds = int(seed.max()) + 1 if len(seed) else 0
    ranges = {key: each for factor in plan.keys.vary for key, each in factor.ranges.items()}
    there, first = np.unique(seed, return_index=True)
    found = []
    for key in plan.parameters:
        if key in ranges:
            drawn: list[Any] = [None] * seeds
            for place, value in zip(there.tolist(), table[key].take(first).to_pylist(), strict=True):
                drawn[place] = value
            found.append(_parameter(key, [[value] * len(plan.conditions) for value in drawn], ranges[key]))
        else:
            row = [_value(condition, key) for condition in plan.conditions]
            found.append(_parameter(key, [row], None, seeds))
    return [each for each in found if len(each.levels) > 1]


def _value(condition: Any, key: str) -> Any:
    return Path(condition.scene).stem if key == "scene" else condition.values.get(key)


def _parameter(key: str, values: Sequence[Sequence[Any]], span: Range | None, repeat: int = 1) -> Parameter:
    """A parameter of its values, a row for each seed; one row that holds for all is repeated."""
    flat = [value for row in values for value in row if value is not None]
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in flat)
    if not (numeric and flat):
        names = list(dict.fromkeys(map(text_of, flat)))
        places = {name: place for place, name in enumerate(names)}
        index = np.array(
            [[-1 if value is None else places[text_of(value)] for value in row] for row in values], dtype=np.int64
        )
        return Parameter(key, tuple(names), np.repeat(index, repeat, axis=0))
    numbers = np.array([[np.nan if value is None else float(value) for value in row] for row in values])
    known = np.unique(numbers[np.isfinite(numbers)])
    log = bool(known[0] > 0 and np.log10(known[-1] / known[0]) >= DECADES) if span is None else span.scale == "log"
    if len(known) <= MOST_LEVELS:
        index = np.where(np.isfinite(numbers), np.searchsorted(known, numbers), -1)
        names = [f"{value:g}" for value in known]
        places_of = known
    else:
        index, names, places_of = _binned(numbers, known, log)
    numbers, index = (np.repeat(each, repeat, axis=0) for each in (numbers, index))
    return Parameter(key, tuple(names), index, numbers, places_of, len(known) > MOST_LEVELS, log)


def _binned(numbers: Array, known: Array, log: bool) -> tuple[Indices, list[str], Array]:
    """Equal stretches of the axis: the one of each number, their names and their middles."""
    ends = (float(known[0]), float(known[-1]))
    edges = np.geomspace(*ends, BINS + 1) if log else np.linspace(*ends, BINS + 1)
    index = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, BINS - 1)
    middles = np.sqrt(edges[:-1] * edges[1:]) if log else (edges[:-1] + edges[1:]) / 2
    names = [f"{low:.3g} to {high:.3g}" for low, high in pairwise(edges.tolist())]
    return np.where(np.isfinite(numbers), index, -1), names, middles
