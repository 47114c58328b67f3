"""Differences between trackers on the same runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import Case
from modsim3d.campaign.verdicts.bounds import UNKNOWN, Bounds, mean_bounds
from modsim3d.campaign.verdicts.means import t_bounds
from modsim3d.campaign.verdicts.seed_values import Rows, Runs
from modsim3d.campaign.work.score_bounds import is_bounded, score_bounds

CONFIDENCE = 0.95


@dataclass(frozen=True)
class PairedDifference:
    """A score of one tracker less that of another on the same traffic and detections, in one condition.

    Attributes:
        first: Name of the tracker in tables.
        second: Name of the one that is taken off.
        condition: Number of the condition.
        score: The score.
        mean: Mean difference over traffic seeds; None without any.
        low: Lower end of its two-sided interval at `CONFIDENCE`; None if unknown.
        high: Upper end.
        seeds: Number of traffic seeds in which both have the score.
        crashed: Number of seeds in which a run of either crashed or gave nothing to score; the interval takes the least
            and the greatest possible difference for them, and there is none if the score has no bounds.
        undefined: Number of seeds in which either has no score.
        variance_ratio: Variance of a difference between seeds that are not shared over that of the paired one: so many
            times the seeds would be needed without pairing; None if unknown.
    """

    first: str
    second: str
    condition: int
    score: str
    mean: float | None
    low: float | None
    high: float | None
    seeds: int
    crashed: int
    undefined: int
    variance_ratio: float | None


def paired(plan: Plan, table: pa.Table, score: str) -> tuple[PairedDifference, ...]:
    """The paired differences of a score between every two trackers in each condition.

    Intervals are by Student's t if the campaign is looked at once, and there are none before all its runs are done; of
    a sequential campaign they hold however often it is looked at, and only scores with bounds have them.

    Args:
        plan: The plan.
        table: The rows so far, see `results_table`.
        score: A key of the scores.
    """
    rows = Rows(plan, table)
    pairs = list(combinations(range(len(plan.keys.trackers)), 2))
    return tuple(
        _difference(plan, rows, score, condition, *pair) for condition in range(len(plan.conditions)) for pair in pairs
    )


def _difference(plan: Plan, rows: Rows, score: str, condition: int, first: int, second: int) -> PairedDifference:
    one, other = (rows.runs_of(Case(tracker, condition), score) for tracker in (first, second))
    runs = one.minus(other)
    differences = runs.means(math.nan)
    whole = ~np.any(runs.lost, axis=1)
    differences = differences[whole[~runs.undefined]]
    low, high = _interval(plan, rows, runs, score)
    labels = [each.label for each in plan.keys.trackers]
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


def _interval(plan: Plan, rows: Rows, runs: Runs, score: str) -> tuple[float | None, float | None]:
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
    first, second, paired_variance = (_variance(each.values[both]) for each in (one, other, difference))
    return (first + second) / paired_variance


def _variance(values: Array) -> float:
    return float(values.mean(axis=1).var(ddof=1))
