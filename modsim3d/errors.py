"""The errors that modsim3d raises on purpose."""

from __future__ import annotations

from collections.abc import Iterable


class ModsimError(Exception):
    """Base of every error a user can cause: the command line prints it and exits with status 2."""


class InputError(ModsimError):
    """Everything that is wrong with an input, found in one pass.

    Attributes:
        source: The file or object the problems are in.
        problems: One line each: where, what was found, what would be right.
    """

    def __init__(self, source: str, problems: Iterable[str]) -> None:
        """Keep the problems and write the message, one line a problem."""
        self.source = source
        self.problems = tuple(problems)
        super().__init__("\n".join([f"{source}:", *(f"  {problem}" for problem in self.problems)]))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, tuple[str, ...]]]:
        """From what it is made again in another process."""
        return InputError, (self.source, self.problems)


class RendererError(ModsimError):
    """No OpenGL software renderer can be used, or it does not do what the ID pass needs."""


class RunDirectoryError(ModsimError):
    """A run directory cannot be made, read or continued."""
