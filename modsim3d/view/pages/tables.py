"""Tables of pages: points below each other, headers that repeat in print, rows as lists on a phone."""

import html
import re
from collections.abc import Container, Mapping, Sequence
from types import MappingProxyType

from modsim3d.core.document import Cell, Row
from modsim3d.core.text import is_number, is_numeric

MIN_STACKED, MIN_DENSE = 5, 9  # columns of a table that is shown as a list of rows on a phone, or is printed small
FILL = "#0072b2"  # of cells that show a share
_DIGIT, _POINT = "\u2007", "\u2008"  # spaces as wide as a digit and as a point
_NUMBER = re.compile(
    r"(?<![\w.])(?P<sign>[-−+±]?)(?P<whole>\d[\d,]*|∞)(?P<rest>\.\d+)?(?P<power>e[-−+]?\d+)?(?![.\d]*\d)"
)
_INTERVAL = re.compile(r"\[[^\[\]]+,(?:<i[^<]*</i>)? [^\[\]]+\]")
_WHOLE = re.compile(rf'(?:(?<= )<i class="pad">[^<]*</i>)?{_INTERVAL.pattern}')
"""An interval of HTML with the spaces before it, which align it and not the number."""
_UNIT = re.compile(r"(?: ?(?:°|%|px|m|s)(?![^\s,\])]))?[,\])]?")  # behind a number, which it stays with
_PADS = re.compile(f"[{_DIGIT}{_POINT}]+")
_LONG = re.compile(r"(?:[\w./]|\[(?=\w)|&\w+;){16,}")  # words such as keys and checksums, which may be broken
_MAX_CELL_LENGTH = 28  # letters of a cell that is never broken
NO_NOTES: Mapping[int, str] = MappingProxyType({})


def table(
    rows: Sequence[Row],
    header: Sequence[str] = (),
    bad: Container[int] = (),
    *,
    soft: Container[int] = (),
    notes: Mapping[int, str] = NO_NOTES,
) -> str:
    """A table of rows under a header; columns of numbers are set to the right, with their points below each other.
    One of several columns scrolls sideways where it is too wide. A dash for an unknown number stands where the numbers
    of its column do. Rows in `bad` stand out, those in `soft` stand back; `notes` stand below a row, by its number."""
    columns = [[cell.text if isinstance(cell, Cell) else cell for cell in column] for column in zip(*rows, strict=True)]
    named = [*map(bool, header), *[not header] * len(columns)]  # a column without a name has the names of the rows
    right = [named[place] and is_numeric(column) for place, column in enumerate(columns)]
    shown = [
        [_in_number(cell) if is_number(cell) else breaking(cell) for cell in aligned(column)]
        if right[place]
        else [breaking(cell) for cell in column]
        for place, column in enumerate(columns)
    ]
    right += [False] * (len(header) - len(right))
    labels = header if len(header) >= MIN_STACKED else [""] * len(columns)
    lines = [f"<table{_shape(len(header))}>"]
    if header:
        names = (f"<th{_class(side)}>{html.escape(name)}</th>" for name, side in zip(header, right, strict=False))
        lines.append(f"<thead><tr>{''.join(names)}</tr></thead>")
    lines.append("<tbody>")
    for number, cells in enumerate(zip(*shown, strict=True)):
        content = "".join(
            _cell(rows[number][place], cell, _class(right[place], columns[place][number]) + _label(labels[place]))
            for place, cell in enumerate(cells)
        )
        kind = "bad" if number in bad else "soft" if number in soft else ""
        lines.append((f'<tr class="{kind}">' if kind else "<tr>") + content + "</tr>")
        if note := notes.get(number):
            lines.append(f'<tr><td colspan="{len(shown)}" class="soft">{with_code(note)}</td></tr>')
    written = "\n".join([*lines, "</tbody>", "</table>"])
    return scrolling(written) if len(header) > 2 else written


def _cell(cell: str | Cell, content: str, attributes: str) -> str:
    """A cell as HTML, with what a page shows of it besides its text."""
    if isinstance(cell, str):
        return f"<td{attributes}>{content}</td>"
    content = cell.draw() if cell.draw else content
    if cell.share is None:
        return f"<td{attributes}>{content}</td>"
    if cell.bar:
        share = min(max(cell.share, 0.0), 1.0)
        return f'<td{attributes}><span class="bar" style="--share: {share:.3g}"></span>{content}</td>'
    fill = f"color-mix(in srgb, {FILL} {5 + 55 * cell.share:.0f}%, transparent)"
    return f'<td{attributes} style="background: {fill}; padding-left: 0.5rem">{content}</td>'


def scrolling(content: str) -> str:
    """A table that scrolls sideways where it is too wide, by keyboard too."""
    return f'<div class="scroll" tabindex="0" role="group" aria-label="Table">{content}</div>'


def aligned(column: Sequence[str]) -> list[str]:
    """The cells of a column with spaces of the width of digits, so that right-aligned points are below each other.
    Cells are aligned with those that have the same words between their numbers. A minus sign replaces the hyphen."""
    cells = [_NUMBER.sub(lambda part: part[0].replace("-", "−"), cell) if is_number(cell) else cell for cell in column]
    groups: dict[str, list[int]] = {}
    for place, cell in enumerate(cells):
        if is_number(cell) and not any(part["power"] for part in _NUMBER.finditer(cell)):
            groups.setdefault(_NUMBER.sub("0", cell), []).append(place)
    for places in groups.values():
        numbers = [list(_NUMBER.finditer(cells[place])) for place in places]
        widths = [
            (max(_length(part, "sign", "whole") for part in same), max(len(part["rest"] or "") for part in same))
            for same in zip(*numbers, strict=True)
        ]
        for place, parts in zip(places, numbers, strict=True):
            cells[place] = _padded(cells[place], parts, widths)
    return cells


def _length(number: re.Match[str], *parts: str) -> int:
    return sum(len(number[part]) for part in parts)


def _padded(cell: str, numbers: Sequence[re.Match[str]], widths: Sequence[tuple[int, int]]) -> str:
    """A cell whose numbers have as many places before and behind their points as are asked for."""
    text, end = "", 0
    for place, (number, (before, behind)) in enumerate(zip(numbers, widths, strict=True)):
        left = _DIGIT * (before - _length(number, "sign", "whole")) if place else ""  # the first one ends on the right
        rest, words = number["rest"] or "", cell[end : number.start()]
        right = (_POINT + _DIGIT * (behind - 1)) if behind and not rest else _DIGIT * (behind - len(rest))
        unit = _UNIT.match(cell, number.end())
        bracket = words[-1:] if words.endswith(("[", "(")) else ""  # stays at its number
        text += words.removesuffix(bracket) + left + bracket + number[0] + (unit[0] if unit else "") + right
        end = unit.end() if unit else number.end()
    return text + cell[end:]


def facts(rows: Sequence[tuple[str, str]]) -> str:
    """A table of names with what is said of each."""
    lines = (f"<tr><th>{breaking(name)}</th><td>{breaking(text)}</td></tr>" for name, text in rows)
    return "\n".join(['<table class="facts">', *lines, "</table>"])


def breaking(text: str) -> str:
    """Text as HTML in which long words, such as keys and checksums, may be broken, and options of commands may not."""
    text = re.sub(r"(?<!\S)--[a-z-]+", r'<span class="option">\g<0></span>', html.escape(text))
    return _LONG.sub(lambda word: re.sub(r"[./]|\](?=\[)|\w{16}(?=\w)", r"\g<0><wbr>", word[0]), text)


def with_code(text: str) -> str:
    """Text as HTML, with keys and commands between backticks as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(text))


def _in_number(cell: str) -> str:
    """A cell of numbers as HTML: an interval stays on one line, and a phone needs no spaces of alignment."""
    padded = _PADS.sub(lambda part: f'<i class="pad">{part[0]}</i>', html.escape(cell))
    return _WHOLE.sub(lambda part: f'<span class="whole">{part[0]}</span>', padded)


def _shape(columns: int) -> str:
    if columns < MIN_STACKED:
        return ""
    return ' class="stack dense"' if columns >= MIN_DENSE else ' class="stack"'


def _class(numeric: bool, cell: str = "") -> str:
    """The class of a cell: a number is not broken, one with an interval only before it."""
    if not numeric:
        return ""
    return ' class="number broken"' if len(cell) > _MAX_CELL_LENGTH or _INTERVAL.search(cell) else ' class="number"'


def _label(name: str) -> str:
    return f' data-label="{html.escape(name, quote=True)}"' if name else ""
