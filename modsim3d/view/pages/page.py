"""Self-contained HTML pages: no network, no scripts needed, light and dark."""

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from importlib.resources import files
from itertools import count
from typing import Any

from PIL.Image import Image

from modsim3d.core import document as doc
from modsim3d.io.atomic_write import encoded
from modsim3d.view.pages.provenance import Provenance, provenance, top_line
from modsim3d.view.pages.tables import breaking, facts, table, with_code

# ---- The style of pages, and how they are printed ----


def shipped_text(*names: str) -> str:
    """Text of a file below the folder of this room, by the names on its path."""
    return files("modsim3d.view").joinpath(*names).read_text(encoding="utf-8")


def common_style(title: str, content: str) -> str:
    """Style of tables, of what a page rests on, and of paper; it stands behind the rest of a page's style.
    At the foot of each sheet stand the title, and a mark that all have in common: from the checksum of the content."""
    shared = ("\n" + shipped_text("pages", name) for name in ("tables.css", "provenance.css", "print.css"))
    mark = hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()[:12]
    font = "font: 8pt system-ui, sans-serif; color: #56606a;"
    return (
        f"{''.join(shared)}@page {{ size: A4; margin: 15mm 15mm 18mm; "
        f"@bottom-left {{ content: {_css_text(title)}; {font} }} "
        f"@bottom-center {{ content: {_css_text(mark)}; {font} }} "
        f'@bottom-right {{ content: counter(page) " / " counter(pages); {font} }} }}\n'
    )


def _css_text(text: str) -> str:
    """Text as a string of CSS; what could end it or the style is written by its code."""
    return '"' + re.sub(r"[^\w .,:;?!()%/+·–-]", lambda match: f"\\{ord(match[0]):x} ", text) + '"'


MIN_CONTENTS = 4  # sections of a page that has links to them
_SECTION = re.compile(r"<h2[^>]*>(.*?)</h2>")


def page(title: str, body: Iterable[str], rests_on: Provenance) -> str:
    """A whole page from the HTML of its parts, with what it rests on in a line at the top and in full at the end."""
    content = with_contents("\n".join([top_line(rests_on), *body, provenance(rests_on)]))
    content = unbroken(f"<h1>{html.escape(title)}</h1>\n{content}")
    style = "\n" + shipped_text("pages", "page.css") + common_style(title, content)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f"<main>\n{content}\n</main>\n</body>\n</html>\n"
    )


def unbroken(content: str) -> str:
    """Content whose percent signs stay on the lines of their numbers."""
    return content.replace(" %", "\u00a0%")


def with_contents(content: str) -> str:
    """Content with links to its sections before the first of them, where there are more than a few."""
    titles = _SECTION.findall(content)
    if len(titles) < MIN_CONTENTS:
        return content
    numbers = count(1)
    content = _SECTION.sub(lambda match: f'<h2 id="section-{next(numbers)}"{match[0][3:]}', content)
    links = (f'<li><a href="#section-{number}">{title}</a></li>' for number, title in enumerate(titles, start=1))
    contents = f'<nav class="contents" aria-label="Contents"><ul>{"".join(links)}</ul></nav>\n'
    return re.sub("<h[23]", lambda match: contents + match[0], content, count=1)


def document_page(document: doc.Document, rests_on: Provenance) -> str:
    """A whole page of a document."""
    blocks = doc.blocks_at([*document.lead, *document.blocks], doc.Where.PAGE)
    return page(document.title, map(html_of, blocks), rests_on)


def html_of(block: doc.Block) -> str:
    """A block as HTML."""
    match block:
        case doc.Heading():
            mark = ' class="bad"' if block.bad else ""
            return f"<h{block.level}{mark}>{html.escape(block.text)}</h{block.level}>"
        case doc.Text(style="code"):
            return f"<p><code>{breaking(block.text)}</code></p>"
        case doc.Text():
            mark = f' class="{block.style}"' if block.style else ""
            return f"<p{mark}>{with_code(block.text)}</p>"
        case doc.Items():
            return "<ul>\n" + "\n".join(f"<li>{html.escape(text)}</li>" for text in block.texts) + "\n</ul>"
        case doc.Tiles():
            return tiles(block.results)
        case doc.Figure():
            caption = f"<figcaption>{html.escape(block.caption)}</figcaption>\n" if block.caption else ""
            return f"<figure>\n{block.draw()}\n{caption}</figure>"
        case doc.Fold():
            return folded(block.title, "\n".join(map(html_of, block.blocks)), block.opened)
        case doc.BlockRow():
            inner = "\n".join(f"<div>{html_of(child)}</div>" for child in block.blocks)
            return f'<div class="beside">\n{inner}\n</div>'
        case doc.Table():
            return _table_html(block)


def _table_html(block: doc.Table) -> str:
    title = f"<h3>{html.escape(block.title)}</h3>\n" if block.title else ""
    title += f'<p class="soft">{html.escape(block.about)}</p>\n' if block.about else ""
    if not block.header and all(len(row) == 2 for row in block.rows):
        return title + facts([(name, text) for name, text in block.texts])
    return title + table(block.rows, block.header, block.bad, soft=block.soft, notes=block.notes)


def heading(text: str) -> str:
    """A section's heading."""
    return f"<h2>{html.escape(text)}</h2>"


def folded(title: str, content: str, opened: bool = False) -> str:
    """Content that is shown when its title is pressed, and in print."""
    return f"<details{' open' if opened else ''}><summary>{html.escape(title)}</summary>\n{content}\n</details>"


def tiles(results: Iterable[Sequence[str]], kind: str = "tiles") -> str:
    """The main results side by side: a name, a number and what it means of each. `kind` is their class."""
    cells = (
        f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(number)}</dd><dd>{html.escape(meaning)}</dd></div>"
        for name, number, meaning in results
    )
    return f'<dl class="{kind}">\n' + "\n".join(cells) + "\n</dl>"


def image(picture: Image, alt: str, kind: str = "png", **options: Any) -> str:
    """A picture inside the page as PNG or JPEG, with a text for those who cannot see it."""
    data = base64.b64encode(encoded(picture, f".{kind}", optimize=True, **options)).decode("ascii")
    return (
        f'<img src="data:image/{kind};base64,{data}" alt="{html.escape(alt, quote=True)}" width="{picture.width}" '
        f'height="{picture.height}">'
    )


def images(pictures: Sequence[Image], alt: str, kind: str = "png", **options: Any) -> str:
    """Pictures of one width beside each other, or below each other where a page is narrow."""
    inner = "\n".join(image(picture, alt, kind, **options) for picture in pictures)
    return f'<div class="pictures">\n{inner}\n</div>' if inner else ""
