"""Tables and folded parts of the page; wide tables scroll by themselves, so that the page does not."""

from __future__ import annotations

import html
from collections.abc import Container, Sequence

from modsim3d.view.pages.page import UNKNOWN


def grid(
    rows: Sequence[Sequence[str]], header: Sequence[str], *, markup: Container[int] = (), bad: Container[int] = ()
) -> str:
    """A table; a column whose first known cell begins with a digit is set to the right.

    Args:
        rows: The cells as text.
        header: Names of the columns.
        markup: Columns whose cells are HTML already.
        bad: Rows that stand out.
    """
    first = [next((row[place] for row in rows if row[place] != UNKNOWN), "") for place in range(len(header))]
    right = [place not in markup and text.lstrip("−-")[:1].isdigit() for place, text in enumerate(first)]

    def cell(text: str, place: int, tag: str) -> str:
        inner = text if place in markup and tag == "td" else html.escape(text)
        return f"<{tag}{' class=number' if right[place] else ''}>{inner}</{tag}>"

    lines = ["<tr>" + "".join(cell(text, place, "th") for place, text in enumerate(header)) + "</tr>"]
    for number, row in enumerate(rows):
        kind = ' class="bad"' if number in bad else ""
        lines.append(f"<tr{kind}>" + "".join(cell(text, place, "td") for place, text in enumerate(row)) + "</tr>")
    return scrolling("<table>\n" + "\n".join(lines) + "\n</table>")


def scrolling(content: str) -> str:
    """Content that scrolls sideways if it is too wide."""
    return f'<div style="overflow-x: auto">{content}</div>'


def closed(title: str, content: str, opened: bool = False) -> str:
    """Content that is shown when its title is clicked."""
    return f"<details{' open' if opened else ''}><summary>{html.escape(title)}</summary>{content}</details>"
