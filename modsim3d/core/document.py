"""Results as documents: each result fills one, and the terminal, pages and notebooks show it.
What is empty is not shown, nor is a heading with nothing below it: a result fills in all that it may have."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from enum import Flag, auto
from html import escape
from itertools import zip_longest
from textwrap import shorten, wrap
from types import MappingProxyType
from typing import Literal

from modsim3d.core.text import column_table


class Where(Flag):
    """Places that show a block."""

    PAGE = auto()
    BRIEF = auto()  # a terminal
    FULL = auto()  # a terminal with `--verbose`
    NOTEBOOK = auto()
    TERMINAL = BRIEF | FULL
    TEXT = PAGE | TERMINAL
    EVERYWHERE = PAGE | TERMINAL | NOTEBOOK


MAX_LINES = 40  # that `print` shows of a result
Style = Literal["", "lead", "soft", "bad", "code"]


@dataclass(frozen=True)
class Heading:
    """A heading of what follows, down to the next one of its level."""

    text: str
    level: int = 2
    bad: bool = False
    where: Where = Where.TEXT


@dataclass(frozen=True)
class Text:
    """A paragraph. Text of the style `bad` is a warning, `code` is a command line."""

    text: str
    style: Style = ""
    where: Where = Where.TEXT


@dataclass(frozen=True)
class Items:
    """A list of short texts."""

    texts: Sequence[str]
    where: Where = Where.TEXT


@dataclass(frozen=True)
class Tiles:
    """The main results: a name, a number and what it means of each."""

    results: Sequence[tuple[str, str, str]]
    where: Where = Where.PAGE


@dataclass(frozen=True)
class Cell:
    """A cell of a table that a page shows with more than its text."""

    text: str  # all that a terminal shows
    share: float | None = None  # 0 to 1: darkness of the cell, or length of the bar behind the text; None: neither
    bar: bool = False  # whether the share is a bar
    draw: Callable[[], str] | None = None  # makes SVG that stands in place of the text


Row = Sequence[str | Cell]


@dataclass(frozen=True)
class Table:
    """A table; nothing stands above it if the title is empty."""

    title: str
    header: Sequence[str]  # names of the columns; without it each row is a name and what is said of it
    rows: Sequence[Row]
    bad: Container[int] = ()  # rows that stand out
    soft: Container[int] = ()  # rows that stand back
    notes: Mapping[int, str] = field(default_factory=lambda: MappingProxyType({}))  # said below a row, by its number
    about: str = ""  # said between the title and the rows
    where: Where = Where.TEXT

    @property
    def texts(self) -> list[list[str]]:
        """The rows as plain text."""
        return [[cell.text if isinstance(cell, Cell) else cell for cell in row] for row in self.rows]


@dataclass(frozen=True)
class Figure:
    """A drawing or a picture with its caption. `draw` makes its HTML when a page shows it."""

    draw: Callable[[], str]
    caption: str
    where: Where = Where.PAGE


@dataclass(frozen=True)
class Fold:
    """Blocks that a page shows when their title is pressed; a terminal shows those that are for it."""

    title: str
    blocks: Sequence[Block]
    opened: bool = False
    where: Where = Where.TEXT


@dataclass(frozen=True)
class BlockRow:
    """Blocks side by side."""

    blocks: Sequence[Block]
    where: Where = Where.TEXT


Block = Heading | Text | Items | Tiles | Table | Figure | Fold | BlockRow


@dataclass(frozen=True)
class Document:
    """A result to be read."""

    title: str  # of its page
    lead: Sequence[Text]  # the outcome: first on a page, last on a terminal
    blocks: Sequence[Block]  # all else, in the order of a page

    def __str__(self) -> str:
        """Plain text of what a terminal shows, the outcome last; where that is long, of what a notebook shows."""
        brief, short = ([*_lines(self.blocks, where)] for where in (Where.BRIEF, Where.NOTEBOOK))
        lead = dict.fromkeys([*_lines(self.lead), *_lines(self.lead, Where.NOTEBOOK)])
        return "\n".join([*(short if len(brief) > MAX_LINES else brief), *lead])

    def notebook(self) -> str:
        """HTML for a notebook: the outcome and the blocks that are for one."""
        return "".join(map(_in_notebook, blocks_at([*self.lead, *self.blocks], Where.NOTEBOOK)))


class Result:
    """Base of results: `print` says what the command says, a notebook shows the tables, and `repr` is a line."""

    def _rows(self) -> dict[str, str]:
        """Its parts by name: arrays and tables by their shapes, several things by their number."""
        return {name: _brief(value) for name, value in vars(self).items()}

    def _document(self) -> Document:
        title = f"{type(self).__name__} {getattr(self, 'folder', '')}".strip()
        return Document(title, (), [Table(title, (), list(self._rows().items()), where=Where.EVERYWHERE)])

    def __str__(self) -> str:
        """Text of its document, as its command prints it."""
        return str(self._document())

    def __repr__(self) -> str:
        """Its place, and its outcome or what it has, in a line."""
        lead = " ".join(_lines(self._document().lead)) or ", ".join(map(" ".join, self._rows().items()))
        return f"<{type(self).__name__} {getattr(getattr(self, 'run', self), 'folder', '')}".rstrip() + f": {lead}>"

    def _repr_html_(self) -> str | None:
        return self._document().notebook() or None


def _brief(value: object) -> str:
    if isinstance(value, tuple | list | dict) or hasattr(value, "__dataclass_fields__"):
        return f"{len(value):,}" if isinstance(value, Sized) else type(value).__name__
    return f"shape {value.shape}" if hasattr(value, "shape") else shorten(str(value), 60, placeholder=" …")


def _lines(blocks: Iterable[Block], where: Where = Where.BRIEF) -> Iterator[str]:
    for block in blocks_at(blocks, where):
        match block:
            case Heading() | Text():
                yield from wrap(block.text, 100)
            case Items():
                yield from (line for text in block.texts for line in wrap(f"- {text}", 100, subsequent_indent="  "))
            case Fold() | BlockRow():
                yield from _lines(block.blocks, where)
            case Table():
                rows = [*([block.header] if any(block.header) else []), *block.texts]
                widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
                yield from [block.title] if block.title else []
                yield from ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def blocks_at(blocks: Iterable[Block], where: Where) -> list[Block]:
    """Blocks that a place shows: nothing that is empty, and no heading with nothing below it."""
    kept: list[Block] = []
    for block in reversed(list(blocks)):
        if isinstance(block, Fold | BlockRow):
            block = replace(block, blocks=blocks_at(block.blocks, where))
        if where not in block.where or not _content(block):
            continue
        headings = [heading for heading in kept[-1:] if isinstance(heading, Heading)]
        if isinstance(block, Heading) and (not kept or any(heading.level <= block.level for heading in headings)):
            continue
        kept.append(block)
    return kept[::-1]


def _content(block: Block) -> object:
    match block:
        case Heading() | Text():
            return block.text
        case Items():
            return block.texts
        case Tiles():
            return block.results
        case Table():
            return block.rows
        case Figure():
            return block.draw
        case Fold() | BlockRow():
            return block.blocks


def _in_notebook(block: Block) -> str:
    match block:
        case Table():
            return column_table(block.title, block.header, block.texts)
        case Items():
            return "".join(f"<p>{escape(text)}</p>" for text in block.texts)
        case Text():
            return f"<p><b>{escape(block.text)}</b></p>" if block.style == "bad" else f"<p>{escape(block.text)}</p>"
    return ""
