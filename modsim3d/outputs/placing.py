"""Files written whole: beside their place first, onto the disk, and then renamed, so that no half file is ever seen."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from modsim3d.errors import OutputError


@contextmanager
def put_in_place(path: Path) -> Iterator[Path]:
    """A path to write a file to; the file gets its final name when it is complete, and is removed on an error.

    Raises:
        OutputError: The file cannot be written.
    """
    with ExitStack() as writing, _told_of(path):
        yield writing.enter_context(written_whole(path))
        writing.close()


def write_files(contents: Mapping[Path, bytes | str]) -> None:
    """Write files; none of them gets its place before all of them are complete.

    Raises:
        OutputError: A file cannot be written.
    """
    with ExitStack() as places:
        for path, content in contents.items():
            partial = places.enter_context(put_in_place(path))
            with _told_of(path):
                partial.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """As `put_in_place`, with errors of the system as they are."""
    final, partial = Path(os.path.realpath(path)), partial_of(path)
    try:
        partial.open("wb").close()  # an error comes before the work
        yield partial
        place(partial, final)
        sync_folder(final.parent)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def partial_of(path: Path) -> Path:
    """Where a file lies until it is complete: hidden, beside its place, or beside that of the file a link leads to."""
    final = Path(os.path.realpath(path))
    return final.with_name(f".{final.stem}.partial{final.suffix}")


@contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Name a file in errors of its writing; an error that names another file belongs to that one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and os.fsdecode(error.filename) != str(partial_of(path)):
            raise
        raise OutputError(f"{path} cannot be written to: {error.strerror or error}") from error


def place(partial: Path, final: Path) -> None:
    """Give a complete file its final name once it is on the disk; `sync_folder` then keeps the name there too."""
    sync_file(partial)
    partial.replace(final)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    with path.open("rb+") as written:
        os.fsync(written.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where its file system knows how."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)
