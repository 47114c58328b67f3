"""What was learned, as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS, stationary_shares
from modsim3d.learn.box_errors import error_usage
from modsim3d.learn.box_errors.error_moments import CELLS, ErrorMoments
from modsim3d.learn.figures.figures import AveragePrecisions, Figures, Rates
from modsim3d.learn.gate.gate_bias import Bias
from modsim3d.learn.numbers.resampling import Column
from modsim3d.learn.parts import models_and_learners
from modsim3d.learn.told.report import Report

Row = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A title, the names of the columns, and rows of cells."""

    title: str
    header: Row
    rows: tuple[Row, ...]


_RATES = ("precision", "recall", "F1", "FNR", "FDR")
_AVERAGE_PRECISIONS = ("AP, all points", "AP, 11 points", "AP, 101 points", "AUC")
_ERROR_COLUMNS = tuple(f"{name} {key}" for name in ("x", "y", "width", "height") for key in ("exp", "std"))


def _cell(column: Column, level: float, units: int, digits: int, *place: int) -> str:
    """An estimate with its interval."""
    low, high = column.interval(level, units)
    value, low_, high_ = (float(np.asarray(each)[place]) for each in (column.estimate, low, high))
    if not np.isfinite(value):
        return "–"
    if not (np.isfinite(low_) and np.isfinite(high_)):
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} [{low_:.{digits}f}, {high_:.{digits}f}]"


def tables(report: Report, every: bool = False) -> list[Table]:
    """All tables in the order of the thesis's chapter 8.

    `every` adds what a terminal has no room for: labels of each condition, errors of labels, covariances.
    """
    groups = [*report.conditions, *report.states] if report.states_differ else list(report.states)
    detailed = groups if every else report.states
    several = len(report.labelled.labels) > 1
    found = [_state_table(report)] if report.states_differ else []
    found += [_rates(report, groups), _errors(report, groups), _correlations(report, groups), _used(report)]
    found += [_covariances(report, groups)] if every else []
    found += _curves(report, groups)
    found += [_labels(report, figures) for figures in detailed if several]
    found += [_label_errors(report, figures) for figures in detailed if several and every]
    found += [_confusion(report, figures) for figures in detailed]
    found += [*_shares(report), _parameters(report), *_long_run(report)]
    found += [] if report.bias is None else [_bias(report.bias)]
    return [*found, _models()]


def _state_table(report: Report) -> Table:
    f1 = {figures.name: float(figures.any_label.f1.estimate) for figures in report.conditions}
    rows = [
        (state, ", ".join(f"{name} ({f1[name]:.3f})" if name in f1 else name for name in names))
        for state, names in report.state_map.states.items()
    ]
    left = set(f1) - {name for names in report.state_map.states.values() for name in names}
    rows += [("in no state", ", ".join(f"{name} ({f1[name]:.3f})" for name in f1 if name in left))] if left else []
    return Table("Performance states, and their conditions with their F1", ("state", "conditions"), tuple(rows))


def _rates(report: Report, groups: Sequence[Figures]) -> Table:
    rows = tuple(
        (
            report.name(figures),
            str(figures.images),
            *(_cell(column, report.level, figures.units, 3) for column in figures.any_label),
        )
        for figures in groups
    )
    header = ("condition", "images", "precision", "recall", "F1", f"F-{report.beta:g}", "FNR", "FDR")
    return Table("Precision, recall, F1, false negative and false discovery rate, whatever the label", header, rows)


def _labels(report: Report, figures: Figures) -> Table:
    def cells(columns: Sequence[Column], *place: int) -> list[str]:
        return [_cell(column, report.level, figures.units, 3, *place) for column in columns]

    def row(rates: Rates) -> tuple[Column, ...]:
        return (*rates[:3], *rates[4:])  # without F-beta

    def area(of: AveragePrecisions | None) -> tuple[Column, ...]:
        return () if of is None else (of.all_points,)

    columns, last = [*row(figures.of_labels), *area(figures.average_precision)], ("AP",) * report.labelled.scored
    rows = [
        (name, f"{figures.counts[:, place].sum():.0f}", *cells(columns, place))
        for place, name in enumerate(report.labelled.labels)
    ]
    rows.append(("arithmetic mean", "", *cells([*row(figures.mean), *area(figures.mean_average_precision)])))
    rows.append(("weighted mean", "", *cells(row(figures.weighted)), *("" for _ in last)))
    title = f"Labels in {report.name(figures)}: another label is a miss of one and a false one of the other"
    return Table(title, ("label", "annotations", *_RATES, *last), tuple(rows))


def _error_cells(report: Report, figures: Figures, moments: ErrorMoments) -> list[str]:
    columns = (moments.mean, moments.std)
    return [_cell(column, report.level, figures.units, 1, k) for k in range(4) for column in columns]


def _errors(report: Report, groups: Sequence[Figures]) -> Table:
    rows = tuple((report.name(each), *_error_cells(report, each, each.errors)) for each in groups)
    return Table("Box errors in pixels: expected value and standard deviation", ("condition", *_ERROR_COLUMNS), rows)


def _correlations(report: Report, groups: Sequence[Figures]) -> Table:
    title = "Correlation coefficients of the box errors"
    return _by_pair(title, report, groups, lambda figures: figures.errors.correlation, 2, ERROR_PAIRS)


def _covariances(report: Report, groups: Sequence[Figures]) -> Table:
    title = "Covariances of the box errors in square pixels"
    return _by_pair(title, report, groups, lambda figures: figures.error_covariance, 1, CELLS)


def _by_pair(
    title: str,
    report: Report,
    groups: Sequence[Figures],
    column: Callable[[Figures], Column],
    digits: int,
    pairs: Sequence[tuple[int, int]],
) -> Table:
    """A row for each group, a column for each pair of components of the box error."""
    rows = tuple(
        (report.name(each), *(_cell(column(each), report.level, each.units, digits, k) for k in range(len(pairs))))
        for each in groups
    )
    return Table(title, ("condition", *(f"{ERROR_COMPONENTS[i]}, {ERROR_COMPONENTS[j]}" for i, j in pairs)), rows)


def _label_errors(report: Report, figures: Figures) -> Table:
    rows = tuple(
        (name, *_error_cells(report, figures, moments))
        for name, moments in zip(report.labelled.labels, figures.errors_of_labels, strict=True)
    )
    title = f"Box errors in pixels by what was there, in {report.name(figures)}"
    return Table(title, ("label", *_ERROR_COLUMNS), rows)


def _curves(report: Report, groups: Sequence[Figures]) -> list[Table]:
    """The table of average precision; none without confidences."""
    rows = []
    for figures in groups:
        if figures.mean_average_precision is None or figures.confidence_entropy is None:
            return []
        entropies = [figures.confidence_entropy, *([figures.label_entropy] if figures.label_entropy else [])]
        columns = [*figures.mean_average_precision, *entropies]
        rows.append((report.name(figures), *(_cell(column, report.level, figures.units, 3) for column in columns)))
    extra = ("confidence cross-entropy", *(("label cross-entropy",) if groups[0].label_entropy else ()))
    title = f"Mean average precision over labels, every detection counted, matched by {report.curves_matched_by}"
    return [Table(title, ("condition", *_AVERAGE_PRECISIONS, *extra), tuple(rows))]


def _confusion(report: Report, figures: Figures) -> Table:
    names, k = report.labelled.labels, len(report.labelled.labels)
    rows = []
    for row, name in enumerate([*names, "missed"]):
        cells = [
            f"{figures.counts[row, column]:.0f}  "
            + _cell(figures.confusion, report.level, figures.units, 3, row, column)
            for column in range(k)
        ]
        last = ""
        if row < k:
            last = f"{figures.counts[row, k]:.0f}  {_cell(figures.false_labels, report.level, figures.units, 3, row)}"
        rows.append((name, *cells, last))
    title = f"Confusion matrix of {report.name(figures)}: detected as, by what was there; counts and probabilities"
    return Table(title, ("", *names, "background"), tuple(rows))


def _shares(report: Report) -> list[Table]:
    """The table of what average precision is lost to; none without confidences."""
    if report.shares is None:
        return []
    rows = tuple((each.kind.value, str(each.count), f"{each.gain_points:.2f}") for each in report.shares.shares)
    points = f"{100 * report.shares.average_precision:.1f} points"
    title = f"What mean average precision, {points}, is lost to, matched by {report.curves_matched_by}"
    return [Table(title, ("error", "number", "points gained if corrected"), rows)]


def _parameters(report: Report) -> Table:
    intervals = [each for each in report.learned.intervals(report.level) if not each.key.own_table]
    rows = []
    for each in sorted(intervals, key=lambda each: (each.key.state is not None, each.key.path)):
        for place in np.ndindex(*each.estimate.shape):
            value, low, high = (float(np.asarray(ends)[place]) for ends in (each.estimate, each.low, each.high))
            rows.append((each.key.at(place), *_number(value, low, high)))
    return Table("Numbers of the detector file", ("number", "learned", f"{report.level:.0%} interval"), tuple(rows))


def _long_run(report: Report) -> list[Table]:
    """The table of the chain's stationary shares; none without a chain."""
    transitions, states = report.learned.transitions, report.learned.observed.states
    if not transitions.observed or len(states) == 1:
        return []
    shares = stationary_shares(transitions.matrix)  # every state follows every other, so there are such
    rows = tuple((state, f"{share:.1%}") for state, share in zip(states, shares, strict=True))
    return [Table("States in the long run, by the learned transition matrix", ("state", "share of time"), rows)]


def _number(value: float, low: float, high: float) -> tuple[str, str]:
    """A number and its interval; a dash for what the data do not tell."""
    if not np.isfinite(value):
        return "–", "–"
    told = np.isfinite(low) and np.isfinite(high)
    return f"{value:.4g}", f"{low:.4g} to {high:.4g}" if told else "–"


def _bias(bias: Bias) -> Table:
    rows: list[tuple[float, Row]] = []
    for each in bias.shifts:
        for found in zip(*np.nonzero(np.atleast_1d(bias.significant(each))), strict=True):
            place = found if np.ndim(each.shift) else ()
            strength = abs(float(each.shift[place])) / float(each.error[place])
            numbers = [float(values[place]) for values in (each.entry.estimate, each.again, each.corrected)]
            cells = (each.entry.key.at(place), *(f"{number:.4g}" for number in numbers), f"{strength:.1f}")
            rows.append((strength, cells))
    rows.sort(key=lambda row: -row[0])
    header = ("number", "learned", "learned again", "corrected", "standard errors")
    title = "Bias of the matching, by simulating what was learned and learning again"
    return Table(title, header, tuple(row for _, row in rows[:40]) or (("none is sure", "", "", "", ""),))


def _used(report: Report) -> Table:
    rows = tuple(each.cells for each in report.learned.numbers.box_errors.used)
    return Table(error_usage.TITLE, error_usage.HEADER, rows)


def _models() -> Table:
    rows = tuple(
        (part, name, "not learned" if learner is None else "learned") for part, name, learner in models_and_learners()
    )
    return Table("Models that can be learned", ("part", "model", "estimate"), rows)


NEVER_LEARNED = (
    "Never learned: gates, which are hard limits, and confidence as a precision-recall curve. Persistence, what "
    "vessels keep, slopes of confidence, second boxes, merges and splits are not in the table of models; they are "
    "learned where the data show them."
)
