"""Tables of the page of a campaign without what says nothing."""

from __future__ import annotations

from collections.abc import Sequence


def without_empty(
    rows: Sequence[Sequence[str]], header: Sequence[str], empty: Sequence[str]
) -> tuple[list[list[str]], list[str]]:
    """Rows and header without those of some columns in which no row says anything: all cells are empty or 0."""
    said = [name not in empty or any(row[place] not in ("", "0") for row in rows) for place, name in enumerate(header)]
    kept = [place for place, each in enumerate(said) if each]
    return [[row[place] for place in kept] for row in rows], [header[place] for place in kept]
