"""Output to the terminal: how much is asked for, and any text without its control characters."""

from __future__ import annotations

import io
import json
import os
import re
import select
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from time import perf_counter
from typing import TYPE_CHECKING, Any

import typer

from modsim3d.core.document import Beside, Block, Document, Fold, Heading, Items, Style, Table, Text, Where, shown
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.text import is_numeric

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text as Styled

# ---- Output to the terminal ----

UNBROKEN = 100_000
"""Columns of a console that breaks no line."""
_CONTROL = r"\x00-\x1f\x7f-\x9f"
_BREAKS = re.compile(f"[{_CONTROL}]")
# Also marks that turn or hide text: of direction, of width zero, line separators, halves of characters, and tags.
_HIDDEN = re.compile(
    r"(?![\n\t])"
    f"[{_CONTROL}\u00ad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)


def _escaped(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape").decode("ascii")


def visible(text: str) -> str:
    r"""The text with its control characters as `\x1b`, since a terminal obeys them; lines and tabs stay."""
    return _HIDDEN.sub(_escaped, text)


def wrapped(text: str, width: int) -> list[str]:
    """Text broken between words into lines of a width; longer words stay whole."""
    from rich.cells import cell_len

    if cell_len(text) <= width:
        return [text]
    return textwrap.wrap(text, max(width, 1), break_long_words=False, break_on_hyphens=False)


@dataclass
class Asked:
    """Amount of output that the command line asks for.

    Attributes:
        quiet: Nothing but warnings and errors.
        verbose: Also what is read, by which programs, and how long each part takes.
        json: The result as JSON on standard output, and no text there.
    """

    quiet: bool = False
    verbose: bool = False
    json: bool = False


_asked = Asked()


def start_afresh() -> None:
    """Forget what an earlier command of this process was asked."""
    _asked.quiet = _asked.verbose = _asked.json = False


def ask_quiet(value: bool) -> bool:
    """Take `--quiet` from the command line."""
    _asked.quiet = value
    _check_not_both()
    return value


def ask_verbose(value: bool) -> bool:
    """Take `--verbose` from the command line, and tell the versions of the programs."""
    _asked.verbose = value
    _check_not_both()
    if value:
        tell("versions", _versions())
    return value


def _check_not_both() -> None:
    if _asked.quiet and _asked.verbose:
        raise ModsimError("--quiet and --verbose contradict each other: leave one out")


def ask_json(value: bool) -> bool:
    """Take `--json` from the command line."""
    _asked.json = value
    return value


def _versions() -> str:
    from importlib.metadata import version

    python = ".".join(map(str, sys.version_info[:3]))
    names = ("numpy", "scipy", "shapely", "pyarrow", "PyOpenGL")
    return ", ".join([f"modsim3d {version('modsim3d')}", f"Python {python}", *(f"{n} {version(n)}" for n in names)])


def say(text: str, *, err: bool = False) -> None:
    """Write text and a line break to standard output, unless it is not asked for, or to standard error."""
    if err or not (_asked.quiet or _asked.json):
        typer.echo(visible(text), err=err)


def warn(text: str) -> None:
    """Write a warning to standard error, whatever is asked for."""
    if sys.stdout is not None:
        sys.stdout.flush()  # it stands after what it is about, where both go to one place
    _say_prose([f"warning: {text}"], "yellow")


def remark(text: str) -> None:
    """Write text to standard error unless it is not asked for: what a command says while standard output has data."""
    if not _asked.quiet:
        say(text, err=True)


def tell(name: str, text: str) -> None:
    """Write what only `--verbose` asks for to standard error."""
    if _asked.verbose:
        typer.echo(visible(f"{name:<9} {text}"), err=True)


def tell_files(paths: Iterable[Path]) -> None:
    """Tell which files are read, of those that are there."""
    if _asked.verbose:
        for path in filter(Path.exists, paths):
            tell("read", str(path))


@contextmanager
def timed(part: str) -> Iterator[None]:
    """Tell how long a part of a command takes."""
    started = perf_counter()
    yield
    tell("time", f"{perf_counter() - started:7.2f} s  {part}")


def say_json(content: Mapping[str, Any]) -> None:
    """Write the result as one line of JSON to standard output if `--json` asks for it: numbers are finite or null."""
    if not _asked.json:
        return
    import orjson

    options = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS
    line = orjson.dumps(content, default=_path_text, option=options).decode()
    typer.echo(_HIDDEN.sub(lambda match: json.dumps(match[0])[1:-1], line).encode())


def _path_text(value: object) -> str:
    """A path as text; JSON is UTF-8, which the name of a folder above need not be."""
    if not isinstance(value, PurePath):
        raise TypeError(f"{type(value)} has no place in JSON")
    return str(value).encode("utf-8", "replace").decode()


def say_error(error: ModsimError) -> None:
    """Write an error to standard error, each problem of an input on a line of its own."""
    lines = [str(error)]
    if isinstance(error, InputError):
        lines = [f"{error.source}:", *(f"  {problem}" for problem in error.problems)]
        lines = [_BREAKS.sub(_escaped, line) for line in lines]
    _say_prose(("modsim3d: " + "\n".join(lines)).split("\n"))


def _say_prose(lines: Iterable[str], style: str = "") -> None:
    """Write lines to standard error, on a terminal broken between words."""
    console = open_console(stderr=True, quiet=False)
    # Not by COLUMNS alone: readline sets it for every program that an interactive Python starts.
    width = console.width if console.is_terminal else UNBROKEN
    for line in lines:
        words = visible(line).lstrip(" ")
        indent = " " * (len(line) - len(line.lstrip(" ")))
        for piece in wrapped(words, width - len(indent)):
            console.print(indent + piece, style=style, highlight=False, soft_wrap=True)


def open_console(**options: Any) -> Console:
    """A console of rich that takes text as it is: no markup, no emoji, and control characters visible.

    It writes nothing that is not asked for, and breaks no line in a file or a pipe, unless `COLUMNS` says where.
    """
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class PlainConsole(Console):
        def render_str(self, text: str, **rest: Any) -> Styled:
            return super().render_str(visible(text), **rest)

        def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
            for text, style, control in super().render(renderable, options):
                yield Segment(text if control else visible(text), style, control)

    options.setdefault("quiet", _asked.quiet or (_asked.json and not options.get("stderr")))
    console = PlainConsole(markup=False, emoji=False, **options)
    if not (console.is_terminal or "width" in options or "COLUMNS" in os.environ):
        console.width = UNBROKEN
    return console


def check_arguments(arguments: Iterable[str]) -> None:
    """Refuse control characters in arguments, which messages about wrong arguments would repeat, and other than UTF-8.

    Names of files stand in JSON and tables, which are UTF-8.

    Raises:
        ModsimError: An argument has one.
    """
    for argument in arguments:
        if _BREAKS.search(argument):
            shown = _BREAKS.sub(_escaped, argument)[:200]
            raise ModsimError(f"the argument '{shown}' has control characters: rename the file, or write it without")
        if any("\ud800" <= character <= "\udfff" for character in argument):
            raise ModsimError(f"the argument '{argument[:200]}' is not UTF-8: rename the file")


# ---- Standard output and standard error of the command line ----


class _Descriptor(io.FileIO):
    """A descriptor to write to that raises nothing, so that no output decides how a command ends.

    Attributes:
        problem: Why something could not be written, other than that nobody reads it; None if nothing was lost.
        unread: Nobody reads it any more.
    """

    problem: OSError | None = None
    unread = False

    def write(self, data: object, /) -> int:
        """Write data, or drop it."""
        view = memoryview(data)  # type: ignore[arg-type]
        try:
            return super().write(view)
        except BrokenPipeError:
            self.unread = True
            return view.nbytes
        except OSError as error:
            self.problem = self.problem or error
            return view.nbytes


def prepare_output() -> None:
    """Let standard output replace what its encoding lacks, and let neither stream fail when its reader goes away."""
    if (output := _prepared(sys.stdout, "replace")) is not None:
        sys.stdout = output
    if (output := _prepared(sys.stderr, "backslashreplace")) is not None:
        sys.stderr = output


def _prepared(stream: object, errors: str) -> io.TextIOWrapper | None:
    """A stream in place of one of the interpreter's own; None if another has taken its place, as in tests."""
    if not isinstance(stream, io.TextIOWrapper):
        return None
    stream.reconfigure(errors=errors)
    raw = getattr(stream.buffer, "raw", stream.buffer)
    if type(raw) is not io.FileIO:
        return None
    stream.flush()
    descriptor = _Descriptor(raw.fileno(), "wb", closefd=False)
    return io.TextIOWrapper(
        descriptor if raw is stream.buffer else io.BufferedWriter(descriptor),
        encoding=stream.encoding,
        errors=errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def lost_output() -> OSError | None:
    """Why some of standard output could not be written, as on a full disk; None if all was, or nobody read it."""
    if sys.stdout is None or not isinstance(sys.stdout, io.TextIOWrapper):
        return None
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    return raw.problem if isinstance(raw, _Descriptor) else None


def write_at_once(data: bytes) -> bool:
    """Write bytes to standard output past its buffer; False if nobody reads it any more, or it cannot be written to.

    Nothing is left for later, so a command whose reader has stopped reading can be interrupted.

    Raises:
        ModsimError: There is no standard output.
    """
    if sys.stdout is None:
        raise ModsimError("there is no standard output to write to")
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    rest = memoryview(data)
    while rest:
        written = raw.write(rest)
        if written is None:  # a pipe that does not block is full
            select.select([], [raw], [])
        rest = rest[written or 0 :]
    return not (isinstance(raw, _Descriptor) and (raw.unread or raw.problem is not None))


# ---- Tables and prose for the terminal ----

GAP = 2
"""Spaces between columns."""
INDENT = 4
"""Spaces before what stands below a row's first cell."""
MIN_PROSE = 24
"""Columns that a text needs to be read beside the others."""
EMPTY = ("", "–")

Cells = Sequence[str]
Line = list[tuple[str, str]]
"""Pieces of text, each with its style."""


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
    """Print rows under a title: as a table, or where that is too wide, each row on lines of its own.

    Args:
        console: Where to.
        title: Empty for none.
        rows: Cells of equal number; nothing is printed if there are none.
        header: Names of the columns; without it the first and the last are text that may be broken between words.
        right: Columns whose cells stand on the right.
        styles: Style of each column.
        row_styles: Style of each row, in place of that of its cells.
        breaks: Ways to break cells after the first into lines; the first that fits is taken.
        at_edge: Column that stands at the right edge of a row that has lines of its own.
    """
    if not rows:
        return
    if title:
        console.print()
        print_prose(console, title, "bold")
    table = [[visible(cell) for cell in row] for row in ([header, *rows] if header else rows)]
    for names, broken in [(_whole, _whole), *((_in_two, each) for each in (_whole, *breaks) if breaks)]:
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


def _whole(cell: str) -> str:
    return cell


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
    least = [max([MIN_PROSE, *_word_lengths(columns[place])]) for place in (0, -1)]
    least_first, least_last = min(least[0], widths[0]), min(least[1], widths[-1])
    if widths[0] + room >= least_first:  # a long name before short values
        return [widths[0] + room, *widths[1:]]
    if widths[-1] + room >= least_last:
        return [*widths[:-1], widths[-1] + room]
    last = widths[-1] + room + widths[0] - least_first
    return [least_first, *widths[1:-1], last] if last >= least_last else []


def _word_lengths(column: Sequence[Sequence[str]]) -> list[int]:
    from rich.cells import cell_len

    return [cell_len(word) for cell in column for line in cell for word in line.split()]


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
    _print_whole(console, text)


def _print_whole(console: Console, text: Styled) -> None:
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
OUTCOMES = ("verdict", "outcome")
"""Columns that stand at the right edge where each row has lines of its own."""


def print_document(console: Console, document: Document) -> None:
    """Print what a terminal shows of a document; its outcome stands last, where it is seen."""
    print_blocks(console, document.blocks)
    console.print()
    print_blocks(console, document.lead)


def print_blocks(console: Console, blocks: Iterable[Block]) -> None:
    """Print blocks; a table with a title of its own has no heading besides."""
    heading = Heading("")
    for block in shown(blocks, Where.TERMINAL):
        if isinstance(block, Heading):
            heading = block
            continue
        if isinstance(block, Table) and block.title:
            heading = Heading(block.title)
        if isinstance(block, Beside):
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
    columns = [column for column in whole if any(column)]
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
