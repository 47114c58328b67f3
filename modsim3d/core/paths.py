"""Paths as functions take them: text or any path object."""

import os
from pathlib import Path
from typing import TypeAlias

from modsim3d.core.errors import ModsimError

StrPath: TypeAlias = str | os.PathLike[str]  # what a function takes for a path


def as_path(value: object, name: str, needed: str = "a path") -> Path:
    """The path that an argument of a name stands for; `needed` is what it may be, for messages. Raises TypeError if it
    is not a path, and ModsimError if it cannot be the name of a file."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str):  # a path of bytes is no path here
        raise TypeError(f"{name}: {needed} is needed (got {type(value).__name__})")
    if not text:
        raise ModsimError(f"{name}: {needed} is needed (got an empty text)")
    if "\0" in text:
        raise ModsimError(f"{name}: a path cannot hold the character NUL (got {text!r:.60})")
    return Path(text)


def out_file(out: StrPath | None, usual: Path) -> Path:
    """The file that is named, or else `usual`: in a folder that exists under its usual name, as `cp` does it."""
    path = usual if out is None else as_path(out, "out")
    return path / usual.name if out is not None and path.is_dir() else path
