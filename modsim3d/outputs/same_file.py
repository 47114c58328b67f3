"""Which file a path leads to, through links, in any spelling, and where the case of a name means nothing."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

Identity = tuple[int, int]
"""Device and number of a file or folder, which all its names share."""


def identity(path: Path) -> Identity | None:
    """What a path leads to; None if nothing is there, or if that cannot be told."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def identities(paths: Iterable[Path]) -> set[Identity]:
    """What some paths lead to; those that lead nowhere are left out."""
    return {found for path in paths if (found := identity(path)) is not None}


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path leads into a folder or to it; neither needs to be there."""
    real = Path(os.path.realpath(path))
    if real.is_relative_to(os.path.realpath(folder)):
        return True
    there = identity(folder)
    return there is not None and any(identity(above) == there for above in (real, *real.parents))
