"""Tables, prose and documents as the terminal shows them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from modsim3d.cli.terminal import is_verbose, visible, wrapped
from modsim3d.core.document import Block, BlockRow, Document, Fold, Heading, Items, Style, Table, Text, Where, blocks_at
from modsim3d.core.text import is_numeric, with_minus

if TYPE_CHECKING:
    from rich.console import Console

# ---- Tables and prose for the terminal ----

GAP = 2  # spaces between columns
INDENT = 4  # spaces before what stands below a row's first cell
MIN_PROSE = 24  # columns that a text needs to be read beside the others
EMPTY = ("", "–")

Cells = Sequence[str]
Line = list[tuple[str, str]]  # pieces of text, each with its style


def print_table(
    console: Console,
    title: str,
    rows: Sequence[Cells],
    *,
    header: Cells = (),
    right: Collection[int] = (),
    styles: Sequence[str] = (),
    row_styles: Sequence[str] = (),
    breaks: Sequence[Callable[[str], str]] = (),
    at_edge: int | None = None,
) -> None:
    """Print rows under a title: as a table, or where that is too wide, each row on lines of its own. Nothing is printed
    if there are no rows. Without a header the first and the last column are text that may be broken between words.
    `right` are columns whose cells stand on the right, `at_edge` one that stands at the right edge of a row that has
    lines of its own. A row's style takes the place of that of its cells. `breaks` are ways to break cells after the
    first into lines; the first that fits is taken."""
    if not rows:
        return
    if title:
        console.print()
        print_prose(console, title, "bold")
    table = [[visible(cell) for cell in row] for row in ([header, *rows] if header else rows)]
    whole: Callable[[str], str] = str
    for names, broken in [(whole, whole), *((_in_two, breaker) for breaker in (whole, *breaks) if breaks)]:
        lines = [[[row[0]], *(broken(cell).split("\n") for cell in row[1:])] for row in table]
        if header:
            lines[0] = [names(cell).split("\n") for cell in table[0]]
        if widths := _widths(lines, console.width, wraps=not header):
            _print_aligned(console, lines, widths, bool(header), right, styles, row_styles)
            return
    header, *body = [[cell.replace("\n", " ") for cell in row] for row in (table if header else [[], *table])]
    for place, row in enumerate(body):
        style = row_styles[place] if place < len(row_styles) else ""
        _print_stacked(console, row, header, at_edge, style or (styles[0] if styles else ""), style)


def _in_two(cell: str) -> str:
    """A name of a column on about two lines."""
    return "\n".join(wrapped(cell, max([(len(cell) + 1) // 2, *map(len, cell.split())])))


def _widths(table: Sequence[Sequence[Sequence[str]]], width: int, wraps: bool) -> list[int]:
    """The widths of all columns, the first and the last narrowed if they may be; empty if they do not fit."""
    from rich.cells import cell_len

    columns = list(zip(*table, strict=True))
    first, *others = ([cell_len(line) for cell in column for line in cell] for column in columns)
    widths = [max(first), *map(max, others)]
    room = width - sum(widths) - GAP * (len(widths) - 1)
    if room >= 0:
        return widths
    if not wraps or len(widths) < 2:
        return []
    words = [[word for cell in columns[place] for line in cell for word in line.split()] for place in (0, -1)]
    least = [max([MIN_PROSE, *map(cell_len, texts)]) for texts in words]
    least_first, least_last = min(least[0], widths[0]), min(least[1], widths[-1])
    if widths[0] + room >= least_first:  # a long name before short values
        return [widths[0] + room, *widths[1:]]
    if widths[-1] + room >= least_last:
        return [*widths[:-1], widths[-1] + room]
    last = widths[-1] + room + widths[0] - least_first
    return [least_first, *widths[1:-1], last] if last >= least_last else []


def _print_aligned(
    console: Console,
    table: Sequence[Sequence[Sequence[str]]],
    widths: Sequence[int],
    has_header: bool,
    right: Collection[int],
    styles: Sequence[str],
    row_styles: Sequence[str],
) -> None:
    from rich.cells import cell_len

    for number, row in enumerate(table):
        place = number - has_header
        whole = "dim" if place < 0 else row_styles[place] if place < len(row_styles) else ""
        cells = [
            [piece for line in cell for piece in wrapped(line, wide)] for cell, wide in zip(row, widths, strict=True)
        ]
        for height in range(max(map(len, cells))):
            line: Line = []
            for column, cell in enumerate(cells):
                text = cell[height] if height < len(cell) else ""
                space = " " * (widths[column] - cell_len(text))
                text = space + text if column in right else text + space
                line.append((text, whole or (styles[column] if styles else "")))
                line.append((" " * GAP, ""))
            _print_line(console, line)


def _print_stacked(
    console: Console, row: Cells, header: Cells, at_edge: int | None, style: str, row_style: str
) -> None:
    """Print the first cell, and the others below it, each after the name of its column."""
    from rich.cells import cell_len

    head, rest = row[0], list(range(1, len(row)))
    if at_edge is not None:
        space = console.width - cell_len(head) - cell_len(row[at_edge])
        if space >= GAP:
            head = f"{head}{' ' * space}{row[at_edge]}"
            rest.remove(at_edge)
    if head:  # a row may go on with the group of the row before
        _print_line(console, [(head, style)])
    pieces = [
        f"{header[column]} {row[column]}".strip() if header else row[column]
        for column in rest
        if row[column] not in EMPTY
    ]
    for line in _packed(pieces, console.width - INDENT):
        _print_line(console, [(" " * INDENT + line, row_style)])


def _packed(pieces: Sequence[str], width: int) -> list[str]:
    """Pieces on as few lines as they fit on, broken between words only where one is longer than a line."""
    from rich.cells import cell_len

    lines: list[str] = []
    for piece in pieces:
        if lines and cell_len(lines[-1]) + GAP + cell_len(piece) <= width:
            lines[-1] += " " * GAP + piece
        else:
            lines += wrapped(piece, width)
    return lines


def _print_line(console: Console, line: Line) -> None:
    from rich.text import Text as Styled

    text = Styled.assemble(*line)
    text.rstrip()
    console.print(text, highlight=False, soft_wrap=True)


def print_prose(console: Console, text: str, style: str = "", indent: int = 0) -> None:
    """Print text, broken between words."""
    for line in wrapped(visible(text), console.width - indent):
        _print_line(console, [(" " * indent + line, style)])


# ---- Documents for the terminal ----

STYLES: dict[Style, str] = {"": "", "lead": "bold", "soft": "dim", "bad": "bold red", "code": "dim"}
CELL_BREAKS: tuple[Callable[[str], str], ...] = (
    lambda cell: cell.replace(" [", "\n[").replace(" (", "\n(").replace(" to ", "\nto ").replace(" … ", " …\n"),
    lambda cell: "\n".join(cell.split()) if " to " not in cell else cell,
)
"""Where cells are broken that are too wide: first before intervals, then between all words."""
OUTCOMES = ("verdict", "outcome")  # columns that stand at the right edge where each row has lines of its own


def print_document(console: Console, document: Document) -> None:
    """Print what a terminal shows of a document; its outcome stands last, where it is seen."""
    print_blocks(console, document.blocks)
    console.print()
    print_blocks(console, document.lead)


def print_blocks(console: Console, blocks: Iterable[Block]) -> None:
    """Print blocks; a table with a title of its own has no heading besides."""
    heading = Heading("")
    for block in blocks_at(blocks, Where.FULL if is_verbose() else Where.BRIEF):
        if isinstance(block, Heading):
            heading = block
            continue
        if isinstance(block, Table) and block.title:
            heading = Heading(block.title)
        if isinstance(block, BlockRow):
            print_blocks(console, [heading, *block.blocks])
        else:
            if heading.text:
                console.print()
                print_prose(console, heading.text, STYLES["bad" if heading.bad else "lead"])
            _print_block(console, block)
        heading = Heading("")


def _print_block(console: Console, block: Block) -> None:
    match block:
        case Fold():
            print_blocks(console, [Heading(block.title), *block.blocks])
        case Table():
            _print_document_table(console, block)
        case Text():
            print_prose(console, block.text, STYLES[block.style])
        case Items():
            for item in block.texts:
                print_prose(console, item, indent=2)


def _print_document_table(console: Console, table: Table) -> None:
    """Print a table; a column of drawings alone has no text."""
    if table.about:
        print_prose(console, table.about, "dim")
    whole = list(zip(*table.texts, strict=True))
    columns = [[*map(with_minus, column)] for column in whole if any(column)]
    header = [name for name, column in zip(table.header, whole, strict=False) if any(column)]
    rows = list(zip(*columns, strict=True))
    print_table(
        console,
        "",
        rows,
        header=header,
        right={place for place, name in enumerate(header) if name and place and is_numeric(columns[place])},
        row_styles=["bold red" if row in table.bad else "dim" if row in table.soft else "" for row in range(len(rows))],
        breaks=CELL_BREAKS,
        at_edge=next((place for place, name in enumerate(header) if name in OUTCOMES), None),
    )
    for row, note in table.notes.items():
        if note:
            print_prose(console, f"{', '.join(filter(None, rows[row][:2]))}: {note}", "dim", indent=2)
