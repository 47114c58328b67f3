"""What the commands write to the terminal: any text of an input, without its control characters, in any encoding."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import typer

from modsim3d.errors import InputError, ModsimError

if TYPE_CHECKING:
    from rich.console import Console

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


def say(text: str, *, err: bool = False) -> None:
    """Write text and a line break to standard output, or to standard error."""
    typer.echo(visible(text), err=err)


def say_error(error: ModsimError) -> None:
    """Write an error to standard error, each problem of an input on a line of its own."""
    lines = [str(error)]
    if isinstance(error, InputError):
        lines = [f"{error.source}:", *(f"  {problem}" for problem in error.problems)]
        lines = [_BREAKS.sub(_escaped, line) for line in lines]
    say("modsim3d: " + "\n".join(lines), err=True)


def open_console(**options: Any) -> Console:
    """A console of rich that takes text as it is: no markup, no emoji, and control characters visible."""
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment
    from rich.text import Text

    class PlainConsole(Console):
        def render_str(self, text: str, **rest: Any) -> Text:
            return super().render_str(visible(text), **rest)

        def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
            for text, style, control in super().render(renderable, options):
                yield Segment(text if control else visible(text), style, control)

    return PlainConsole(markup=False, emoji=False, **options)


def prepare_output() -> None:
    """Let standard output replace what its encoding lacks; standard error does so by itself."""
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="replace")


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
