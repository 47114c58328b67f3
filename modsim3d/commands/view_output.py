"""Where `modsim3d view` writes to, and as what."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.commands.view_options import Format
from modsim3d.errors import ModsimError
from modsim3d.outputs.claims import check_not_read, claimed
from modsim3d.outputs.locks import locked_file
from modsim3d.runs.files.replacing import read_of_run

if TYPE_CHECKING:
    from modsim3d.runs.stored_run import StoredRun

FRAME_FILES = "frame_*.png"


def film_format(option: Format | None, out: Path | None) -> str:
    """The format that `--format` asks for, or the ending of the file's name.

    Raises:
        ModsimError: The two differ, or no film has such an ending.
    """
    ending = "" if out is None or out.is_dir() else out.suffix.lower().removeprefix(".")
    if option is None:
        if ending and ending not in ("mp4", "gif"):
            raise ModsimError(
                f"{out}: films cannot be written as .{ending}; use .mp4, .gif, or --format png with a folder"
            )
        return ending or "mp4"
    if ending in [known.value for known in Format] and ending != option.value:
        raise ModsimError(f"the ending of {out} contradicts --format {option.value}")
    return option.value


@contextmanager
def claimed_file(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that a picture or a film of a run can be written to a file, and hold its lock.

    Raises:
        ModsimError: Its folder is missing, or it may not be written; see `claimed`.
    """
    _check_parent(path)
    with claimed([path], overwrite=overwrite, inputs=read_of_run(run.folder)):
        yield


@contextmanager
def claimed_folder(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that the PNG files of a film of a run can be written to a folder, and hold its lock.

    Raises:
        ModsimError: It is a file, holds other files than a film's, or holds a film that is not to be overwritten.
    """
    _check_parent(path)
    check_not_read(path, read_of_run(run.folder))
    _check_free_folder(path, overwrite)
    with locked_file(path):
        _check_free_folder(path, overwrite)  # another process may have ended just now
        yield


def _check_free_folder(path: Path, overwrite: bool) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise ModsimError(f"{path} is a file: choose another name with --out")
    entries = list(path.iterdir())
    strange = [entry.name for entry in entries if not entry.match(FRAME_FILES)]
    if strange:
        raise ModsimError(f"{path} holds other files than frames of a film ({strange[0]}): choose another folder")
    if entries and not overwrite:
        raise ModsimError(f"{path} exists: use --overwrite, or another name with --out")


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
