"""The errors that modsim3d raises on purpose."""

from __future__ import annotations

from collections.abc import Iterable


class ModsimError(Exception):
    """Base of every error that a user can cause; the command line prints it and exits with status 2."""


class InputError(ModsimError):
    """All problems of an input, found in one pass.

    Attributes:
        source: The file or object with the problems.
        problems: One line each: where it is, what was found, what would be right.
    """

    def __init__(self, source: str, problems: Iterable[str]) -> None:
        """Build the message, with one line a problem."""
        self.source = source
        self.problems = tuple(problems)
        super().__init__("\n".join([f"{source}:", *(f"  {problem}" for problem in self.problems)]))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, tuple[str, ...]]]:
        """Arguments to rebuild it from in another process."""
        return InputError, (self.source, self.problems)


class RendererError(ModsimError):
    """No OpenGL software renderer can be used, or it does not do what the ID pass needs."""


class OutputError(ModsimError):
    """An output cannot be written, is taken, or is being written by another process."""


class RunDirectoryError(ModsimError):
    """A run directory cannot be created, read or resumed."""
