"""What each traffic seed says of a requirement: its unit, whose runs with several detector seeds belong together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Mask
from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import Case, cases_of
from modsim3d.campaign.work.row import BY_STATE, CRASHED


@dataclass(frozen=True, eq=False)
class Runs:
    """A score in the runs of a tracker in a condition, by traffic seed and detector seed.

    Attributes:
        values: The scores, NaN where there is none, shape (s, d).
        crashed: Which runs crashed, shape (s, d).
    """

    values: Array
    crashed: Mask

    @property
    def undefined(self) -> Mask:
        """Seeds in which no run crashed and none has a value, shape (s,)."""
        nothing: Mask = np.all(np.isnan(self.values) & ~self.crashed, axis=1)
        return nothing

    def means(self, instead: float) -> Array:
        """The mean of each seed that is not undefined, with a value in place of crashed runs, shape (m,).

        NaN stands for leaving them out, and is the mean of a seed that has no others.
        """
        values = np.where(self.crashed, instead, self.values)[~self.undefined]
        defined = ~np.isnan(values)
        sums, counts = np.where(defined, values, 0).sum(axis=1), defined.sum(axis=1)
        means: Array = np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)
        return means

    def right(self, requirement: Requirement) -> Mask:
        """Whether all runs of a seed are right, of each seed that is not undefined; no crashed run is, shape (m,)."""
        at_least, threshold = requirement.at_least is not None, requirement.threshold
        wrong = (self.values < threshold if at_least else self.values > threshold) | self.crashed
        right: Mask = ~np.any(wrong, axis=1)[~self.undefined]
        return right


def column_of(score: str, case: Case) -> str:
    """The column of a score: that of the whole run, or of a state within it."""
    return score if case.state is None else f"{BY_STATE}.{case.state}.{score}"


def columns_of(plan: Plan, requirement: Requirement) -> list[str]:
    """The columns that a requirement is about: several if it names several states within the runs."""
    return list(dict.fromkeys(column_of(requirement.score, case) for case in cases_of(plan, requirement)))


class Rows:
    """The rows of the first traffic seeds, by seed, condition, detector seed and tracker."""

    def __init__(self, plan: Plan, table: pa.Table) -> None:
        """Take rows in the order of the plan; those from the first seed on that is not whole are left out."""
        numbers = table["run"].to_numpy()
        together = int(np.count_nonzero(numbers == np.arange(len(numbers))))
        self.seeds = together // plan.runs_by_seed
        self._table = table.slice(0, self.seeds * plan.runs_by_seed)
        self._shape = (self.seeds, len(plan.conditions), plan.keys.seeds.detector, len(plan.keys.trackers))
        self._crashed = pc.equal(self._table["status"], CRASHED).to_numpy().astype(bool).reshape(self._shape)

    def runs_of(self, case: Case, score: str) -> Runs:
        """The runs of a case."""
        name = column_of(score, case)
        values = np.full(self._shape, np.nan)
        if name in self._table.column_names:
            values = self._table[name].to_numpy().astype(float).reshape(self._shape)
        place = np.s_[:, case.condition, :, case.tracker]
        return Runs(values[place], self._crashed[place])
