"""Scores against what is varied: lines with bands over numbers, intervals over names, and heat maps of pairs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.campaign.keys import Range
from modsim3d.campaign.means import LEVEL, REQUIRED, interval_of, required_means
from modsim3d.campaign.plan import Plan, are_numbers, text_of, value_of
from modsim3d.campaign.report.words import Score, axis_of, required_scores
from modsim3d.campaign.verdicts.seed_values import mean_of
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.core.arrays import Array, Indices
from modsim3d.core.document import Block, BlockRow, Cell, Figure, Heading, Row, Table, Text
from modsim3d.core.statistics import half_widths
from modsim3d.core.text import three_digits
from modsim3d.view.pages import charts
from modsim3d.view.pages.charts import ChartInterval, band, forest, legend, marks, span_of


@dataclass(frozen=True, eq=False)
class MeanGrid:
    """Means over traffic seeds with Student's intervals, arrays of one shape; NaN where there are too few seeds."""

    mean: Array
    low: Array
    high: Array
    seeds: Indices  # numbers of traffic seeds with a value

    def with_least(self, seeds: int) -> MeanGrid:
        """The estimates that rest on so many seeds; the others are NaN."""
        few = self.seeds < seeds
        mean, low, high = (np.where(few, np.nan, values) for values in (self.mean, self.low, self.high))
        return MeanGrid(mean, low, high, self.seeds)


def seed_cells(plan: Plan, table: pa.Table, column: str) -> Array:
    """A score, shape (traffic seeds up to the last with a row, conditions, trackers): the mean over detector seeds, NaN
    where no run has a value. The table may have any of the campaign's rows, in any order."""
    seeds, trackers = plan.keys.seeds.detector, len(plan.keys.trackers)
    runs = table["run"].to_numpy()
    count = int(runs.max()) // plan.runs_by_seed + 1 if len(runs) else 0
    values = np.full(count * plan.runs_by_seed, np.nan)
    if column in table.column_names and len(runs):
        values[runs] = table[column].cast(pa.float64()).to_numpy()
    return mean_of(values.reshape(count, len(plan.conditions), seeds, trackers), 2)


def over_seeds(values: Array) -> MeanGrid:
    """Means over the first axis, which is that of traffic seeds; NaN is no value."""
    valid = ~np.isnan(values)
    count = valid.sum(axis=0)
    mean = mean_of(values, 0)
    with np.errstate(invalid="ignore"):  # an infinite mean has no interval
        square = np.where(valid, values - mean, 0.0) ** 2
        deviation = np.sqrt(square.sum(axis=0) / np.maximum(count - 1, 1))
        half = half_widths(mean, deviation, count, (1 - LEVEL) / 2)
    return MeanGrid(mean, mean - half, mean + half, count)


def by_level(cells: Array, index: Indices, levels: int) -> MeanGrid:
    """Means over the traffic seeds at each level of a parameter, shape (levels, trackers). The value of a seed at a
    level is the mean over its conditions at that level. `cells` is a score, (seeds, conditions, trackers), and `index`
    the level of each seed and condition, (seeds, conditions), −1 for none."""
    grids = []
    for level in range(levels):
        at = index == level
        seeds = at.any(axis=1)
        grids.append(over_seeds(mean_of(np.where(at[seeds, :, None], cells[seeds], np.nan), 1)))
    return MeanGrid(*(np.stack([getattr(grid, name) for grid in grids]) for name in ("mean", "low", "high", "seeds")))


MAX_LEVELS = 12  # numbers of a grid that are shown one by one
BINS = 6  # stretches into which drawn numbers are put
DECADES = 1.5  # from so many between the least and the greatest number on, an axis is logarithmic


@dataclass(frozen=True, eq=False)
class VariedKey:
    """A key that is varied; levels are values, or stretches of numbers if `binned`."""

    key: str
    levels: tuple[str, ...]  # their names
    index: Indices  # level of each traffic seed and condition, (seeds, conditions), −1 where the key is not set
    numbers: Array | None = None  # of each, (seeds, conditions), NaN where the key is not set; None if they are none
    places: Array | None = None  # of the levels, (levels,): numbers, or middles of stretches; None without numbers
    binned: bool = False
    log: bool = False  # whether numbers belong on a logarithmic axis

    @cached_property
    def on_axis(self) -> Array:
        """Places of the levels on the axis of a chart, shape (levels,)."""
        assert self.places is not None
        return np.log10(self.places) if self.log else self.places


def parameters_of(plan: Plan, table: pa.Table) -> list[VariedKey]:
    """Parameters with more than one value, in the order of the file."""
    seed = table["run"].to_numpy() // plan.runs_by_seed
    seeds = int(seed.max()) + 1 if len(seed) else 0
    ranges = {key: span for factor in plan.keys.vary for key, span in factor.ranges.items()}
    places, first = np.unique(seed, return_index=True)
    parameters = []
    for key in plan.parameters:
        if key in ranges:
            drawn: list[Any] = [None] * seeds
            for place, value in zip(places.tolist(), table[key].take(first).to_pylist(), strict=True):
                drawn[place] = value
            parameters.append(_parameter(key, [[value] * len(plan.conditions) for value in drawn], ranges[key]))
        else:
            row = [value_of(condition, key) for condition in plan.conditions]
            parameters.append(_parameter(key, [row], None, seeds))
    return [parameter for parameter in parameters if len(parameter.levels) > 1]


def _parameter(key: str, values: Sequence[Sequence[Any]], span: Range | None, repeat: int = 1) -> VariedKey:
    """A parameter of its values, a row for each seed; one row that holds for all is repeated."""
    flat = [value for row in values for value in row if value is not None]
    if not (flat and are_numbers(flat)):
        names = list(dict.fromkeys(map(text_of, flat)))
        places = {name: place for place, name in enumerate(names)}
        rows = [[-1 if value is None else places[text_of(value)] for value in row] for row in values]
        return VariedKey(key, tuple(names), np.repeat(np.array(rows, dtype=np.int64), repeat, axis=0))
    numbers = np.array([[np.nan if value is None else float(value) for value in row] for row in values])
    levels = np.unique(numbers[np.isfinite(numbers)])
    log = bool(levels[0] > 0 and np.log10(levels[-1] / levels[0]) >= DECADES) if span is None else span.scale == "log"
    if len(levels) <= MAX_LEVELS:
        index = np.where(np.isfinite(numbers), np.searchsorted(levels, numbers), -1)
        names, places_of = [f"{value:g}" for value in levels], levels
    else:
        index, names, places_of = _binned(numbers, levels, log)
    numbers, index = (np.repeat(grid, repeat, axis=0) for grid in (numbers, index))
    return VariedKey(key, tuple(names), index, numbers, places_of, len(levels) > MAX_LEVELS, log)


def _binned(numbers: Array, levels: Array, log: bool) -> tuple[Indices, list[str], Array]:
    """Equal stretches of the axis: the one of each number, their names and their middles."""
    ends = (float(levels[0]), float(levels[-1]))
    edges = np.geomspace(*ends, BINS + 1) if log else np.linspace(*ends, BINS + 1)
    index = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, BINS - 1)
    middles = np.sqrt(edges[:-1] * edges[1:]) if log else (edges[:-1] + edges[1:]) / 2
    names = [f"{low:.3g} to {high:.3g}" for low, high in pairwise(edges.tolist())]
    return np.where(np.isfinite(numbers), index, -1), names, middles


MAX_SCORES, MAX_PARAMETERS, MAX_PAIRS, MAX_SHOWN_TRACKERS = 3, 8, 10, 6
MAX_DOTS = 400  # of a tracker in a chart
MIN_SEEDS = 3  # a mean of drawn numbers rests on at least so many seeds


def parameter_sections(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict] = ()) -> list[Block]:
    """Charts of each required score against each parameter, and heat maps of the first score."""
    parameters, scores = parameters_of(plan, table), required_scores(plan)[:MAX_SCORES]
    trackers = [tracker.label for tracker in plan.keys.trackers][:MAX_SHOWN_TRACKERS]
    if not parameters or not len(table):
        return []
    cells = {score.column: seed_cells(plan, table, score.column)[:, :, : len(trackers)] for score in scores}
    required = required_means(plan, verdicts)
    caption = (
        f"Mean over traffic seeds with its {100 * LEVEL:g} % interval by Student's t; the value of a seed is the mean "
        "over all its runs at that level, whatever else is varied." + f" {REQUIRED}" * bool(required)
    )
    charts_of = [
        Figure(
            partial(_charts, parameter, scores, cells, trackers, required), _remark(parameter, plan, parameters, scores)
        )
        for parameter in parameters[:MAX_PARAMETERS]
    ]
    rest = ", ".join(parameter.key for parameter in parameters[MAX_PARAMETERS:])
    return [
        Heading("Scores against what is varied"),
        Text(caption, "soft"),
        Figure(partial(legend, trackers), ""),
        *([BlockRow(charts_of)] if len(scores) == 1 else charts_of),
        Text(f"Not shown: {rest}." if rest else "", "soft"),
        *_heat_maps(parameters, scores[0], cells[scores[0].column], trackers),
    ]


def _charts(
    parameter: VariedKey,
    scores: Sequence[Score],
    cells: Mapping[str, Array],
    trackers: Sequence[str],
    required: Sequence[tuple[str, Any, Verdict]],
) -> str:
    def of_score(column: str) -> list[Verdict]:
        return [verdict for of, _, verdict in required if of == column]

    return "".join(_chart(parameter, score, cells[score.column], trackers, of_score(score.column)) for score in scores)


def _with_required(
    means: MeanGrid, parameter: VariedKey, trackers: Sequence[str], required: Sequence[Verdict]
) -> MeanGrid:
    """Means with the intervals of their requirements, where a level is one condition, the same for all seeds."""
    low, high, index = means.low.copy(), means.high.copy(), parameter.index
    for verdict in required:
        level = index[0, verdict.condition]
        alone = level >= 0 and (index[:, verdict.condition] == level).all() and (index == level).sum() == len(index)
        if alone and verdict.tracker in trackers:
            place = level, trackers.index(verdict.tracker)
            ends = interval_of(verdict, float(means.mean[place]))
            low[place], high[place] = (np.nan if end is None else end for end in ends)
    return replace(means, low=low, high=high)


def tied(first: VariedKey, second: VariedKey) -> bool:
    """Whether a level of one decides that of the other, so that their effects cannot be told apart."""
    if first.binned or second.binned:
        return False
    pairs = set(zip(first.index.ravel().tolist(), second.index.ravel().tolist(), strict=True))
    return len(pairs) <= max(len({a for a, _ in pairs}), len({b for _, b in pairs}))


def _remark(parameter: VariedKey, plan: Plan, parameters: Sequence[VariedKey], scores: Sequence[Score]) -> str:
    remark = f"By {parameter.key}."
    if parameter.key in plan.drawn:
        remark += " It is drawn for each traffic seed, so each level has other seeds."
    if others := [other.key for other in parameters if other is not parameter and tied(parameter, other)]:
        remark += f" It changes together with {', '.join(others)}: this chart cannot say which of them does it."
    if dashed := [f"{score.name} {text}" for score in scores for text, _ in score.threshold_words]:
        remark += f" Dashed: {', '.join(dashed)}."
    return remark


def _chart(
    parameter: VariedKey, score: Score, cells: Array, trackers: Sequence[str], required: Sequence[Verdict]
) -> str:
    means = by_level(cells, parameter.index, len(parameter.levels))
    means = _with_required(means, parameter, trackers, required)
    title = f"{score.name} by {parameter.key}"
    if parameter.places is None:
        return forest(_rows(parameter, means), title, score.label, score.thresholds)
    return _lines(parameter, score, cells, means, title)


def _rows(parameter: VariedKey, means: MeanGrid) -> list[tuple[str, list[ChartInterval]]]:
    def intervals(place: int) -> list[ChartInterval]:
        ends = zip(means.mean[place].tolist(), means.low[place].tolist(), means.high[place].tolist(), strict=True)
        return [ChartInterval(*triple, series) for series, triple in enumerate(ends)]

    return [(level, intervals(place)) for place, level in enumerate(parameter.levels)]


def _lines(parameter: VariedKey, score: Score, cells: Array, means: MeanGrid, title: str) -> str:
    """Lines with bands through the levels; where numbers are drawn, dots of the seeds too."""
    dots = _dots(parameter, cells) if parameter.binned else []
    if parameter.binned:
        means = means.with_least(MIN_SEEDS)
    y = span_of(
        [*means.mean.flat, *means.low.flat, *means.high.flat, *score.thresholds, *(v for d in dots for v in d[1])]
    )
    x_values = [*parameter.on_axis, *(v for d in dots for v in d[0])]
    top = y[1] + 0.06 * (y[1] - y[0])  # the name of the axis stands there
    axes = charts.Axes(span_of(x_values, 0.06), (y[0], top), 470, 310, _x_ticks(parameter))
    content = "".join(marks(axes, *points, series, opacity=0.3) for series, points in enumerate(dots))
    for series in range(means.mean.shape[1]):
        finite = np.isfinite(means.low[:, series])
        x, low, high = parameter.on_axis[finite], means.low[finite, series], means.high[finite, series]
        if parameter.binned or len(x) > 1:
            content += band(axes, x, low, high, series)
        else:
            content += charts.whiskers(axes, x, low, high, charts.colour_of(series))
    for series in range(means.mean.shape[1]):
        finite = np.isfinite(means.mean[:, series])
        x, mean = parameter.on_axis[finite], means.mean[finite, series]
        content += charts.line(axes, x, mean, charts.colour_of(series)) + marks(axes, x, mean, series)
    for text, value in score.threshold_words:  # a dashed line, at which its side of what is right is written
        content += charts.line(axes, np.array(axes.x), np.full(2, value), "var(--ink)", dashed=True, width=1.4)
        right, height = axes.place(axes.x[1], value)
        content += f'<text x="{right - 4:.1f}" y="{height - 4:.1f}" text-anchor="end">{text}</text>'
    return axes.drawing(content, title, axis_of(parameter.key), score.label)


def _x_ticks(parameter: VariedKey) -> tuple[tuple[float, str], ...]:
    if not parameter.binned:
        return tuple(zip(parameter.on_axis.tolist(), parameter.levels, strict=True))
    if not parameter.log:
        return ()
    assert parameter.numbers is not None
    low, high = np.nanmin(parameter.numbers), np.nanmax(parameter.numbers)
    decades = [factor * 10.0**power for power in range(-12, 13) for factor in (1, 2, 5)]
    return tuple((float(np.log10(value)), f"{value:g}") for value in decades if low <= value <= high)


def _dots(parameter: VariedKey, cells: Array) -> list[tuple[Array, Array]]:
    """For each tracker the numbers of seeds and their scores, shape (n,) each; of many seeds evenly chosen ones."""
    assert parameter.numbers is not None
    x = mean_of(parameter.numbers, 1)
    x = np.log10(x) if parameter.log else x
    y = mean_of(cells, 1)
    every = -(-len(x) // MAX_DOTS)
    dots = []
    for tracker in range(y.shape[1]):
        rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y[:, tracker]))[::every]
        dots.append((x[rows], y[rows, tracker]))
    return dots


def _heat_maps(parameters: Sequence[VariedKey], score: Score, cells: Array, trackers: Sequence[str]) -> Iterator[Block]:
    pairs = [pair for pair in combinations(parameters, 2) if not tied(*pair)]
    remark = f" The first {MAX_PAIRS} of {len(pairs)} pairs are shown." if len(pairs) > MAX_PAIRS else ""
    about = f"Mean {score.label} over traffic seeds: the darker, the higher. Where cells differ in it, the number of "
    yield Heading("Two at a time")
    yield Text(f"{about}seeds stands in brackets.{remark}" if pairs else "", "soft")
    for first, second in pairs[:MAX_PAIRS]:
        index = first.index * len(second.levels) + second.index
        index = np.where((first.index < 0) | (second.index < 0), -1, index)
        shape = (len(first.levels), len(second.levels), len(trackers))
        means = by_level(cells, index, shape[0] * shape[1])
        span = span_of([*means.mean.flat], 0)
        mean, seeds = means.mean.reshape(shape), means.seeds.reshape(shape)
        yield Heading(f"{first.key} × {second.key}", 3)
        of_trackers = zip(np.moveaxis(mean, 2, 0), np.moveaxis(seeds, 2, 0), trackers, strict=True)
        yield BlockRow([_heat_map(first, second, *panel, span) for panel in of_trackers])


def _heat_map(
    first: VariedKey, second: VariedKey, mean: Array, seeds: Indices, name: str, span: tuple[float, float]
) -> Table:
    differ = len(np.unique(seeds)) > 1

    def cell(value: float, count: int) -> Cell:
        text = three_digits(value) + (f" ({count:,})" if differ and np.isfinite(value) else "")
        return Cell(text, (value - span[0]) / (span[1] - span[0]) if np.isfinite(value) else None)

    rows: list[Row] = [
        (level, *(cell(*pair) for pair in zip(values, counts, strict=True)))
        for level, values, counts in zip(first.levels, mean.tolist(), seeds.tolist(), strict=True)
    ]
    about = f"{name}: columns are {axis_of(second.key)}"
    return Table("", (axis_of(first.key), *second.levels), rows, about=about)
