"""The list of a finished run's files, with the size and the checksum of each: `files` of `run.json`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TypedDict


class ListedFile(TypedDict):
    """Size of a file in bytes, and its SHA-256 as 64 hexadecimal digits."""

    bytes: int
    sha256: str


FileList = dict[str, ListedFile]
"""By path inside the run directory, with `/` between folders, in alphabetical order."""


def file_list(folder: Path, names: Iterable[str]) -> FileList:
    """The list of some files of a folder; `names` are their paths inside it."""
    return {name: listed(folder / name) for name in sorted(names)}


def listed(path: Path) -> ListedFile:
    """What the list says of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
        return {"bytes": file.tell(), "sha256": digest.hexdigest()}
