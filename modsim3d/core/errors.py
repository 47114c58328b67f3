"""The errors that modsim3d raises on purpose."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from modsim3d.core.arguments import as_raised

MAX_LINES, LONGEST_LINE = 500, 2000  # names in an input may be a megabyte long, and each of a million entries wrong


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
    half = LONGEST_LINE // 2
    return tuple(line if len(line) <= LONGEST_LINE else f"{line[:half]} … {line[-half:]}" for line in lines)


class RendererError(ModsimError):
    """No OpenGL software renderer can be used, or it does not do what the ID pass needs."""


class OutputError(ModsimError):
    """An output cannot be written, is taken, or is being written by another process."""


class RunDirectoryError(ModsimError):
    """A run directory cannot be created, read or resumed."""
