"""Self-contained HTML pages: no network, no scripts needed, light and dark."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from typing import Any

from PIL.Image import Image

from modsim3d.outputs.pictures import encoded
from modsim3d.view.pages.print_style import PRINT_STYLE, mark_of, sheet_style
from modsim3d.view.pages.provenance import PROVENANCE_STYLE, Provenance, provenance, top_line
from modsim3d.view.pages.tables import TABLE_STYLE, UNKNOWN, facts, scrolling, table

__all__ = [
    "STYLE",
    "UNKNOWN",
    "facts",
    "folded",
    "heading",
    "listed",
    "page",
    "paragraph",
    "picture",
    "scrolling",
    "table",
    "tiles",
]

STYLE = """
:root { color-scheme: light dark; --ink: #1c2329; --paper: #fbfbf9; --soft: #5c6670; --line: #d5d9dc; --bad: #c22; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e8ea; --paper: #15191d; --soft: #9aa4ad; --line: #363d44; --bad: #ff7a70; }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
       max-width: 72rem; margin: 2rem auto; padding: 0 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
p.lead { font-size: 1.1rem; } .soft { color: var(--soft); } .bad { color: var(--bad); font-weight: 600; }
p, li, figcaption { max-width: 60rem; } li { margin: 0.2rem 0; }
table { border-collapse: collapse; margin: 0.8rem 0; }
th, td { text-align: left; padding: 0.25rem 1.2rem 0.25rem 0; border-bottom: 1px solid var(--line); }
summary { cursor: pointer; padding: 0.25rem 0; }
.scroll { overflow-x: auto; } .scroll:focus-visible { outline-offset: -2px; }
figure { margin: 1.2rem 0; } figure img { max-width: 100%; height: auto; border: 1px solid var(--line); }
figcaption { color: var(--soft); font-size: 0.95rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: 0.6rem; margin: 1rem 0; }
.tiles div { border: 1px solid var(--line); border-radius: 8px; padding: 0.4rem 0.7rem; }
.tiles dt { color: var(--soft); font-size: 0.88rem; }
.tiles dd { margin: 0; font-size: 0.82rem; line-height: 1.35; color: var(--soft); }
.tiles dt + dd { color: var(--ink); font-size: 1.4rem; font-weight: 600; font-variant-numeric: tabular-nums; }
@media screen and (max-width: 40rem) {
  body { margin: 1rem auto; }
  svg.long { width: 40rem; max-width: none !important; }
  ul { padding-left: 1.2rem; }
}
"""


def page(title: str, body: Iterable[str], rests_on: Provenance) -> str:
    """A whole page from the HTML of its parts, with what it rests on in a line at the top and in full at the end."""
    content = "\n".join([f"<h1>{html.escape(title)}</h1>", top_line(rests_on), *body, provenance(rests_on)])
    style = STYLE + TABLE_STYLE + PROVENANCE_STYLE + PRINT_STYLE + sheet_style(title, mark_of(content))
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f"<main>\n{content}\n</main>\n</body>\n</html>\n"
    )


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    mark = f' class="{kind}"' if kind else ""
    return f"<p{mark}>{html.escape(text)}</p>"


def heading(text: str) -> str:
    """A section's heading."""
    return f"<h2>{html.escape(text)}</h2>"


def listed(texts: Iterable[str], kind: str = "") -> str:
    """A list of plain texts."""
    mark = f' class="{kind}"' if kind else ""
    return f"<ul{mark}>\n" + "\n".join(f"<li>{html.escape(text)}</li>" for text in texts) + "\n</ul>"


def folded(title: str, content: str, opened: bool = False) -> str:
    """Content that is shown when its title is pressed, and in print."""
    return f"<details{' open' if opened else ''}><summary>{html.escape(title)}</summary>\n{content}\n</details>"


def tiles(results: Sequence[tuple[str, str, str]]) -> str:
    """The main results side by side: a name, a number and what it means of each."""
    each = (
        f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(number)}</dd><dd>{html.escape(meaning)}</dd></div>"
        for name, number, meaning in results
    )
    return '<dl class="tiles">\n' + "\n".join(each) + "\n</dl>"


def picture(image: Image, caption: str, kind: str = "png", **options: Any) -> str:
    """A picture inside the page as PNG or JPEG, with its caption."""
    data = base64.b64encode(encoded(image, f".{kind}", optimize=True, **options)).decode("ascii")
    alt = html.escape(caption, quote=True)
    return (
        f'<figure>\n<img src="data:image/{kind};base64,{data}" alt="{alt}" width="{image.width}" '
        f'height="{image.height}">\n<figcaption>{html.escape(caption)}</figcaption>\n</figure>'
    )
