"""The scores of a campaign as arrays, and their means with intervals over traffic seeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array, Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.means import LEVEL
from modsim3d.campaign.verdicts.means import half_widths


@dataclass(frozen=True, eq=False)
class Estimates:
    """Means over traffic seeds with Student's intervals, arrays of one shape; NaN where there are too few seeds.

    Attributes:
        mean: The means.
        low: Lower ends of the intervals.
        high: Upper ends.
        seeds: Numbers of traffic seeds with a value.
    """

    mean: Array
    low: Array
    high: Array
    seeds: Indices

    def with_least(self, seeds: int) -> Estimates:
        """The estimates that rest on so many seeds; the others are NaN."""
        few = self.seeds < seeds
        mean, low, high = (np.where(few, np.nan, each) for each in (self.mean, self.low, self.high))
        return Estimates(mean, low, high, self.seeds)


def seed_cells(plan: Plan, table: pa.Table, column: str) -> Array:
    """A score by traffic seed, condition and tracker: the mean over detector seeds, NaN where no run has a value.

    Args:
        plan: The plan.
        table: Rows of the campaign, in any number and order.
        column: The column with the score.

    Returns:
        Shape (traffic seeds up to the last with a row, conditions, trackers).
    """
    seeds, trackers = plan.keys.seeds.detector, len(plan.keys.trackers)
    runs = table["run"].to_numpy()
    count = int(runs.max()) // plan.runs_by_seed + 1 if len(runs) else 0
    values = np.full(count * plan.runs_by_seed, np.nan)
    if column in table.column_names and len(runs):
        values[runs] = table[column].cast(pa.float64()).to_numpy()
    return mean_of(values.reshape(count, len(plan.conditions), seeds, trackers), 2)


def mean_of(values: Array, axis: int | tuple[int, ...]) -> Array:
    """The mean over axes of what is no NaN; NaN where there is nothing."""
    known = ~np.isnan(values)
    count = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    found: Array = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return found


def over_seeds(values: Array) -> Estimates:
    """Means over the first axis, which is that of traffic seeds; NaN is no value."""
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    mean = mean_of(values, 0)
    with np.errstate(invalid="ignore"):  # an infinite mean has no interval
        square = np.where(known, values - mean, 0.0) ** 2
        deviation = np.sqrt(square.sum(axis=0) / np.maximum(count - 1, 1))
        half = half_widths(mean, deviation, count, (1 - LEVEL) / 2)
    return Estimates(mean, mean - half, mean + half, count)


def by_level(cells: Array, index: Indices, levels: int) -> Estimates:
    """Means over the traffic seeds at each level of a parameter.

    The value of a seed at a level is the mean over its conditions at that level.

    Args:
        cells: A score, shape (seeds, conditions, trackers).
        index: The level of each seed and condition, −1 for none, shape (seeds, conditions).
        levels: Number of levels.

    Returns:
        Arrays of the shape (levels, trackers).
    """
    found = []
    for level in range(levels):
        at = index == level
        seeds = at.any(axis=1)
        found.append(over_seeds(mean_of(np.where(at[seeds, :, None], cells[seeds], np.nan), 1)))
    return Estimates(*(np.stack([getattr(each, name) for each in found]) for name in ("mean", "low", "high", "seeds")))
