"""Detection conditions: folders with a detector file for each."""

from __future__ import annotations

from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.validation import nearest
from modsim3d.paths import StrPath

CONDITIONS = "conditions"
"""Name of the shipped folder, with the conditions that the thesis measured."""


def conditions_in(folder: StrPath = CONDITIONS) -> dict[str, Path]:
    """The detector files of a folder by their names, without their endings; `conditions` is the shipped folder.

    Raises:
        InputError: There is no such folder, or no detector file in it.
    """
    place = data_folder("scenes") / "detectors" / CONDITIONS if str(folder) == CONDITIONS else Path(folder)
    found = {path.stem: path for path in sorted(place.glob("*.yaml"))} if place.is_dir() else {}
    if not found:
        wanted = f"give '{CONDITIONS}' for the shipped ones, or a folder with detector files (*.yaml)"
        raise InputError(f"detectors in {folder}", ["there are none: " + wanted])
    return found


def find_condition(name: str, folder: StrPath = CONDITIONS) -> Path:
    """The detector file of a condition; see `conditions_in`.

    Raises:
        InputError: There is none of this name.
    """
    files = conditions_in(folder)
    if name not in files:
        alike = [known for known in files if name in known]
        hint = f"known: {', '.join(alike)}" if alike else nearest(name, files)
        raise InputError(f"detectors in {folder}", [f"there is no '{name}' ({hint})"])
    return files[name]
