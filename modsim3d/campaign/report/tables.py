"""Tables and folded parts of the page; wide tables scroll by themselves, so that the page does not."""

from __future__ import annotations

import html
import re
from collections.abc import Container, Mapping, Sequence
from types import MappingProxyType

from modsim3d.view.pages.page import UNKNOWN, scrolling

_NO_NOTES: Mapping[int, str] = MappingProxyType({})
_INTERVAL = re.compile(r"\S+ \[\S+ \S+\]")
_NUMBER = re.compile(r"[-−]?[\d.,]+(e[-−+]?\d+)?( \[\S+ \S+\])?")
_LONG = re.compile(r"[\w./]{16,}")


def grid(
    rows: Sequence[Sequence[str]],
    header: Sequence[str],
    *,
    markup: Container[int] = (),
    bad: Container[int] = (),
    notes: Mapping[int, str] = _NO_NOTES,
) -> str:
    """A table; a column whose first known cell is a number, with an interval or not, is set to the right.

    Args:
        rows: The cells as text.
        header: Names of the columns.
        markup: Columns whose cells are HTML already.
        bad: Rows that stand out.
        notes: What is said below a row, by its number.
    """
    first = [next((row[place] for row in rows if row[place] != UNKNOWN), "") for place in range(len(header))]
    right = [place not in markup and _NUMBER.fullmatch(text) is not None for place, text in enumerate(first)]

    def cell(text: str, place: int, tag: str) -> str:
        inner = text if place in markup and tag == "td" else _breaking(html.escape(text))
        return f"<{tag}{' class=number' if right[place] else ''}>{inner}</{tag}>"

    lines = ["<tr>" + "".join(cell(text, place, "th") for place, text in enumerate(header)) + "</tr>"]
    for number, row in enumerate(rows):
        kind = ' class="bad"' if number in bad else ""
        lines.append(f"<tr{kind}>" + "".join(cell(text, place, "td") for place, text in enumerate(row)) + "</tr>")
        if note := notes.get(number):
            lines.append(f'<tr><td colspan="{len(header)}" class="soft">{html.escape(note)}</td></tr>')
    return scrolling("<table>\n" + "\n".join(lines) + "\n</table>")


def without_empty(
    rows: Sequence[Sequence[str]], header: Sequence[str], empty: Sequence[str]
) -> tuple[list[list[str]], list[str]]:
    """Rows and header without those of some columns in which no row says anything: all cells are empty or 0."""
    said = [name not in empty or any(row[place] not in ("", "0") for row in rows) for place, name in enumerate(header)]
    kept = [place for place, each in enumerate(said) if each]
    return [[row[place] for place in kept] for row in rows], [header[place] for place in kept]


def facts_table(rows: Sequence[tuple[str, str]]) -> str:
    """Names with what is said of them."""
    lines = [f"<tr><td>{html.escape(name)}</td><td>{_breaking(html.escape(text))}</td></tr>" for name, text in rows]
    return scrolling("<table>\n" + "\n".join(lines) + "\n</table>")


def _breaking(text: str) -> str:
    """Text whose long words, such as keys, may be broken; an interval stays on one line."""
    if _INTERVAL.fullmatch(text):
        return f'<span style="white-space: nowrap">{text}</span>'
    return _LONG.sub(lambda word: re.sub(r"[./]|\w{16}(?=\w)", r"\g<0><wbr>", word[0]), text)


def closed(title: str, content: str, opened: bool = False) -> str:
    """Content that is shown when its title is clicked."""
    return f"<details{' open' if opened else ''}><summary>{html.escape(title)}</summary>{content}</details>"
