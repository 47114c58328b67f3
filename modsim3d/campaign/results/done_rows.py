"""The rows that are done so far, from the files of tasks."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.work.row import DONE, FACTS, SCORES, table_of
from modsim3d.campaign.work.task import ROWS_PATTERN, name_of_rows, read_rows

_OF_ALL_PLANS = ("scene", "condition", "traffic_seed", "detector_seed", "tracker")
_TOGETHER = 200
"""Small tables that are kept before they become one; each costs some 50 kB beside its rows."""


class DoneRows:
    """The rows of a campaign that is not finished, each file of a task read once."""

    def __init__(self, folder: CampaignFolder) -> None:
        """Take the folder, and read nothing yet."""
        self._folder = folder
        self._parts: list[pa.Table] = []
        self._small: list[pa.Table] = []
        self._read: set[str] = set()

    def read(self, first_runs: Container[int] | None = None) -> DoneRows:
        """Read all files that were not read yet; those that are damaged are left out.

        Args:
            first_runs: Only files that begin with one of these runs; None: all.
        """
        for path in sorted(self._folder.done.glob(ROWS_PATTERN)):
            if first_runs is None or int(path.name.partition("_")[0]) in first_runs:
                self.add(path)
        return self

    def add(self, path: Path) -> bool:
        """Read the file of a task; whether it is there, not damaged, and of this plan."""
        if path.name in self._read:
            return True
        rows = read_rows(path)
        if rows is None or path.name != name_of_rows(self._folder.facts["sha256"], rows["run"].to_pylist()):
            return False
        self._read.add(path.name)
        self._small.append(rows.replace_schema_metadata(None))
        if len(self._small) >= _TOGETHER:
            self._join()
        return True

    def numbers(self) -> Indices:
        """The runs whose rows are there, ascending, shape (n,)."""
        self._join()
        found = [part["run"].to_numpy() for part in self._parts]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *found]))

    def crashed(self) -> int:
        """Number of rows of runs that crashed."""
        self._join()
        return sum(pc.sum(pc.not_equal(part["status"], DONE)).as_py() for part in self._parts)

    def table(self) -> pa.Table:
        """The rows, one for each run in the order of the plan, with the columns of the plan.

        Of a run that is there twice, a row that did not crash counts.
        """
        self._join()
        table = pa.concat_tables(self._parts or [with_plan(table_of([]), self._folder.plan)], promote_options="default")
        ahead = list(dict.fromkeys(["run", *plan_columns(self._folder.plan), *FACTS, *SCORES]))
        table = table.select([*ahead, *sorted(set(table.column_names) - set(ahead))])
        crashed = pc.not_equal(table["status"], DONE)
        keys_of_order = [("run", "ascending"), ("crashed", "ascending")]
        order = pc.sort_indices(pa.table({"run": table["run"], "crashed": crashed}), keys_of_order)
        table = table.take(order)
        return table.filter(np.diff(table["run"].to_numpy(), prepend=-1) > 0)

    def _join(self) -> None:
        if self._small:
            joined = pa.concat_tables(self._small, promote_options="default").combine_chunks()
            self._parts.append(with_plan(joined, self._folder.plan))
            self._small = []


def plan_columns(plan: Plan) -> list[str]:
    """The columns that the plan gives to a row."""
    return [*_OF_ALL_PLANS, *(name for name in plan.parameters if name != "scene")]


def with_plan(table: pa.Table, plan: Plan) -> pa.Table:
    """The table with what the plan says of each run after its number."""
    runs = plan.runs(table["run"].to_pylist())
    columns = {
        "scene": pa.array([Path(run.condition.scene).stem for run in runs], pa.string()),
        "condition": pa.array([run.condition_index for run in runs], pa.int64()),
        "traffic_seed": pa.array([run.traffic_seed for run in runs], pa.int64()),
        "detector_seed": pa.array([run.detector_seed for run in runs], pa.int64()),
        "tracker": pa.array([run.tracker.label for run in runs], pa.string()),
        **{
            name: _values([run.condition.values.get(name) for run in runs], plan, name)
            for name in plan.parameters
            if name != "scene"
        },
    }
    return pa.table(
        {"run": table["run"], **columns, **{name: table[name] for name in table.column_names if name != "run"}}
    )


def _values(values: Sequence[Any], plan: Plan, name: str) -> pa.Array:
    """A column of values of a key: numbers if all that the plan may have are numbers, else text."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in _possible(plan, name)):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else text_of(value) for value in values], pa.string())


def _possible(plan: Plan, name: str) -> Iterator[Any]:
    """The values that a key may have; one for a range of numbers."""
    for condition in plan.conditions:
        if condition.values.get(name) is not None:
            yield condition.values[name]
    for factor in plan.keys.vary:
        if name in factor.ranges:
            choices = factor.ranges[name].choices
            yield from [0.0] if choices is None else [value for value in choices if value is not None]


def text_of(value: Any) -> str:
    """A value of a key as a table shows it."""
    return value if isinstance(value, str) else orjson.dumps(value).decode()
