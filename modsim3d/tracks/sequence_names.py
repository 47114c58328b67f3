"""Names of the sequences that cameras become in other programs' files."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

SEQUENCE_HEADING = "name"
"""The first line of a sequence map; some programs skip every line like it, so that no sequence has this name."""
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.-]")


def plain_name(wanted: str) -> str:
    """A name without the characters that names of files had better not have."""
    return _NOT_IN_NAMES.sub("_", wanted)


def free_name(wanted: str, given: Collection[str]) -> str:
    """A name for a sequence like the one that is wanted, which none of the given has in upper or lower case."""
    plain, taken = plain_name(wanted), {SEQUENCE_HEADING, *(name.lower() for name in given)}
    name, number = plain, 1
    while name.lower() in taken:
        number += 1
        name = f"{plain}-{number}"
    return name


def camera_sequence_names(cameras: Sequence[str]) -> tuple[str, ...]:
    """The sequence of each camera, by the names of all cameras."""
    names: list[str] = []
    for camera in cameras:
        names.append(free_name(camera, names))
    return tuple(names)
