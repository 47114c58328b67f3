"""Files written whole: beside their place first, onto the disk, and then renamed, so that no half file is ever seen."""

from __future__ import annotations

import errno
import io
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson

from modsim3d.core.errors import OutputError
from modsim3d.io.operating_system import FOLDER

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from PIL.Image import Image


@contextmanager
def put_in_place(path: Path) -> Iterator[Path]:
    """A path to write a file to; the file gets its final name when it is complete, and is removed on an error. Raises
    OutputError if the file cannot be written."""
    with ExitStack() as writing, _name_file(path):
        yield writing.enter_context(written_whole(path))
        writing.close()


def write_files(contents: Mapping[Path, bytes | str]) -> None:
    """Write files; none of them gets its place before all of them are complete. Folders are made where there are none.
    Raises OutputError if a file cannot be written."""
    with ExitStack() as places:
        for path, content in contents.items():
            with _name_file(path):
                make_folder(path.parent)
            partial = places.enter_context(put_in_place(path))
            with _name_file(path):
                partial.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
                sync_file(partial)  # so that all get their places within a moment


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """As `put_in_place`, with errors of the system as they are."""
    final, partial = Path(os.path.realpath(path)), partial_of(path)
    try:
        partial.unlink(missing_ok=True)  # an encoder that outlives a killed command may write to it still
        partial.open("wb").close()  # an error comes before the work
        yield partial
        place(partial, final)
        sync_folder(final.parent)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


@contextmanager
def put_folder_in_place(folder: Path, pattern: str) -> Iterator[Path]:
    """A folder to write files to; it gets its final name when all of them are complete, and is removed on an error. A
    folder that is there is replaced. Raises OutputError if it cannot be written, or holds files whose names do not
    match the pattern."""
    final, partial = Path(os.path.realpath(folder)), partial_of(folder)
    before = partial.with_name(f".{final.name}.replaced")
    try:
        with _name_file(folder):
            if before.exists() and not final.exists():
                before.replace(final)  # a command was killed between the two renames below
            if final.exists() and not all(path.match(pattern) for path in final.iterdir()):
                raise OutputError(f"{folder} holds other files than {pattern}: choose another folder")
            for left in (partial, before):
                if left.exists():
                    shutil.rmtree(left)
            partial.mkdir(parents=True)
            yield partial
            for path in partial.iterdir():
                sync_file(path)
            sync_folder(partial)
            if final.exists():
                final.replace(before)
            partial.replace(final)
            sync_folder(final.parent)
    finally:
        if before.exists() and not final.exists():
            before.replace(final)
        shutil.rmtree(before, ignore_errors=True)
        shutil.rmtree(partial, ignore_errors=True)
        with suppress(OSError):  # the folder is there already
            sync_folder(final.parent)


def partial_of(path: Path) -> Path:
    """Place of a file until it is complete: hidden, beside its place, or beside that of the file a link leads to."""
    final = Path(os.path.realpath(path))
    return final.with_name(f".{final.stem}.partial{final.suffix}")


@contextmanager
def _name_file(path: Path) -> Iterator[None]:
    """Name a file in errors of its writing; an error that names another file belongs to that one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and partial_of(path) not in (at := Path(str(error.filename)), at.parent):
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


def make_folder(folder: Path) -> list[Path]:
    """Make a folder, and wait until its name is on the disk; the folders that were not there, from the inside out."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for path in made:
        with suppress(PermissionError):  # its parent may not be listed
            sync_folder(path.parent)
    return made


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where its file system knows how."""
    if FOLDER is None:
        return
    descriptor = os.open(folder, FOLDER)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)


def json_text(content: Any) -> bytes:
    """JSON for people to read: two spaces of indentation, and a line break at the end."""
    return orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_NON_STR_KEYS | orjson.OPT_APPEND_NEWLINE)


def encoded(picture: Image | ArrayLike, ending: str = ".png", **options: Any) -> bytes:
    """The content of a PNG or JPEG file of a picture without a palette or an array; options are of the format."""
    import numpy as np
    from PIL import Image  # by imageio, Pillow would first import its readers of all formats

    content = io.BytesIO()
    Image.fromarray(np.asarray(picture)).save(content, "PNG" if ending == ".png" else "JPEG", **options)
    return content.getvalue()
