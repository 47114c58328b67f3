"""Texts: numbers in them, and how results show themselves, in a few words or a small table of HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape

MAX_NAMES = 6


def number_in(text: object) -> float:
    """The finite number that a text is, NaN if it is none."""
    try:
        number = float(str(text))
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def key_table(title: str, rows: Mapping[str, str]) -> str:
    """A table with a key and a value in each row, under a title."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(key)}</th><td style="text-align:left">{escape(value)}</td></tr>'
        for key, value in rows.items()
    )
    return f"<table>{_caption(title)}{cells}</table>"


def column_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with named columns, under a title."""
    head = "".join(f'<th style="text-align:left">{escape(name)}</th>' for name in header)
    body = "".join(
        "<tr>" + "".join(f'<td style="text-align:left">{escape(cell)}</td>' for cell in row) + "</tr>" for row in rows
    )
    return f"<table>{_caption(title)}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _caption(title: str) -> str:
    return f'<caption style="text-align:left"><b>{escape(title)}</b></caption>'


def listed(names: Sequence[str], most: int = MAX_NAMES) -> str:
    """Names with commas; of many only the first."""
    shown = ", ".join(names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown


def counted(number: int, one: str, many: str | None = None) -> str:
    """A number with its noun in the singular or plural, such as `1 camera`."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"
