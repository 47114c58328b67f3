"""Values of a requirement by traffic seed, its unit, to which runs with several detector seeds belong together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.keys import TIMES, Requirement
from modsim3d.campaign.plan import Case, Plan, cases_of
from modsim3d.campaign.verdicts.bounds import UNKNOWN, Bounds, mean_bounds
from modsim3d.campaign.work.row import APPROACHES, CRASHED, WORLD_SCORES, Columns, facts_of, is_bounded, score_bounds
from modsim3d.core.arrays import Array, Mask
from modsim3d.core.statistics import t_bounds


def mean_of(values: Array, axis: int) -> Array:
    """The mean over an axis of what is no NaN; NaN where there is nothing."""
    valid = ~np.isnan(values)
    count, total = valid.sum(axis=axis), np.where(valid, values, 0.0).sum(axis=axis)
    mean: Array = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return mean


@dataclass(frozen=True, eq=False)
class Runs:
    """A score in the runs of a tracker in a condition, by traffic seed and detector seed, arrays of shape (s, d). A run
    without a value is the tracker's fault or not. It is where the tracker gave nothing to score, or too little: that
    counts as a crash does, and so does a run whose tracks are in the images where the score is of tracks in the world,
    and the reverse. Otherwise the truth has nothing to score, or nothing of what is counted went wrong."""

    values: Array  # NaN where there is none
    crashed: Mask
    nothing: Mask  # the tracker gave nothing to score, or less than the requirement asks for
    share: Array  # of what is to be followed that the score rests on, NaN where there is nothing

    @property
    def lost(self) -> Mask:
        """Runs that crashed, or whose tracker gave nothing to score, shape (s, d)."""
        return self.crashed | self.nothing

    @property
    def undefined(self) -> Mask:
        """Seeds in which no run is lost and none has a value, shape (s,)."""
        nothing: Mask = np.all(np.isnan(self.values) & ~self.lost, axis=1)
        return nothing

    @property
    def left_out(self) -> Mask:
        """Runs without a value that are not lost, in seeds that have others, shape (s, d)."""
        return np.isnan(self.values) & ~self.lost & ~self.undefined[:, None]

    def minus(self, other: Runs) -> Runs:
        """The difference to another tracker in each run: lost where one of both is, or infinite."""
        infinite = np.isinf(self.values) | np.isinf(other.values)
        values = np.where(infinite, np.nan, self.values) - np.where(infinite, np.nan, other.values)
        nothing = self.nothing | other.nothing | infinite
        return Runs(values, self.crashed | other.crashed, nothing, np.minimum(self.share, other.share))

    @property
    def rests_on(self) -> float | None:
        """The share that the score rests on, mean over the runs with something to follow; none if they crashed."""
        shares = np.where(self.crashed, 0, self.share)[self.crashed | ~np.isnan(self.share)]
        return float(shares.mean()) if len(shares) else None

    def means(self, instead: float) -> Array:
        """Mean of each seed that is not undefined, with a value in place of lost runs, shape (m,). NaN stands for
        leaving them out, and is the mean of a seed that has no others."""
        return mean_of(np.where(self.lost, instead, self.values)[~self.undefined], 1)

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
    if requirement.known_at_m is not None:  # it has a share of approaches, and no column
        return []
    return list(dict.fromkeys(column_of(requirement.score, case) for case in cases_of(plan, requirement)))


class SeedRows:
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
        """Runs of a case; `resting_on` is the least share that the score of a run must rest on, of both trackers in a
        difference."""
        if case.minus is not None:
            both = (replace(case, tracker=tracker, minus=None) for tracker in (case.tracker, case.minus))
            one, other = (self.runs_of(side, score, resting_on) for side in both)
            return one.minus(other)
        facts, column = facts_of(score, case.group), self.columns(case)
        values, crashed = column(score), self._crashed[self._place(case)]
        present = column(facts.expected) > 0
        if facts.of_faults:
            present &= column("established") == 0
        apart = self.columns(replace(case, part=None))("appearances" if score in WORLD_SCORES else "vessels")
        elsewhere = ~np.isnan(apart) & (score not in TIMES)  # where its tracks are
        share = np.where(elsewhere, 0.0, facts.basis.share(column))
        nothing = np.isnan(values) & ((present & (facts.managed | facts.worst_undefined)) | elsewhere) & ~crashed
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

    def approaches(self, case: Case) -> tuple[list[list[dict[str, Any]]], Mask]:
        """The approaches of each traffic seed of a case, and whether a run of it crashed, shape (s,)."""
        present = APPROACHES in self._table.column_names
        texts = self._table[APPROACHES].to_pylist() if present else [None] * len(self._table)
        of_case = np.array(texts, dtype=object).reshape(self._shape)[self._place(case)]
        by_seed = [[approach for text in seed if text for approach in orjson.loads(text)] for seed in of_case]
        return by_seed, self._crashed[self._place(case)].any(axis=1)

    def _place(self, case: Case) -> tuple[slice | int, ...]:
        return (slice(None), case.condition, slice(None), case.tracker)


CONFIDENCE = 0.95


@dataclass(frozen=True)
class PairedDifference:
    """A score of one tracker less that of another on the same traffic and detections, in one condition. `crashed`
    counts seeds in which a run of either crashed or gave nothing to score; the interval takes the least and the
    greatest possible difference for them, and there is none if the score has no bounds. `variance_ratio` is the
    variance of a difference between seeds that are not shared over that of the paired one: so many times the seeds
    would be needed without pairing; None if unknown."""

    first: str  # name of the tracker in tables
    second: str  # name of the one that is taken off
    condition: int
    score: str
    mean: float | None  # over traffic seeds; None without any
    low: float | None  # of the two-sided interval at `CONFIDENCE`; None if unknown
    high: float | None
    seeds: int  # traffic seeds in which both have the score
    crashed: int
    undefined: int  # seeds in which either has no score
    variance_ratio: float | None


def paired(plan: Plan, table: pa.Table, score: str) -> tuple[PairedDifference, ...]:
    """Paired differences of a score between every two trackers in each condition. Intervals are by Student's t if the
    campaign is looked at once, and there are none before all its runs are done; of a sequential campaign they hold
    however often it is looked at, and only scores with bounds have them."""
    rows = SeedRows(plan, table)
    pairs = list(combinations(range(len(plan.keys.trackers)), 2))
    return tuple(
        _difference(plan, rows, score, condition, *pair) for condition in range(len(plan.conditions)) for pair in pairs
    )


def _difference(plan: Plan, rows: SeedRows, score: str, condition: int, first: int, second: int) -> PairedDifference:
    one, other = (rows.runs_of(Case(tracker, condition), score) for tracker in (first, second))
    runs = one.minus(other)
    differences = runs.means(math.nan)
    whole = ~np.any(runs.lost, axis=1)
    differences = differences[whole[~runs.undefined]]
    low, high = _interval(plan, rows, runs, score)
    labels = [tracker.label for tracker in plan.keys.trackers]
    return PairedDifference(
        labels[first],
        labels[second],
        condition,
        score,
        float(differences.mean()) if len(differences) else None,
        low,
        high,
        len(differences),
        int(np.count_nonzero(~whole)),
        int(np.count_nonzero(runs.undefined)),
        _variance_ratio(one, other, runs),
    )


def _interval(plan: Plan, rows: SeedRows, runs: Runs, score: str) -> tuple[float | None, float | None]:
    least, greatest = score_bounds(score, plan.keys.score)
    stop, span, each_side = plan.keys.stop, greatest - least, (1 + CONFIDENCE) / 2
    worst, best, bounds = runs.means(-span), runs.means(span), UNKNOWN
    if stop == "once" and rows.seeds == plan.keys.seeds.traffic:
        ends = t_bounds(worst, 1 - each_side), t_bounds(best, 1 - each_side)
        bounds = Bounds(max(ends[0][0], -span), min(ends[1][1], span)) if ends[0] and ends[1] else UNKNOWN
    elif stop == "sequential" and rows.seeds > 0 and is_bounded(score, plan.keys.score):
        bounds = mean_bounds(worst, best, each_side, stop, (-span, span))
    return (bounds.low, bounds.high) if math.isfinite(bounds.low) and math.isfinite(bounds.high) else (None, None)


def _variance_ratio(one: Runs, other: Runs, difference: Runs) -> float | None:
    """Over the seeds in which all runs of both have values."""
    both = np.all(~np.isnan(difference.values) & ~difference.crashed, axis=1)
    means = difference.values[both].mean(axis=1)
    if t_bounds(means, 0.5) is None:
        return None
    runs = (one, other, difference)
    first, second, paired_variance = (float(sample.values[both].mean(axis=1).var(ddof=1)) for sample in runs)
    return (first + second) / paired_variance


@dataclass(frozen=True, eq=False)
class ApproachCounts:
    """Numbers of approaches of each of s traffic seeds, of all its runs together."""

    came: Array  # that were in view beyond the distance, and came so near, shape (s,)
    known: Array  # of these, that tracks had followed before, and kept, shape (s,)
    crashed: Mask  # whether a run of the seed crashed, shape (s,)
    appeared_nearer: int  # vessels that were in view only nearer
    never_so_near: int  # vessels that stayed farther away

    @property
    def shares(self) -> Array:
        """Share of its approaches that are known, of each seed that has some; 0 if a run of it crashed, shape (n,)."""
        counted = self.crashed | (self.came > 0)
        return np.where(self.crashed, 0.0, self.known / np.maximum(self.came, 1))[counted]

    @property
    def share(self) -> float | None:
        """Their mean: each traffic seed counts as much as another. None without any."""
        return float(self.shares.mean()) if len(self.shares) else None


def counted_approaches(
    seeds: Sequence[Sequence[dict[str, Any]]], crashed: Mask, distance_m: float, track: str = "one_track_m"
) -> ApproachCounts:
    """Counts at a distance of the approaches of each seed, as rows have them, given which seeds had a run that crashed;
    `track` names the field with the distance from which on a vessel was known."""
    every = [event for seed in seeds for event in seed]
    came = [[event for event in seed if event["closest_m"] <= distance_m <= event["in_view_m"]] for seed in seeds]
    hits = [sum(event[track] >= distance_m for event in seed) for seed in came]
    nearer = sum(event["closest_m"] <= distance_m and event["in_view_m"] < distance_m for event in every)
    farther = sum(event["closest_m"] > distance_m for event in every)
    numbers = np.array([[len(seed) for seed in came], hits], dtype=np.float64)
    return ApproachCounts(numbers[0], numbers[1], crashed, nearer, farther)


def required_approaches(
    requirement: Requirement, seeds: Sequence[Sequence[dict[str, Any]]], crashed: Mask
) -> ApproachCounts:
    """Counts of the approaches that a lookout requirement is about."""
    assert requirement.known_at_m is not None and requirement.kind is not None
    kind, track = requirement.kind, "one_track_m" if requirement.one_track else "known_m"
    low, high = kind.length_m or (0.0, np.inf)
    of_kind = [
        [event for event in seed if low <= event["length_m"] < high and kind.label in (None, event["label"])]
        for seed in seeds
    ]
    return counted_approaches(of_kind, crashed, requirement.known_at_m, track)
