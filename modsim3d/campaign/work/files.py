"""The files that a campaign is made of, by their checksums, so that a change is noticed by its name."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from modsim3d.inputs.shipped import data_folder


def checksums(paths: Iterable[Path], base: Path) -> dict[str, str]:
    """The SHA-256 of files by their paths; what ships with the package is left out, since its version is known.

    Args:
        paths: The files.
        base: The folder of the campaign file: paths of what is in it are relative to it.
    """
    shipped = (data_folder("scenes").resolve(), data_folder("meshes").resolve())
    own = sorted(path for path in set(paths) if not any(path.is_relative_to(folder) for folder in shipped))
    return {_name(path, base): _sha256(path) for path in own}


def changed_files(files: Mapping[str, str], base: Path) -> list[str]:
    """What is not as its checksum says, one line for each file."""
    problems = []
    for name, expected in files.items():
        try:
            found = _sha256(base / name)
        except OSError as error:
            problems.append(f"{name} cannot be read any more: {error.strerror or error}")
            continue
        if found != expected:
            problems.append(f"{name} has changed since the campaign was planned")
    return problems


def differing_files(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """The files of two plans whose checksums differ; none if the plans are not of the same files."""
    return [name for name in now if before[name] != now[name]] if before.keys() == now.keys() else []


def _name(path: Path, base: Path) -> str:
    return path.relative_to(base).as_posix() if path.is_relative_to(base) else path.as_posix()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
