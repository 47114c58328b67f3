"""What was learned, as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.learn.average_precision import NUMBERS
from modsim3d.learn.error_shares import ErrorShares
from modsim3d.learn.figures import CELLS, PAIRS, Figures
from modsim3d.learn.form import QUANTILES
from modsim3d.learn.gate_bias import Bias
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.learned import Learned
from modsim3d.learn.matching import Matched
from modsim3d.learn.resampling import Column
from modsim3d.learn.states import StateMap

Row = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Report:
    """Everything that is reported.

    Attributes:
        labelled: The sets.
        by_label: Matches label by label, for curves.
        conditions: Figures of each condition, the largest F1 first.
        states: Figures of each performance state.
        state_map: Which conditions make which state.
        learned: The detector.
        shares: What average precision is lost to.
        bias: Of the matching; None where it was not asked for.
        level: Of the intervals.
        beta: Of F-beta.
        matched_by: The rule in words.
        remarks: What the numbers have to be read with: entries left out, what matching hides.
    """

    labelled: LabelledSet
    by_label: Matched
    conditions: Sequence[Figures]
    states: Sequence[Figures]
    state_map: StateMap
    learned: Learned
    shares: ErrorShares
    bias: Bias | None
    level: float
    beta: float
    matched_by: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes:
        title: Above it.
        header: Names of the columns.
        rows: Cells.
    """

    title: str
    header: Row
    rows: tuple[Row, ...]


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
    """In the order of the thesis's chapter 8.

    Args:
        report: Of what.
        every: Also what a terminal has no room for: labels of each condition, errors of labels, covariances.
    """
    groups = [*report.conditions, *report.states] if _states_differ(report) else list(report.states)
    found = [_state_table(report)] if _states_differ(report) else []
    found += [_rates(report, groups), _errors(report, groups), _correlations(report, groups)]
    found += [_covariances(report, groups)] if every else []
    found.append(_curves(report, groups))
    detailed = groups if every else report.states
    if len(report.labelled.labels) > 1:
        found += [_labels(report, figures) for figures in detailed]
        found += [_label_errors(report, figures) for figures in detailed] if every else []
    found += [_confusion(report, figures) for figures in detailed]
    found.append(_shares(report))
    found.append(_parameters(report))
    if report.bias is not None:
        found.append(_bias(report.bias))
    return found


def _states_differ(report: Report) -> bool:
    return any(names != (state,) for state, names in report.state_map.states.items())


def _name(report: Report, figures: Figures) -> str:
    """A state's says that it is one, where there are conditions beside it."""
    state = _states_differ(report) and any(figures is each for each in report.states)
    return f"state {figures.name}" if state else figures.name


def _state_table(report: Report) -> Table:
    f1 = {figures.name: float(figures.columns["any F1"].estimate) for figures in report.conditions}
    rows = [
        (state, ", ".join(f"{name} ({f1[name]:.3f})" if name in f1 else name for name in names))
        for state, names in report.state_map.states.items()
    ]
    left = set(f1) - {name for names in report.state_map.states.values() for name in names}
    rows += [("in no state", ", ".join(f"{name} ({f1[name]:.3f})" for name in f1 if name in left))] if left else []
    return Table("Performance states, and their conditions with their F1", ("state", "conditions"), tuple(rows))


def _rates(report: Report, groups: Sequence[Figures]) -> Table:
    keys = ("precision", "recall", "F1", "F-beta", "FNR", "FDR")
    rows = tuple(
        (
            _name(report, figures),
            str(figures.images),
            *(_cell(figures.columns[f"any {key}"], report.level, figures.units, 3) for key in keys),
        )
        for figures in groups
    )
    header = ("condition", "images", "precision", "recall", "F1", f"F-{report.beta:g}", "FNR", "FDR")
    return Table("Precision, recall, F1, false negative and false discovery rate, whatever the label", header, rows)


def _labels(report: Report, figures: Figures) -> Table:
    rows = [
        (
            name,
            f"{figures.counts[:, place].sum():.0f}",
            *(
                _cell(figures.columns[key], report.level, figures.units, 3, place)
                for key in ("precision", "recall", "F1", "FNR", "FDR", NUMBERS[0])
            ),
        )
        for place, name in enumerate(report.labelled.labels)
    ]
    for mean in ("mean", "weighted"):
        keys = [f"{mean} {key}" for key in ("precision", "recall", "F1", "FNR", "FDR")]
        cells = [_cell(figures.columns[key], report.level, figures.units, 3) for key in keys]
        last = _cell(figures.columns[f"mean {NUMBERS[0]}"], report.level, figures.units, 3) if mean == "mean" else ""
        rows.append((f"{mean if mean == 'weighted' else 'arithmetic'} mean", "", *cells, last))
    header = ("label", "truths", "precision", "recall", "F1", "FNR", "FDR", "AP")
    return Table(f"Labels in {_name(report, figures)}: another label is a miss of one and a false one of the other",
                 header, tuple(rows))  # fmt: skip


def _errors(report: Report, groups: Sequence[Figures]) -> Table:
    rows = tuple(
        (
            _name(report, figures),
            *(
                _cell(figures.columns[f"error {key}"], report.level, figures.units, 1, place)
                for place in range(4)
                for key in ("mean", "std")
            ),
        )
        for figures in groups
    )
    return Table("Box errors in pixels: expected value and standard deviation", ("condition", *_ERROR_COLUMNS), rows)


def _correlations(report: Report, groups: Sequence[Figures]) -> Table:
    return _by_pair("Correlation coefficients of the box errors", report, groups, "error correlation", 2, PAIRS)


def _covariances(report: Report, groups: Sequence[Figures]) -> Table:
    return _by_pair("Covariances of the box errors in square pixels", report, groups, "error covariance", 1, CELLS)


def _by_pair(
    title: str,
    report: Report,
    groups: Sequence[Figures],
    key: str,
    digits: int,
    pairs: Sequence[tuple[int, int]],
) -> Table:
    """A column of each group, an entry for each pair of components."""
    places = range(len(pairs))
    rows = tuple(
        (_name(report, each), *(_cell(each.columns[key], report.level, each.units, digits, k) for k in places))
        for each in groups
    )
    return Table(title, ("condition", *(f"{ERROR_COMPONENTS[i]}, {ERROR_COMPONENTS[j]}" for i, j in pairs)), rows)


def _label_errors(report: Report, figures: Figures) -> Table:
    rows = tuple(
        (
            name,
            *(
                _cell(figures.columns[f"error {key} of labels"], report.level, figures.units, 1, label, place)
                for place in range(4)
                for key in ("mean", "std")
            ),
        )
        for label, name in enumerate(report.labelled.labels)
    )
    title = f"Box errors in pixels by what was there, in {_name(report, figures)}"
    return Table(title, ("label", *_ERROR_COLUMNS), rows)


def _curves(report: Report, groups: Sequence[Figures]) -> Table:
    extra = [key for key in ("confidence cross-entropy", "label cross-entropy") if key in groups[0].columns]
    rows = tuple(
        (
            _name(report, figures),
            *(_cell(figures.columns[f"mean {key}"], report.level, figures.units, 3) for key in NUMBERS),
            *(_cell(figures.columns[key], report.level, figures.units, 3) for key in extra if key in figures.columns),
        )
        for figures in groups
    )
    return Table("Mean average precision over labels, every detection counted", ("condition", *NUMBERS, *extra), rows)


def _confusion(report: Report, figures: Figures) -> Table:
    names, k = report.labelled.labels, len(report.labelled.labels)
    rows = []
    for row, name in enumerate([*names, "missed"]):
        cells = [
            f"{figures.counts[row, column]:.0f}  "
            + _cell(figures.columns["confusion"], report.level, figures.units, 3, row, column)
            for column in range(k)
        ]
        last = ""
        if row < k:
            share = _cell(figures.columns["false labels"], report.level, figures.units, 3, row)
            last = f"{figures.counts[row, k]:.0f}  {share}"
        rows.append((name, *cells, last))
    title = f"Confusion matrix of {_name(report, figures)}: detected as, by what was there; counts and probabilities"
    return Table(title, ("", *names, "background"), tuple(rows))


def _shares(report: Report) -> Table:
    rows = tuple((name, str(report.shares.counts[name]), f"{gain:.2f}") for name, gain in report.shares.gains.items())
    title = f"What mean average precision, {100 * report.shares.average_precision:.1f} points, is lost to"
    return Table(title, ("error", "number", "points gained if mended"), rows)


def _parameters(report: Report) -> Table:
    rows: list[Row] = []
    learned = report.learned
    intervals, values = learned.intervals(report.level), learned.values()
    values = values | {"transition_matrix": learned.transitions.matrix}
    for path in sorted(values, key=lambda path: (path.startswith("states."), path)):
        if ".confusion" in path or ".false_positive_labels" in path:
            continue  # they have tables of their own
        low, high = intervals[path]
        value = np.asarray(values[path])
        for place in np.ndindex(*value.shape):
            name = _number(learned, path, place)
            ends = f"{float(np.asarray(low)[place]):.4g} to {float(np.asarray(high)[place]):.4g}"
            rows.append((name, f"{float(value[place]):.4g}", ends))
    return Table("Numbers of the detector file", ("number", "learned", f"{report.level:.0%} interval"), tuple(rows))


def _number(learned: Learned, path: str, place: tuple[int, ...]) -> str:
    """A number by its path and, in words where there are any, its place."""
    form, kind = learned.form, path.rpartition(".")[2]
    if kind == "box_error_correlation":
        return f"{path}[{','.join(ERROR_COMPONENTS[k] for k in PAIRS[place[0]])}]"
    if kind.startswith("box_error"):
        unit = form.units[path.removeprefix("states.").rpartition(".")[0]].split()[-1]
        return f"{path}[{ERROR_COMPONENTS[place[0]]}] ({unit})"
    if kind in ("confusion", "false_positive_labels"):
        seen, *there = ([*form.labels, "missed"][k] for k in place)
        return f"{path}[{seen}{' from ' + there[0] if there else ''}]"
    if kind == "false_positives_per_image" and form.clutter != kind.removeprefix("false_positives_"):
        return f"{path} (not written)"
    if kind == "transition_matrix":
        return f"{path}[{form.states[place[0]]} from {form.states[place[1]]}]"
    if kind == "px":
        return f"{path}[{('width', 'height')[place[0]]}]"
    if kind == "quantiles":
        return f"{path}[{place[0] / (QUANTILES - 1):.0%}]"
    return path + "".join(f"[{k}]" for k in place)


def _bias(bias: Bias) -> Table:
    rows: list[tuple[float, Row]] = []
    values, corrected = bias.learned.values(), bias.corrected()
    for path, shift in bias.shifts.items():
        sure = bias.significant(path)
        for place in zip(*np.nonzero(np.atleast_1d(sure)), strict=True):
            where = place if np.ndim(shift) else ()
            strength = abs(float(shift[where])) / float(bias.errors[path][where])
            name = _number(bias.learned, path, where)
            numbers = [float(each[where]) for each in (values[path], bias.again[path], corrected[path])]
            rows.append((strength, (name, *(f"{number:.4g}" for number in numbers), f"{strength:.1f}")))
    rows.sort(key=lambda row: -row[0])
    header = ("number", "learned", "learned again", "corrected", "standard errors")
    title = "Bias of the matching, by simulating what was learned and learning again"
    return Table(title, header, tuple(row for _, row in rows[:40]) or (("none is sure", "", "", "", ""),))


NEVER_LEARNED = (
    "Never learned: duplicates, merged and split boxes (they count as false or missed), false positives that persist, "
    "box errors with both a fixed and a growing part, confidence that follows size or visibility."
)


def lead(report: Report) -> str:
    """What it rests on, in one sentence."""
    learned, labelled = report.learned, report.labelled
    drawn = f"runs of {learned.run_s:.3g} s" if learned.run_s else "images"
    return (
        f"{len(labelled.images)} images, {len(labelled.annotations)} truths, {len(labelled.results)} detections; "
        f"matched by {report.matched_by}, confidence at least {learned.form.threshold:g}; {report.level:.0%} intervals "
        f"by bootstrap over {learned.units['']} {drawn}."
    )
