"""The errors that modsim3d raises on purpose; who calls Python reads arguments where the command line has options."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path
from traceback import walk_tb
from types import FrameType, TracebackType

MAX_LINES, MAX_LINE_LENGTH = 500, 2000  # names in an input may be a megabyte long, and each of a million entries wrong
_OPTION = re.compile(r"--([a-z][a-z-]*)( (?=[A-Z]|-?\d))?")  # with the space before a number or what stands for a value


class ModsimError(Exception):
    """Base of every error that a user can cause; the command line prints it and exits with status 2. Who calls a
    function reads the names of its arguments where the command line has options."""

    def __str__(self) -> str:
        """The message."""
        return as_raised(super().__str__(), self.__traceback__)


class InputError(ModsimError):
    """All problems of an input, found in one pass.

    Attributes:
        source: The file or object with the problems.
        problems: One line each: where it is, what was found, what would be right. Very long lines lose their middle,
            and of very many lines only the first are kept.
    """

    def __init__(self, source: str, problems: Iterable[str]) -> None:
        """Build the message, with one line a problem."""
        self.source = source
        self._problems = _shortened(problems)
        super().__init__("\n".join([f"{source}:", *(f"  {problem}" for problem in self._problems)]))

    @property
    def problems(self) -> tuple[str, ...]:
        """The problems, one line each."""
        return tuple(as_raised(problem, self.__traceback__) for problem in self._problems)

    def reworded(self, words: Mapping[str, str]) -> InputError:
        """The error with other words in place of regular expressions, the first of them first."""
        source, problems = self.source, list(self._problems)
        for pattern, word in words.items():
            source, *problems = (re.sub(pattern, word, text) for text in (source, *problems))
        return InputError(source, problems)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, tuple[str, ...]]]:
        """Arguments to rebuild it from in another process."""
        return InputError, (self.source, self._problems)


def _shortened(problems: Iterable[str]) -> tuple[str, ...]:
    lines = list(problems)
    if len(lines) > MAX_LINES + 1:
        lines = [*lines[:MAX_LINES], f"… and {len(lines) - MAX_LINES:,} more"]
    half = MAX_LINE_LENGTH // 2
    return tuple(line if len(line) <= MAX_LINE_LENGTH else f"{line[:half]} … {line[-half:]}" for line in lines)


class RendererError(ModsimError):
    """No OpenGL software renderer can be used, or it does not do what the ID pass needs."""


class OutputError(ModsimError):
    """An output cannot be written, is taken, or is being written by another process."""


class RunDirectoryError(ModsimError):
    """A run directory cannot be created, read or resumed."""


def as_raised(text: str, raised: TracebackType | None) -> str:
    """The text of an error for who caught it: with arguments of the function that was called, if who caught it is no
    part of modsim3d and the function is none of the command line."""
    inside = [frame for frame, _ in walk_tb(raised) if _in_package(frame)]
    if raised is None or _in_package(raised.tb_frame) or not inside or _in_package(inside[0], "modsim3d.cli."):
        return text
    code = inside[0].f_code
    return with_arguments(text, code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])


def _in_package(frame: FrameType, package: str = "modsim3d.") -> bool:
    return str(frame.f_globals.get("__name__")).startswith(package)


def with_arguments(text: str, parameters: Collection[str] = ()) -> str:
    """The text with arguments in place of options. Commands that stand alone on an indented line, to be typed, stay."""
    if "--" not in text and "modsim3d " not in text:
        return text
    phrases, names = _table()

    def argument(match: re.Match[str]) -> str:
        candidates = names.get(match[1]) or [match[1].replace("-", "_")]
        name = next((candidate for candidate in candidates if candidate in parameters), candidates[0])
        return name if match[2] is None else f"{name}="

    lines = text.split("\n")
    for place, line in enumerate(lines):
        if not line.startswith("  modsim3d"):
            for pattern, phrase in phrases.items():
                line = pattern.sub(phrase, line)
            lines[place] = _OPTION.sub(argument, line)
    return "\n".join(lines)


@cache
def _table() -> tuple[dict[re.Pattern[str], str], dict[str, list[str]]]:
    """Phrases by what they replace, and the arguments that an option may be."""
    import yaml  # only where something is wrong

    table = yaml.safe_load(Path(__file__).with_name("arguments.yaml").read_text(encoding="utf-8"))
    return {re.compile(pattern): phrase for pattern, phrase in table["phrases"].items()}, table["names"]
