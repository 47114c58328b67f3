"""The sections of a voyage on the page of what was learned."""

from __future__ import annotations

from collections.abc import Iterator

from modsim3d.learn.told.tables import Table
from modsim3d.view.pages import charts, page
from modsim3d.voyage.told.coverage import range_table
from modsim3d.voyage.told.drawings import coverage_drawing, frame_sketch
from modsim3d.voyage.told.stretches import missed_table, unmatched_table
from modsim3d.voyage.told.voyage_report import NOT_REGISTERED, VoyageReport

_DRAWN = 3
_COVERAGE = (
    "Each cell has the share that was matched, and of how many boxes. Vessels without a transponder are in none of "
    "them. Where no vessel passed, nothing is known."
)
_KEY = (
    "Blue: vessels that were matched. Red, dashed: vessels that were missed. Orange: detections of nothing known. The "
    "grey line is the horizon. The circle is about what the title names."
)


def voyage_sections(told: VoyageReport) -> tuple[str, ...]:
    """All sections, as HTML."""
    return (*_registration(told), *_unseen(told), *_truth_noise(told), *_coverage(told), *_worst(told))


def _registration(told: VoyageReport) -> Iterator[str]:
    yield page.heading("Registration")
    if not told.voyage.registered:
        yield page.paragraph(NOT_REGISTERED)
    for lead, table, exchanges in told.registration:
        yield page.paragraph(lead)
        yield from _table(table)
        yield page.paragraph("What these data cannot tell apart, so that a rule settles it:")
        yield page.listed(f"{each[:1].upper()}{each[1:]}.".replace(" -", " −") for each in exchanges)


def _unseen(told: VoyageReport) -> Iterator[str]:
    yield page.heading("What AIS does not see")
    yield from _table(told.unseen)


def _truth_noise(told: VoyageReport) -> Iterator[str]:
    table = told.truth_noise
    if table.rows:
        yield page.heading("How well the truth is known")
        yield from _table(table)


def _coverage(told: VoyageReport) -> Iterator[str]:
    yield page.heading("Coverage of the sea")
    for coverage in told.coverage:
        yield charts.figure([coverage_drawing(coverage)], _COVERAGE)
        yield from _table(range_table(coverage))


def _worst(told: VoyageReport) -> Iterator[str]:
    yield page.heading("The longest without a match")
    for stretches, table in (
        (told.missed, missed_table(told.missed)),
        (told.unmatched, unmatched_table(told.unmatched)),
    ):
        if not stretches:
            continue
        yield from _table(table)
        yield charts.figure([frame_sketch(told.voyage, told.judged, each) for each in stretches[:_DRAWN]], _KEY)


def _table(table: Table) -> Iterator[str]:
    if table.rows:
        yield page.paragraph(table.title, "soft")
        yield f'<div class="wide">{page.table(table.rows, table.header)}</div>'
