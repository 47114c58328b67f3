"""What each traffic seed says of a requirement: its unit, whose runs with several detector seeds belong together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Mask
from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import Case, cases_of
from modsim3d.campaign.work.row import CRASHED
from modsim3d.campaign.work.score_bounds import Columns, facts_of


@dataclass(frozen=True, eq=False)
class Runs:
    """A score in the runs of a tracker in a condition, by traffic seed and detector seed.

    A run without a value is the tracker's fault or not. It is where the tracker gave nothing to score, or too little:
    that counts as a crash does. Otherwise the truth has nothing to score, or nothing of what is counted went wrong.

    Attributes:
        values: The scores, NaN where there is none, shape (s, d).
        crashed: Which runs crashed, shape (s, d).
        nothing: In which ones the tracker gave nothing to score, or less than the requirement asks for, shape (s, d).
        share: The share of what is to be followed that the score rests on, NaN where there is nothing, shape (s, d).
    """

    values: Array
    crashed: Mask
    nothing: Mask
    share: Array

    @property
    def lost(self) -> Mask:
        """Runs that crashed, or whose tracker gave nothing to score, shape (s, d)."""
        lost: Mask = self.crashed | self.nothing
        return lost

    @property
    def undefined(self) -> Mask:
        """Seeds in which no run is lost and none has a value, shape (s,)."""
        nothing: Mask = np.all(np.isnan(self.values) & ~self.lost, axis=1)
        return nothing

    @property
    def left_out(self) -> Mask:
        """Runs without a value that are not lost, in seeds that have others, shape (s, d)."""
        alone: Mask = np.isnan(self.values) & ~self.lost & ~self.undefined[:, None]
        return alone

    def minus(self, other: Runs) -> Runs:
        """The difference to another tracker in each run: lost where one of both is, or infinite."""
        infinite = np.isinf(self.values) | np.isinf(other.values)
        values = np.where(infinite, np.nan, self.values) - np.where(infinite, np.nan, other.values)
        nothing = self.nothing | other.nothing | infinite
        return Runs(values, self.crashed | other.crashed, nothing, np.minimum(self.share, other.share))

    @property
    def rests_on(self) -> float | None:
        """The share that the score rests on, mean over the runs with something to follow; none if they crashed."""
        known = np.where(self.crashed, 0, self.share)[self.crashed | ~np.isnan(self.share)]
        return float(known.mean()) if len(known) else None

    def means(self, instead: float) -> Array:
        """The mean of each seed that is not undefined, with a value in place of lost runs, shape (m,).

        NaN stands for leaving them out, and is the mean of a seed that has no others.
        """
        values = np.where(self.lost, instead, self.values)[~self.undefined]
        defined = ~np.isnan(values)
        sums, counts = np.where(defined, values, 0).sum(axis=1), defined.sum(axis=1)
        means: Array = np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)
        return means

    def right(self, requirement: Requirement) -> Mask:
        """Whether all runs of a seed are right, of each seed that is not undefined; no lost run is, shape (m,)."""
        good = self.values >= requirement.threshold
        if requirement.at_least is None:
            good = self.values <= requirement.threshold
        right: Mask = np.all((good & ~self.lost) | self.left_out, axis=1)[~self.undefined]
        return right


def column_of(score: str, case: Case) -> str:
    """The column of a score: that of the whole run, or of a part of it."""
    return score if case.part is None else f"{case.part.group}.{case.part.name}.{score}"


def columns_of(plan: Plan, requirement: Requirement) -> list[str]:
    """The columns that a requirement is about: several if it names several parts of the runs."""
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

    def runs_of(self, case: Case, score: str, resting_on: float | None = None) -> Runs:
        """The runs of a case.

        Args:
            case: A tracker in a condition, or in a part of its runs.
            score: A key of the scores.
            resting_on: The least share that the score of a run must rest on, of both trackers in a difference.
        """
        if case.minus is not None:
            both = (replace(case, tracker=tracker, minus=None) for tracker in (case.tracker, case.minus))
            one, other = (self.runs_of(each, score, resting_on) for each in both)
            return one.minus(other)
        facts, column = facts_of(score, case.group), self.columns(case)
        values, crashed = column(score), self._crashed[self._place(case)]
        there = column(facts.expected) > 0
        if facts.of_faults:
            there &= column("established") == 0
        share = facts.basis.share(column)
        nothing = np.isnan(values) & there & facts.managed & ~crashed
        if resting_on is not None:
            nothing |= share < resting_on
        return Runs(np.where(nothing, np.nan, values), crashed, nothing, share)

    def columns(self, case: Case) -> Columns:
        """The columns of the runs of a case, each of the shape (s, d): those of a part, if it is about one."""

        def column(name: str) -> Array:
            name = column_of(name, case)
            if name not in self._table.column_names:
                return np.full(self._shape, np.nan)[self._place(case)]
            return np.asarray(self._table[name].to_numpy(), dtype=np.float64).reshape(self._shape)[self._place(case)]

        return column

    def _place(self, case: Case) -> tuple[slice | int, ...]:
        return (slice(None), case.condition, slice(None), case.tracker)
