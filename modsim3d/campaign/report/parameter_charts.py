"""Scores against what is varied: lines with bands over numbers, intervals over names, and heat maps of pairs."""

from __future__ import annotations

import html
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array, Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.report.cells import Estimates, by_level, mean_of, seed_cells
from modsim3d.campaign.report.parameters import Parameter, parameters_of
from modsim3d.campaign.report.words import Score, axis_of, number, required_scores
from modsim3d.campaign.results.means import LEVEL
from modsim3d.view.pages import charts, page
from modsim3d.view.pages.intervals import Interval, band, forest, legend, marks, span_of

MOST_SCORES, MOST_PARAMETERS, MOST_PAIRS, MOST_SHOWN_TRACKERS = 3, 8, 10, 6
CHART_PX = 500
"""Width of a chart with its margin."""
MOST_DOTS = 400
"""Of a tracker in a chart."""
LEAST_SEEDS = 3
"""A mean of drawn numbers rests on at least so many seeds."""


def parameter_sections(plan: Plan, table: pa.Table) -> list[str]:
    """Charts of each required score against each parameter, and heat maps of the first score."""
    parameters, scores = parameters_of(plan, table), required_scores(plan)[:MOST_SCORES]
    trackers = [each.label for each in plan.keys.trackers][:MOST_SHOWN_TRACKERS]
    if not parameters or not len(table):
        return []
    cells = {score.column: seed_cells(plan, table, score.column)[:, :, : len(trackers)] for score in scores}
    caption = (
        f"Mean over traffic seeds with its {100 * LEVEL:g} % interval by Student's t; the value of a seed is the mean "
        "over all its runs at that level, whatever else is varied."
    )
    parts = [page.heading("Scores against what is varied"), page.paragraph(caption, "soft"), legend(trackers)]
    parts.append('<div style="display: flex; flex-wrap: wrap; gap: 0 1.5rem">')
    for parameter in parameters[:MOST_PARAMETERS]:
        drawings = [_chart(parameter, score, cells[score.column], trackers) for score in scores]
        figure = charts.figure(drawings, _remark(parameter, plan, parameters, scores))
        parts.append(f'<div style="max-width: {CHART_PX * len(scores)}px">{figure}</div>')
    parts.append("</div>")
    if len(parameters) > MOST_PARAMETERS:
        rest = ", ".join(each.key for each in parameters[MOST_PARAMETERS:])
        parts.append(page.paragraph(f"Not shown: {rest}.", "soft"))
    return parts + _heat_maps(parameters, scores[0], cells[scores[0].column], trackers)


def tied(first: Parameter, second: Parameter) -> bool:
    """Whether a level of one decides that of the other, so that their effects cannot be told apart."""
    if first.binned or second.binned:
        return False
    found = set(zip(first.index.ravel().tolist(), second.index.ravel().tolist(), strict=True))
    return len(found) <= max(len({a for a, _ in found}), len({b for _, b in found}))


def _remark(parameter: Parameter, plan: Plan, parameters: Sequence[Parameter], scores: Sequence[Score]) -> str:
    said = f"By {parameter.key}."
    if parameter.key in plan.drawn:
        said += " It is drawn for each traffic seed, so each level has other seeds."
    if others := [each.key for each in parameters if each is not parameter and tied(parameter, each)]:
        said += f" It changes together with {', '.join(others)}: this chart cannot say which of them does it."
    if dashed := [f"{score.name} {text}" for score in scores for text, _ in score.threshold_words]:
        said += f" Dashed: {', '.join(dashed)}."
    return said


def _chart(parameter: Parameter, score: Score, cells: Array, trackers: Sequence[str]) -> str:
    found = by_level(cells, parameter.index, len(parameter.levels))
    title = f"{score.name} by {parameter.key}"
    if parameter.places is None:
        return forest(_rows(parameter, found), title, score.label, score.thresholds)
    return _lines(parameter, score, cells, found, title)


def _rows(parameter: Parameter, found: Estimates) -> list[tuple[str, list[Interval]]]:
    return [
        (
            level,
            [
                Interval(float(found.mean[place, t]), float(found.low[place, t]), float(found.high[place, t]), t)
                for t in range(found.mean.shape[1])
            ],
        )
        for place, level in enumerate(parameter.levels)
    ]


def _lines(parameter: Parameter, score: Score, cells: Array, found: Estimates, title: str) -> str:
    """Lines with bands through the levels; where numbers are drawn, dots of the seeds too."""
    dots = _dots(parameter, cells) if parameter.binned else []
    if parameter.binned:
        found = found.with_least(LEAST_SEEDS)
    y = span_of(
        [*found.mean.flat, *found.low.flat, *found.high.flat, *score.thresholds, *(v for d in dots for v in d[1])]
    )
    x_values = [*parameter.on_axis, *(v for d in dots for v in d[0])]
    top = y[1] + 0.06 * (y[1] - y[0])  # the name of the axis stands there
    axes = charts.Axes(span_of(x_values, 0.06), (y[0], top), 470, 310, _x_ticks(parameter))
    content = "".join(marks(axes, *each, series, opacity=0.3) for series, each in enumerate(dots))
    for series in range(found.mean.shape[1]):
        known = np.isfinite(found.low[:, series])
        x, low, high = parameter.on_axis[known], found.low[known, series], found.high[known, series]
        if parameter.binned or len(x) > 1:
            content += band(axes, x, low, high, series)
        else:
            content += charts.whiskers(axes, x, low, high, charts.colour_of(series))
    for series in range(found.mean.shape[1]):
        known = np.isfinite(found.mean[:, series])
        x, mean = parameter.on_axis[known], found.mean[known, series]
        content += charts.line(axes, x, mean, charts.colour_of(series)) + marks(axes, x, mean, series)
    return _with_thresholds(axes, content, score, title, parameter)


def _with_thresholds(axes: charts.Axes, content: str, score: Score, title: str, parameter: Parameter) -> str:
    """The drawing with a dashed line at each threshold, which its side of what is right is written at."""
    for text, value in score.threshold_words:
        content += charts.line(axes, np.array(axes.x), np.full(2, value), "var(--ink)", dashed=True, width=1.4)
        x, y = axes.place(axes.x[1], value)
        content += f'<text x="{x - 4:.1f}" y="{y - 4:.1f}" text-anchor="end">{text}</text>'
    return axes.drawing(content, title, axis_of(parameter.key), score.label)


def _x_ticks(parameter: Parameter) -> tuple[tuple[float, str], ...]:
    if not parameter.binned:
        return tuple(zip(parameter.on_axis.tolist(), parameter.levels, strict=True))
    if not parameter.log:
        return ()
    assert parameter.numbers is not None
    low, high = np.nanmin(parameter.numbers), np.nanmax(parameter.numbers)
    decades = [factor * 10.0**power for power in range(-12, 13) for factor in (1, 2, 5)]
    return tuple((float(np.log10(value)), f"{value:g}") for value in decades if low <= value <= high)


def _dots(parameter: Parameter, cells: Array) -> list[tuple[Array, Array]]:
    """For each tracker the numbers of seeds and their scores, shape (n,) each; of many seeds evenly chosen ones."""
    assert parameter.numbers is not None
    x = mean_of(parameter.numbers, 1)
    x = np.log10(x) if parameter.log else x
    y = mean_of(cells, 1)
    every = -(-len(x) // MOST_DOTS)
    found = []
    for tracker in range(y.shape[1]):
        known = np.flatnonzero(np.isfinite(x) & np.isfinite(y[:, tracker]))[::every]
        found.append((x[known], y[known, tracker]))
    return found


def _heat_maps(parameters: Sequence[Parameter], score: Score, cells: Array, trackers: Sequence[str]) -> list[str]:
    pairs = [pair for pair in combinations(parameters, 2) if not tied(*pair)]
    if not pairs:
        return []
    shown = pairs[:MOST_PAIRS]
    remark = f" The first {MOST_PAIRS} of {len(pairs)} pairs are shown." if len(pairs) > MOST_PAIRS else ""
    parts = [
        page.heading("Two at a time"),
        page.paragraph(
            f"Mean {score.label} over traffic seeds: the darker, the higher. Where cells differ in it, a small number "
            f"is the number of seeds.{remark}",
            "soft",
        ),
    ]
    for first, second in shown:
        index = first.index * len(second.levels) + second.index
        index = np.where((first.index < 0) | (second.index < 0), -1, index)
        shape = (len(first.levels), len(second.levels), len(trackers))
        found = by_level(cells, index, shape[0] * shape[1])
        parts.append(f"<h3>{html.escape(f'{first.key} × {second.key}')}</h3>")
        span = span_of([*found.mean.flat], 0)
        parts.append('<div style="display: flex; flex-wrap: wrap; gap: 0 2.5rem">')
        for place, tracker in enumerate(trackers):
            mean, seeds = found.mean.reshape(shape)[:, :, place], found.seeds.reshape(shape)[:, :, place]
            parts.append(_heat_map(first, second, mean, seeds, span, tracker))
        parts.append("</div>")
    return parts


def _heat_map(
    first: Parameter, second: Parameter, mean: Array, seeds: Indices, span: tuple[float, float], name: str
) -> str:
    head = "".join(f'<th class="number">{html.escape(level)}</th>' for level in second.levels)
    lines = [f"<tr><th>{html.escape(axis_of(first.key))}</th>{head}</tr>"]
    differ = len(np.unique(seeds)) > 1
    for level, values, counts in zip(first.levels, mean.tolist(), seeds.tolist(), strict=True):
        cells = "".join(_cell(value, count if differ else 0, span) for value, count in zip(values, counts, strict=True))
        lines.append(f"<tr><th>{html.escape(level)}</th>{cells}</tr>")
    title = f"{name}: columns are {axis_of(second.key)}"
    table = page.scrolling("<table>" + "".join(lines) + "</table>")
    return f'<div style="min-width: 0">{page.paragraph(title, "soft")}{table}</div>'


def _cell(value: float, seeds: int, span: tuple[float, float]) -> str:
    if not np.isfinite(value):
        return f'<td class="number">{number(None)}</td>'
    share = (value - span[0]) / (span[1] - span[0])
    shade = f"color-mix(in srgb, {charts.COLOURS[0]} {5 + 55 * share:.0f}%, transparent)"
    return f'<td class="number" style="background:{shade};padding:0.25rem 0.6rem">{number(value)}' + (
        f' <small class="soft">{seeds:,}</small></td>' if seeds else "</td>"
    )
