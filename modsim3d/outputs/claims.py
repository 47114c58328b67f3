"""Which files a command may write: none that another process writes, none that it reads, and none unasked."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from modsim3d.errors import OutputError
from modsim3d.outputs.locks import locked_file


@contextmanager
def claimed(paths: Iterable[Path], *, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Check that files may be written, before the work, and hold their locks until they are.

    Args:
        paths: The files; folders that are not there are made.
        overwrite: Replace files that are there.
        inputs: Files that the command reads, and folders of which it reads any file; they are never replaced.

    Raises:
        OutputError: One of the files may not be written, or cannot be.
    """
    with ExitStack() as locks:
        for path in paths:
            check_free(path, overwrite, inputs)
            try:
                locks.enter_context(locked_file(path))
            except OSError as error:
                raise OutputError(f"{path} cannot be written to: {error.strerror or error}") from error
            check_free(path, overwrite, inputs)  # another process may have ended just now
        yield


def check_free(path: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that a file may be written; see `claimed`.

    Raises:
        OutputError: It is a folder, a device or a link to itself, is an input, or exists and is not to be overwritten.
    """
    real = Path(os.path.realpath(path))
    if real.is_symlink():
        raise OutputError(f"{path} is a link that leads to itself: choose another name")
    if not path.exists():
        return
    if path.is_dir():
        raise OutputError(f"{path} is a folder: choose another name")
    if not path.is_file():
        raise OutputError(f"{path} is not a regular file, and only such files are written: choose another name")
    for read in map(os.path.realpath, inputs):
        if real == Path(read) or (Path(read).is_dir() and real.is_relative_to(read)):
            raise OutputError(f"{path} is read by this command, so it is not written over: choose another name")
    if not overwrite:
        raise OutputError(f"{path} exists: use --overwrite, or choose another name")
