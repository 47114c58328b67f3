"""Output to the terminal: how much is asked for, and any text without its control characters."""

from __future__ import annotations

import io
import json
import os
import re
import select
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from time import perf_counter
from typing import TYPE_CHECKING, Any

import typer

from modsim3d.core.errors import InputError, ModsimError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text as Styled

# ---- Output to the terminal ----

UNBROKEN = 100_000  # columns of a console that breaks no line
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
class Verbosity:
    """Amount of output that the command line asks for."""

    quiet: bool = False  # nothing but warnings and errors
    verbose: bool = False  # also what is read, by which programs, and how long each part takes
    json: bool = False  # the result as JSON on standard output, and no text there


_asked = Verbosity()


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
        from importlib.metadata import version

        own, python = f"modsim3d {version('modsim3d')}", f"Python {'.'.join(map(str, sys.version_info[:3]))}"
        libraries = (f"{name} {version(name)}" for name in ("numpy", "scipy", "shapely", "pyarrow", "PyOpenGL"))
        tell("versions", ", ".join([own, python, *libraries]))
    return value


def _check_not_both() -> None:
    if _asked.quiet and _asked.verbose:
        raise ModsimError("--quiet and --verbose contradict each other: leave one out")


def ask_json(value: bool) -> bool:
    """Take `--json` from the command line."""
    _asked.json = value
    return value


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


def is_verbose() -> bool:
    """Whether `--verbose` is asked for."""
    return _asked.verbose


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
    """A console of rich that takes text as it is: no markup, no emoji, and control characters visible. It writes
    nothing that is not asked for, and breaks no line in a file or a pipe, unless `COLUMNS` says where."""
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
    """Raise a `ModsimError` for control characters in arguments, which messages about wrong arguments would repeat, and
    for other than UTF-8: names of files stand in JSON and tables, which are UTF-8."""
    for argument in arguments:
        if _BREAKS.search(argument):
            shown = _BREAKS.sub(_escaped, argument)[:200]
            raise ModsimError(f"the argument '{shown}' has control characters: rename the file, or write it without")
        if any("\ud800" <= character <= "\udfff" for character in argument):
            raise ModsimError(f"the argument '{argument[:200]}' is not UTF-8: rename the file")


# ---- Standard output and standard error of the command line ----


class _Descriptor(io.FileIO):
    """A descriptor to write to that raises nothing, so that no output decides how a command ends."""

    problem: OSError | None = None  # why something was lost, other than that nobody reads it; None: nothing
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
    """Reason why standard output could not all be written, as on a full disk; None if all was, or nobody read it."""
    if sys.stdout is None or not isinstance(sys.stdout, io.TextIOWrapper):
        return None
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    return raw.problem if isinstance(raw, _Descriptor) else None


def write_at_once(data: bytes) -> bool:
    """Write bytes to standard output past its buffer; False if nobody reads it any more, or it cannot be written to.
    Nothing is left for later, so that it can be interrupted. Raises ModsimError if there is no standard output."""
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
