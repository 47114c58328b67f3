"""What was learned, as a page."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.learn.average_precision import Curve, Ranking
from modsim3d.learn.report import NEVER_LEARNED, Report, lead, tables
from modsim3d.view.pages import charts, page


def page_text(report: Report) -> str:
    """The page, in one file."""
    body = [page.paragraph(lead(report), "lead"), f"<style>{_STYLE}</style>"]
    body += [page.paragraph(f"Warning: {report.warning}.", "bad")] if report.warning else []
    body += [page.paragraph(f"{remark}.") for remark in report.remarks]
    states = "; ".join(f"{name} = {', '.join(names)}" for name, names in report.state_map.states.items())
    body.append(page.paragraph(f"Performance states: {states}."))
    body += [page.heading(f"Precision against recall, matched by {report.curves_matched_by}"), *_curve_pictures(report)]
    body += [page.heading("Box errors"), *_scatter(report)]
    body += [page.heading("Confusion matrices"), *_matrices(report)]
    gains = {each.kind.value: max(each.gain_points, 0.0) for each in report.shares.shares}
    body += [page.heading("What average precision is lost to"), charts.named_bars(gains, "points", _SHARES)]
    for table in tables(report, every=True):
        body += [page.heading(table.title), '<div class="wide">', page.table(table.rows, table.header), "</div>"]
    notes = report.learned.notes
    body.append(page.heading("Left simple"))
    body += [page.paragraph(note) for note in notes] or [page.paragraph("Nothing: there was enough of everything.")]
    body += [page.paragraph(NEVER_LEARNED), page.paragraph(_POINTS, "soft")]
    return page.page("A detector, learned", body)


_STYLE = (
    "body { max-width: 84rem; } .plots { display: flex; flex-wrap: wrap; gap: 1rem; } "
    ".plots figure { width: 25rem; margin: 0; } "
    ".wide { overflow-x: auto; font-size: 0.9rem; } "
    "table.shares td, table.shares th { padding: 0.25rem 0.6rem; } "
    ".shares .soft { color: inherit; opacity: 0.8; } table.shares th + th { text-align: right; } "
    ".wide td, .wide th { white-space: nowrap; padding: 0.2rem 0.9rem 0.2rem 0; }"
)
_SHARES = (
    "Points of mean average precision that correcting one kind of error would gain (Bolya et al., 2020): "
    "classification, localisation, both, duplicate, background, missed."
)
_POINTS = (
    "Average precision: by all points it is the area under the interpolated curve; COCO's tools average that curve at "
    "101 levels of recall, and the 11-point form at 11, so the three differ by up to a step of the curve."
)


def _curve_pictures(report: Report) -> list[str]:
    curves, states = [], report.learned.observed.states
    for label, name in enumerate(report.labelled.labels):
        of_state: dict[str, tuple[Array, Array]] = {}
        colours = []
        for index, (state, colour) in enumerate(zip(states, charts.state_colours(len(states)), strict=True)):
            images = report.learned.observed.image_state == index
            curve: Curve | None = Ranking.of(report.labelled, report.by_label, label, images).curve()
            if curve is not None and len(curve.recall):
                of_state[f"{state}: AP {curve.all_points():.3f}"] = curve.recall, curve.interpolated
                colours.append(colour)
        curves.append(
            charts.precision_recall(of_state, colours, f"{name}: largest precision at each recall or beyond.")
        )
    return ['<div class="plots">', *curves, "</div>"]


def _scatter(report: Report) -> list[str]:
    pairs, relative = report.learned.observed.pairs, report.learned.form.box_errors.relative
    error = pairs.errors(np.ones(len(pairs), dtype=bool), relative)  # in the unit in which they are learned
    states, plots = report.learned.observed.states, []
    there = [index for index in range(len(states)) if np.any(pairs.state == index)]
    colours = [charts.state_colours(len(states))[index] for index in there]
    for (i, j), what in (((0, 1), "centres"), ((2, 3), "sizes")):
        groups = {states[index]: error[pairs.state == index][:, [i, j]] for index in there}
        units = ("widths", "heights") if relative else ("px", "px")
        x, y = (f"{ERROR_COMPONENTS[k]} in {unit}" for k, unit in zip((i, j), units, strict=True))
        caption = f"Errors of {what}; ellipses hold 95 % of normal errors with the same mean and covariance."
        plots.append(charts.error_scatter(groups, colours, x, y, caption))
    return ['<div class="plots">', *plots, "</div>"]


def _matrices(report: Report) -> list[str]:
    parts = []
    for figures in report.states:
        k = len(report.labelled.labels)
        shares = np.full((k + 1, k + 1), np.nan)
        shares[:, :k] = figures.confusion.estimate
        shares[:k, k] = figures.false_labels.estimate
        parts += [
            page.paragraph(figures.name),
            charts.confusion_table(report.labelled.labels, figures.counts, shares),
        ]
    return parts
