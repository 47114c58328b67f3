"""Self-contained HTML pages: no network, no scripts needed, light and dark."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Container, Iterable, Sequence

from PIL import Image

STYLE = """
:root { color-scheme: light dark; --ink: #1c2329; --paper: #fbfbf9; --soft: #5c6670; --line: #d5d9dc; --bad: #c22; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e8ea; --paper: #15191d; --soft: #9aa4ad; --line: #363d44; --bad: #ff7a70; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
       max-width: 72rem; margin: 2rem auto; padding: 0 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
p.lead { font-size: 1.1rem; } .soft { color: var(--soft); } .bad { color: var(--bad); font-weight: 600; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: 0.25rem 1.2rem 0.25rem 0; border-bottom: 1px solid var(--line); }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
.scroll { overflow-x: auto; margin: 0.8rem 0; } .scroll:focus-visible { outline-offset: -2px; }
figure { margin: 1.2rem 0; } figure img { max-width: 100%; height: auto; border: 1px solid var(--line); }
figcaption { color: var(--soft); font-size: 0.95rem; }
"""

UNKNOWN = "–"
"""What stands for a number that is not known."""


def page(title: str, body: Iterable[str]) -> str:
    """A whole page from the HTML of its parts."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<main>\n<h1>{html.escape(title)}</h1>\n" + "\n".join(body) + "\n</main>\n</body>\n</html>\n"
    )


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    mark = f' class="{kind}"' if kind else ""
    return f"<p{mark}>{html.escape(text)}</p>"


def heading(text: str) -> str:
    """A section's heading."""
    return f"<h2>{html.escape(text)}</h2>"


def table(rows: Sequence[Sequence[str]], header: Sequence[str] = (), bad: Container[int] = ()) -> str:
    """A table of rows under a header; numbers and what stands above them are set to the right, bad rows stand out.

    A dash for an unknown number stands where the numbers of its column do.
    """
    shown = [next((cell for cell in column if cell != UNKNOWN), UNKNOWN) for column in zip(*rows, strict=False)]
    below = shown if rows else [""] * len(header)
    head = "".join(_cell(name, under, "th") for name, under in zip(header, below, strict=False))
    lines = [f"<tr>{head}</tr>"] if header else []
    for index, row in enumerate(rows):
        cells = (_cell(text, first if text == UNKNOWN else text) for text, first in zip(row, shown, strict=False))
        lines.append(('<tr class="bad">' if index in bad else "<tr>") + "".join(cells) + "</tr>")
    return scrolling("<table>\n" + "\n".join(lines) + "\n</table>")


def scrolling(content: str) -> str:
    """A table that scrolls sideways where it is too wide, by keyboard too."""
    return f'<div class="scroll" tabindex="0" role="group" aria-label="Table">{content}</div>'


def _cell(text: str, number: str, tag: str = "td") -> str:
    """A cell, set to the right if `number` looks like a number."""
    kind = ' class="number"' if number.lstrip("-−")[:1].isdigit() else ""
    return f"<{tag}{kind}>{html.escape(text)}</{tag}>"


def picture(image: Image.Image, caption: str) -> str:
    """A picture inside the page, with its caption."""
    data = io.BytesIO()
    image.save(data, format="PNG", optimize=True)
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    alt = html.escape(caption, quote=True)
    return (
        f'<figure>\n<img src="data:image/png;base64,{encoded}" alt="{alt}" width="{image.width}" '
        f'height="{image.height}">\n<figcaption>{html.escape(caption)}</figcaption>\n</figure>'
    )
