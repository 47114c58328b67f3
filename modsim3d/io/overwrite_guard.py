"""Guard of the files that a command writes: none that another process writes, none that it reads, and none unasked."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from modsim3d.core.errors import OutputError
from modsim3d.io.atomic_write import partial_of
from modsim3d.io.locks import lock_of, locked_file

# ---- Which file a path leads to ----

Identity = tuple[int, int]
"""Device and number of a file or folder, which all its names share."""


def identity(path: Path) -> Identity | None:
    """Identity of what a path leads to; None if nothing is there, or if that cannot be told."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def identities(paths: Iterable[Path]) -> set[Identity]:
    """Identities of what some paths lead to; those that lead nowhere are left out."""
    return {found for path in paths if (found := identity(path)) is not None}


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path leads into a folder or to it; neither needs to be there."""
    real = Path(os.path.realpath(path))
    if real.is_relative_to(os.path.realpath(folder)):
        return True
    there = identity(folder)
    return there is not None and any(identity(above) == there for above in (real, *real.parents))


@contextmanager
def claimed(paths: Iterable[Path], *, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Check that files may be written, before the work, and hold their locks until they are.

    Args:
        paths: The files; folders that are not there are made.
        overwrite: Replace files that are there.
        inputs: What the command reads: files, which are never replaced, and folders, in which nothing is written.

    Raises:
        OutputError: One of the files may not be written, or cannot be.
    """
    inputs = tuple(inputs)
    with ExitStack() as locks:
        for path in paths:
            check_free(path, overwrite, inputs)
            locks.enter_context(_locked(path))
            check_free(path, overwrite, inputs)  # another process may have ended just now
        yield


@contextmanager
def claimed_folders(patterns: Mapping[Path, str], *, overwrite: bool, inputs: Iterable[Path] = ()) -> Iterator[None]:
    """Claim folders all of whose files are written; each has the pattern of the names that it may hold.

    Raises:
        OutputError: One of the folders may not be written, or cannot be.
    """
    inputs = tuple(inputs)
    with ExitStack() as locks:
        for path, pattern in patterns.items():
            check_not_read(path, inputs)
            check_free_folder(path, pattern, overwrite)
            locks.enter_context(_locked(path))
            check_free_folder(path, pattern, overwrite)  # another process may have ended just now
        yield


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with ExitStack() as lock:
        try:
            lock.enter_context(locked_file(path))
        except OSError as error:
            raise OutputError(f"{path} cannot be written to: {error.strerror or error}") from error
        yield


def check_free_folder(path: Path, pattern: str, overwrite: bool) -> None:
    """Check that a folder may be written; see `claimed_folders`.

    Raises:
        OutputError: It is a file, holds other files than those of its pattern, or any that are not to be overwritten.
    """
    if not path.exists() and not path.is_symlink():
        return
    if not path.is_dir():
        raise OutputError(f"{path} is a file, and a folder is to be written there: choose another name")
    names = sorted(entry.name for entry in path.iterdir())
    if strange := [name for name in names if not Path(name).match(pattern)]:
        raise OutputError(f"{path} holds other files than {pattern} ({strange[0]}): choose another folder")
    if names and not overwrite:
        raise OutputError(f"{path} exists: use --overwrite, or choose another name")


def check_free(path: Path, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check that a file may be written; see `claimed`.

    Raises:
        OutputError: It is a folder, a device or a link to itself, is an input, or exists and is not to be overwritten.
    """
    if Path(os.path.realpath(path)).is_symlink():
        raise OutputError(f"{path} is a link that leads to itself: choose another name")
    check_not_read(path, inputs)
    if not path.exists():
        _check_folder(path)
        return
    if path.is_dir():
        raise OutputError(f"{path} is a folder: choose another name")
    if not path.is_file():
        raise OutputError(f"{path} is not a regular file, and only such files are written: choose another name")
    if not overwrite:
        raise OutputError(f"{path} exists: use --overwrite, or choose another name")


def _check_folder(path: Path) -> None:
    """Check that no file is in the place of a folder that a file would be written into."""
    there = next((parent for parent in path.parents if parent.exists()), None)
    if there is not None and not there.is_dir():
        raise OutputError(f"{there} is a file, and {path.name} is to be written into a folder: choose another name")


def check_not_read(path: Path, inputs: Iterable[Path]) -> None:
    """Check that a file or folder that is written is not what is read, by whatever name; see `claimed`.

    Raises:
        OutputError: It is.
    """
    written = {identity(place): place for place in (path, partial_of(path), lock_of(path))}
    for read in inputs:
        if (found := identity(read)) is not None and found in written:
            what = path if written[found] == path else f"{written[found]}, which is used while {path} is written,"
            raise OutputError(f"{what} is read by this command, so it is not written over: choose another name")
        if not read.is_file() and is_inside(path, read):
            raise OutputError(f"{path} is inside {read}, which this command reads: choose another folder")
