"""What was learned, as a page."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.display import counted
from modsim3d.learn.figures.average_precision import Curve, Ranking
from modsim3d.learn.told.in_short import how_well, learned_from, results
from modsim3d.learn.told.report import Report, lead
from modsim3d.learn.told.sources import Sources
from modsim3d.learn.told.tables import NEVER_LEARNED, tables
from modsim3d.view.pages import charts, page
from modsim3d.view.pages.provenance import Input, Provenance


def page_text(report: Report, out: Path, detector: str, sources: Sources, sections: Sequence[str] = ()) -> str:
    """The page, in one file.

    Args:
        report: What was learned.
        out: The detector file.
        detector: Its content.
        sources: What it was learned from.
        sections: Further sections, as HTML, which come before the pictures.
    """
    body = [f"<style>{_STYLE}</style>", page.paragraph(learned_from(report, out.name, sources.names), "lead")]
    body += [page.paragraph(how_well(report), "lead")]
    body += [page.paragraph(f"Warning: {report.warning}.", "bad")] if report.warning else []
    body += [page.tiles(results(report)), *_to_know(report), page.paragraph(lead(report), "soft")]
    body += [*sections, *_curve_pictures(report)]
    body += [page.heading("Box errors"), *_scatter(report)]
    body += [page.heading("Confusion matrices"), *_matrices(report)]
    if report.shares is not None:
        gains = {each.kind.value: max(each.gain_points, 0.0) for each in report.shares.shares}
        body += [page.heading("What average precision is lost to"), charts.named_bars(gains, "points", _SHARES)]
    for table in tables(report, every=True):
        body += [page.heading(table.title), '<div class="wide">', page.table(table.rows, table.header), "</div>"]
    body.append(page.heading("Left simple"))
    notes = report.learned.notes
    body.append(page.listed(notes) if notes else page.paragraph("Nothing: there was enough of everything."))
    body += [page.paragraph(NEVER_LEARNED), *([page.paragraph(_POINTS, "soft")] if report.shares else [])]
    title = f"{out.name}: a detector learned from {counted(len(report.labelled.images), 'image')}"
    return page.page(title, body, _provenance(report, out, detector, sources))


def _to_know(report: Report) -> list[str]:
    """What the numbers have to be read with, in one list."""
    remarks = [*report.remarks_on_data, *([report.near_gate.remark] if report.near_gate.shares else [])]
    if not remarks:
        return []
    return [page.heading("Read the numbers with this"), page.listed(f"{remark}." for remark in remarks)]


def _provenance(report: Report, out: Path, detector: str, sources: Sources) -> Provenance:
    settings = sources.settings
    states = "; ".join(f"{name} = {', '.join(names)}" for name, names in report.state_map.states.items())
    written = Input("detector file that was learned", out.name, sha256(detector.encode()).hexdigest(), "as written")
    return Provenance(
        page="a detector learned from its results on labelled images",
        made_by=sources.made_by,
        inputs=(written, *sources.inputs),
        seeds=sources.seeds,
        options=(
            ("Matched by", report.matched_by),
            ("Least confidence", f"{settings.threshold:g}" if report.labelled.scored else "none: not given"),
            ("Intervals", f"{report.level:.0%}, {settings.replicates:,} replicates of the bootstrap"),
            ("States", states),
        ),
        made_before=sources.made_before,
    )


_STYLE = (
    "body { max-width: 84rem; } .plots { display: flex; flex-wrap: wrap; gap: 1rem; } "
    ".plots figure { width: 25rem; margin: 0; } "
    ".wide { font-size: 0.9rem; } "
    "@media screen and (max-width: 40rem) { table.shares { font-size: 0.8rem; } } "
    "table.shares td, table.shares th { padding: 0.25rem 0.6rem; } "
    ".shares .soft { color: inherit; } table.shares th + th { text-align: right; } "
    ".wide td, .wide th { padding: 0.2rem 0.9rem 0.2rem 0; }"
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
    if report.by_label is None:
        return []
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
    title = page.heading(f"Precision against recall, matched by {report.curves_matched_by}")
    return [title, '<div class="plots">', *curves, "</div>"]


def _scatter(report: Report) -> list[str]:
    pairs, relative = report.learned.observed.pairs, report.learned.form.box_errors.relative
    error, state = pairs.errors(pairs.sure, relative), pairs.state[pairs.sure]  # in the unit in which they are learned
    states, plots = report.learned.observed.states, []
    there = [index for index in range(len(states)) if np.any(state == index)]
    colours = [charts.state_colours(len(states))[index] for index in there]
    for (i, j), what in (((0, 1), "centres"), ((2, 3), "sizes")):
        groups = {states[index]: error[state == index][:, [i, j]] for index in there}
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
            f'<div class="wide">{charts.confusion_table(report.labelled.labels, figures.counts, shares)}</div>',
        ]
    return parts
