"""Tables and folded parts of the page; wide tables scroll by themselves, so that the page does not."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

from modsim3d.view.pages.page import scrolling
from modsim3d.view.pages.tables import NO_NOTES, table


def grid(
    rows: Sequence[Sequence[str]],
    header: Sequence[str],
    *,
    markup: Container[int] = (),
    bad: Container[int] = (),
    notes: Mapping[int, str] = NO_NOTES,
) -> str:
    """A table; columns of numbers, with an interval or not, are set to the right.

    Args:
        rows: The cells as text.
        header: Names of the columns.
        markup: Columns whose cells are HTML already.
        bad: Rows that stand out.
        notes: What is said below a row, by its number.
    """
    return scrolling(table(rows, header, bad, markup=markup, notes=notes))


def without_empty(
    rows: Sequence[Sequence[str]], header: Sequence[str], empty: Sequence[str]
) -> tuple[list[list[str]], list[str]]:
    """Rows and header without those of some columns in which no row says anything: all cells are empty or 0."""
    said = [name not in empty or any(row[place] not in ("", "0") for row in rows) for place, name in enumerate(header)]
    kept = [place for place, each in enumerate(said) if each]
    return [[row[place] for place in kept] for row in rows], [header[place] for place in kept]
