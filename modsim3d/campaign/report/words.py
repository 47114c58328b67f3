"""How the page names scores, conditions and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.done_rows import text_of
from modsim3d.campaign.verdicts.seed_values import columns_of
from modsim3d.campaign.work.score_bounds import SHARES
from modsim3d.tracking.report.numbers import COLUMNS, UNKNOWN

USUAL = ("hota", "deta", "assa", "id_switches")
"""Scores that the table of means always has."""
MOST_KEYS = 4
"""Keys that have columns of their own in a table."""
UNITS = {
    "_px": "px",
    "_s": "s",
    "_per_s": "1/s",
    "_per_hour": "1/h",
    "_m": "m",
    "_rad": "rad",
    "_deg": "°",
    "_hz": "Hz",
}
"""Ends of keys, and the units that they stand for."""
_NAMES = {key: name.partition(",")[0] for name, key, _ in COLUMNS}
_LOW_IS_GOOD = ("siap_spuriousness",)
"""Of the scores from 0 to 1."""


@dataclass(frozen=True)
class Score:
    """A score that the page shows.

    Attributes:
        column: Its column in the results.
        requirements: Those that it is held against.
    """

    column: str
    requirements: tuple[Requirement, ...] = ()

    @property
    def key(self) -> str:
        """Its key, without the part of the runs that it is of."""
        return self.column.rpartition(".")[2]

    @property
    def name(self) -> str:
        """Its name in a table."""
        group, _, name = self.column.rpartition(".")[0].partition(".")
        return _NAMES.get(self.key, self.key) + (f" in {group} {name}" if group else "")

    @property
    def label(self) -> str:
        """Its name on an axis, with its unit."""
        unit = "0 to 1" if self.key in SHARES else "px" if self.key.startswith(("gospa", "ospa")) else unit_of(self.key)
        return f"{self.name} ({unit})" if unit else self.name

    @property
    def lowest_is_worst(self) -> bool:
        """Whether low values are the bad ones, by the requirements, or else by what the score is."""
        if self.requirements:
            return self.requirements[0].at_least is not None
        return (self.key in SHARES and self.key not in _LOW_IS_GOOD) or self.key == "mota"

    @property
    def threshold_words(self) -> list[tuple[str, float]]:
        """What its mean is held against, in words and as a number."""
        sides = {(each.threshold, each.at_least is not None) for each in self._of_mean}
        return [(f"at {'least' if least else 'most'} {value:g}", value) for value, least in sorted(sides)]

    @property
    def thresholds(self) -> tuple[float, ...]:
        """What its mean is held against, ascending."""
        return tuple(sorted({each.threshold for each in self._of_mean}))

    @property
    def _of_mean(self) -> list[Requirement]:
        return [each for each in self.requirements if each.share is None]


def unit_of(key: str) -> str:
    """The unit that the end of a key names; empty without one."""
    return next((unit for end, unit in sorted(UNITS.items(), key=lambda each: -len(each[0])) if key.endswith(end)), "")


def axis_of(key: str) -> str:
    """The name of a varied key on an axis, with its unit."""
    unit = unit_of(key)
    return f"{key} ({unit})" if unit else key


def required_scores(plan: Plan) -> list[Score]:
    """The scores that requirements are about, in their order; HOTA if there are none."""
    found: dict[str, list[Requirement]] = {}
    for requirement in plan.keys.require:
        for column in columns_of(plan, requirement) or [requirement.score]:
            found.setdefault(column, []).extend([requirement] * (requirement.of is None))
    return [Score(column, tuple(each)) for column, each in found.items()] or [Score(USUAL[0])]


def table_scores(plan: Plan) -> list[Score]:
    """The scores of the table of means: the required and the usual ones."""
    required = required_scores(plan)
    known = {each.column for each in required}
    return required + [Score(key) for key in USUAL if key not in known]


def varying(plan: Plan) -> list[str]:
    """The keys that differ between conditions, `scene` among them."""
    rows = [values_of(plan, place) for place in range(len(plan.conditions))]
    keys = dict.fromkeys(key for row in rows for key in row)
    return [key for key in keys if len({text_of(row.get(key)) for row in rows}) > 1]


def constant(plan: Plan) -> dict[str, str]:
    """The keys that are set and the same in all conditions."""
    differing, first = {*varying(plan), "scene"}, {**plan.conditions[0].fixed, **values_of(plan, 0)}
    return {key: shown(value) for key, value in first.items() if key not in differing}


def values_of(plan: Plan, place: int) -> dict[str, Any]:
    """The scene and the values of a condition that are not drawn."""
    condition = plan.conditions[place]
    return {"scene": Path(condition.scene).stem, **condition.values}


def shown(value: Any) -> str:
    """A value of a key; numbers without zeros at their end, and a dash for none."""
    if value is None:
        return UNKNOWN
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else text_of(value)


def in_words(values: Mapping[str, Any], keys: Sequence[str]) -> str:
    """Values of some keys in words; a dash if there are none."""
    said = [f"{key} {shown(values[key])}" for key in keys if values.get(key) is not None]
    return ", ".join(said) or UNKNOWN


def condition_cells(plan: Plan, place: int, keys: Sequence[str]) -> list[str]:
    """The values of some keys in a condition, as cells of a table; one cell if there are many keys."""
    values = values_of(plan, place)
    return [shown(values.get(key)) for key in keys] if len(keys) <= MOST_KEYS else [in_words(values, keys)]


def number(value: float | None) -> str:
    """A number with three digits or three decimals, a whole one as it is; a dash where there is none."""
    if value is None or np.isnan(value):
        return UNKNOWN
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    if float(value).is_integer():
        return f"{value:,.0f}".replace("-", "−")
    return _with_decimals(value, _decimals(value))


def _decimals(value: float) -> int:
    return max(0, 3 - len(f"{abs(value):.0f}")) if abs(value) >= 1 else 3


def _with_decimals(value: float, decimals: int) -> str:
    text = f"{value:,.{decimals}f}"
    return (f"{value:.2g}" if value and not text.strip("-0.") else text).replace("-", "−")


def with_interval(mean: float | None, low: float | None, high: float | None) -> str:
    """A number with its interval; the number alone where there is no interval."""
    if mean is None or low is None or high is None or not (np.isfinite(low) and np.isfinite(high)):
        return number(mean)
    said, *ends = (_with_decimals(value, _decimals(mean)) for value in (mean, low, high))
    return f"{said} [{ends[0]}, {ends[1]}]"
