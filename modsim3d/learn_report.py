"""What was learned, as tables for the terminal and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.learn.average_precision import NUMBERS, Curve, Ranking
from modsim3d.learn.error_shares import ErrorShares
from modsim3d.learn.figures import PAIRS, Figures, errors_px
from modsim3d.learn.gate_bias import Bias
from modsim3d.learn.labelled import Labelled
from modsim3d.learn.learned import Learned
from modsim3d.learn.matching import Matched
from modsim3d.learn.resampling import Column
from modsim3d.learn.states import StateMap
from modsim3d.view import learn_figures as pictures
from modsim3d.view import page

Array = NDArray[np.float64]
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
    """

    labelled: Labelled
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


def _cell(column: Column, level: float, units: int, digits: int, *place: int) -> str:
    """An estimate with its interval."""
    low, high = column.interval(level, units)
    value, low_, high_ = (float(np.asarray(each)[place]) for each in (column.estimate, low, high))
    if not np.isfinite(value):
        return "–"
    if not (np.isfinite(low_) and np.isfinite(high_)):
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} [{low_:.{digits}f}, {high_:.{digits}f}]"


def tables(report: Report) -> list[Table]:
    """All of them, in the order of the thesis's chapter 8."""
    groups = [*report.conditions, *(report.states if _states_differ(report) else [])]
    found = [_rates(report, groups), _errors(report, groups), _correlations(report, groups), _curves(report, groups)]
    if len(report.labelled.labels) > 1:
        found += [_labels(report, figures) for figures in report.states]
    found += [_confusion(report, figures) for figures in report.states]
    found.append(_shares(report))
    found.append(_parameters(report))
    if report.bias is not None:
        found.append(_bias(report.bias))
    return found


def _states_differ(report: Report) -> bool:
    return any(names != (state,) for state, names in report.state_map.states.items())


def _rates(report: Report, groups: Sequence[Figures]) -> Table:
    keys = ("precision", "recall", "F1", "F-beta", "FNR", "FDR")
    rows = tuple(
        (
            figures.name,
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
    return Table(f"Labels in '{figures.name}': another label is a miss of one and a false one of the other",
                 header, tuple(rows))  # fmt: skip


def _errors(report: Report, groups: Sequence[Figures]) -> Table:
    rows = tuple(
        (
            figures.name,
            *(
                _cell(figures.columns[f"error {key}"], report.level, figures.units, 1, place)
                for place in range(4)
                for key in ("mean", "std")
            ),
        )
        for figures in groups
    )
    names = ("x", "y", "width", "height")
    header = ("condition", *(f"{name} {key}" for name in names for key in ("exp", "std")))
    return Table("Box errors in pixels: expected value and standard deviation", header, rows)


def _correlations(report: Report, groups: Sequence[Figures]) -> Table:
    rows = tuple(
        (
            figures.name,
            *(
                _cell(figures.columns["error correlation"], report.level, figures.units, 2, place)
                for place in range(len(PAIRS))
            ),
        )
        for figures in groups
    )
    header = ("condition", *(f"{ERROR_COMPONENTS[i]}, {ERROR_COMPONENTS[j]}" for i, j in PAIRS))
    return Table("Correlation coefficients of the box errors", header, rows)


def _curves(report: Report, groups: Sequence[Figures]) -> Table:
    extra = [key for key in ("confidence cross-entropy", "label cross-entropy") if key in groups[0].columns]
    rows = tuple(
        (
            figures.name,
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
    return Table(f"Confusion matrix of '{figures.name}': detected as, by what was there; counts and probabilities",
                 ("", *names, "background"), tuple(rows))  # fmt: skip


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
            name = path + "".join(f"[{k}]" for k in place)
            ends = f"{float(np.asarray(low)[place]):.4g} to {float(np.asarray(high)[place]):.4g}"
            rows.append((name, f"{float(value[place]):.4g}", ends))
    return Table("Numbers of the detector file", ("number", "learned", f"{report.level:.0%} interval"), tuple(rows))


def _bias(bias: Bias) -> Table:
    rows: list[tuple[float, Row]] = []
    values, corrected = bias.learned.values(), bias.corrected()
    for path, shift in bias.shifts.items():
        sure = bias.significant(path)
        for place in zip(*np.nonzero(np.atleast_1d(sure)), strict=True):
            where = place if np.ndim(shift) else ()
            strength = abs(float(shift[where])) / float(bias.errors[path][where])
            name = path + "".join(f"[{k}]" for k in where)
            numbers = [float(each[where]) for each in (values[path], bias.again[path], corrected[path])]
            rows.append((strength, (name, *(f"{number:.4g}" for number in numbers), f"{strength:.1f}")))
    rows.sort(key=lambda row: -row[0])
    header = ("number", "learned", "learned again", "corrected", "standard errors")
    title = "Bias of the matching, by simulating what was learned and learning again"
    return Table(title, header, tuple(row for _, row in rows[:40]) or (("none is sure", "", "", "", ""),))


def lead(report: Report) -> str:
    """What it rests on, in one sentence."""
    learned, labelled = report.learned, report.labelled
    drawn = f"runs of {learned.run_s:.3g} s" if learned.run_s else "images"
    return (
        f"{len(labelled.images)} images, {len(labelled.truth)} truths, {len(labelled.found)} detections; matched by "
        f"{report.matched_by}, confidence at least {learned.form.threshold:g}; {report.level:.0%} intervals by "
        f"bootstrap over {learned.units['']} {drawn}."
    )


def write_page(report: Report, path: Path) -> None:
    """The page, in one file."""
    body = [page.paragraph(lead(report), "lead"), f"<style>{_STYLE}</style>"]
    states = "; ".join(f"{name} = {', '.join(names)}" for name, names in report.state_map.states.items())
    body.append(page.paragraph(f"Performance states: {states}."))
    body += [page.heading("Precision against recall"), *_curve_pictures(report)]
    body += [page.heading("Box errors"), *_scatter(report)]
    body += [page.heading("Confusion matrices"), *_matrices(report)]
    gains = {name: max(gain, 0.0) for name, gain in report.shares.gains.items()}
    body += [page.heading("What average precision is lost to"), pictures.bars(gains, "points", _SHARES)]
    for table in tables(report):
        body += [page.heading(table.title), '<div class="wide">', page.table(table.rows, table.header), "</div>"]
    notes = report.learned.form.notes
    body.append(page.heading("Left simple"))
    body += [page.paragraph(note) for note in notes] or [page.paragraph("Nothing: there was enough of everything.")]
    body.append(page.paragraph(_POINTS, "soft"))
    path.write_text(page.page("A detector, learned", body), encoding="utf-8")


_STYLE = (
    "body { max-width: 84rem; } .plots { display: flex; flex-wrap: wrap; gap: 1rem; } "
    ".plots figure { width: 25rem; margin: 0; } .plots svg { width: 100%; height: auto; } "
    "td.number { padding-left: 0.9rem; } .wide { overflow-x: auto; } .wide td { white-space: nowrap; }"
)
_SHARES = (
    "Points of mean average precision that mending one kind of error would gain (Bolya et al., 2020): classification, "
    "localisation, both, duplicate, background, missed."
)
_POINTS = (
    "Average precision: by all points it is the area under the interpolated curve; COCO's tools average that curve at "
    "101 levels of recall, and the 11-point form at 11, so the three differ by up to a step of the curve."
)


def _curve_pictures(report: Report) -> list[str]:
    curves = []
    for label, name in enumerate(report.labelled.labels):
        of_state: dict[str, tuple[Array, Array]] = {}
        for index, state in enumerate(report.learned.form.states):
            images = report.learned.observed.image_state == index
            curve: Curve | None = Ranking.of(report.labelled, report.by_label, label, images).curve()
            if curve is not None and len(curve.recall):
                of_state[f"{state}: AP {curve.all_points():.3f}"] = curve.recall, curve.interpolated
        curves.append(pictures.precision_recall(of_state, f"{name}: largest precision at each recall or beyond."))
    return ['<div class="plots">', *curves, "</div>"]


def _scatter(report: Report) -> list[str]:
    pairs = report.learned.observed.pairs()
    detection = report.learned.observed.detection[~report.learned.observed.missed]
    error = errors_px(report.labelled.found.boxes_px[detection], pairs.truth_px)
    plots = []
    for (i, j), what in (((0, 1), "centres"), ((2, 3), "sizes")):
        groups = {
            state: error[pairs.state == index][:, [i, j]]
            for index, state in enumerate(report.learned.form.states)
            if np.any(pairs.state == index)
        }
        x, y = ERROR_COMPONENTS[i], ERROR_COMPONENTS[j]
        caption = f"Errors of {what}; ellipses hold 95 % of normal errors with the same mean and covariance."
        plots.append(pictures.error_scatter(groups, f"{x} in px", f"{y} in px", caption))
    return ['<div class="plots">', *plots, "</div>"]


def _matrices(report: Report) -> list[str]:
    parts = []
    for figures in report.states:
        k = len(report.labelled.labels)
        shares = np.full((k + 1, k + 1), np.nan)
        shares[:, :k] = figures.columns["confusion"].estimate
        shares[:k, k] = figures.columns["false labels"].estimate
        parts += [
            page.paragraph(figures.name),
            pictures.confusion_table(report.labelled.labels, figures.counts, shares),
        ]
    return parts
