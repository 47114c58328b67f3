"""Tracks in text files of MOTChallenge, one file a camera.

A line is frame, identity, x, y, width, height, confidence and further numbers, which are not read. Frames count from 1
over the frames of the camera, and pixels from 1 (Milan et al. (2016), "MOT16", data format).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.errors import InputError
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import nearest
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.files.box_forms import MOT
from modsim3d.tracks.files.file_rows import FileRows
from modsim3d.tracks.files.text_table import TextTable, source_of
from modsim3d.tracks.sequence_names import camera_sequence_names, plain_name

_FIRST = ("frame", "identity", *MOT.names, "confidence")
_LEAST = 6
_NO_CONFIDENCE = -1
_DATA = "data"
"""The folder inside that of a tracker in which evaluators look for its files."""


def read_mot_tracks(path: Path, rows: RunRows, cameras: Sequence[int] = ()) -> list[FileRows]:
    """Read the files of some cameras, all if there are none: a folder of them, or the only one.

    Raises:
        InputError: A file is missing, is of no camera, cannot be read, or has a line that cannot be right.
    """
    return [_read(file, camera, rows) for camera, file in sorted(_files(path, rows, cameras).items())]


def _files(path: Path, rows: RunRows, cameras: Sequence[int]) -> Mapping[int, Path]:
    """The file of each camera, by the camera's index."""
    names = camera_sequence_names([camera.name for camera in rows.scene.cameras])
    needed = [names[index] for index in cameras or range(len(names))]
    wanted, source = ", ".join(f"{name}.txt" for name in needed), source_of(path)
    if path.is_file():
        if len(needed) > 1:
            problem = f"this is one file, and the run has {len(names)} cameras: give the folder with {wanted}"
            raise InputError(source, [problem])
        return {names.index(needed[0]): path}
    folder = path if any(path.glob("*.txt")) or not (path / _DATA).is_dir() else path / _DATA
    there = {file.stem: file for file in sorted(folder.glob("*.txt"))}
    if not there:
        raise InputError(source, [f"holds no tracks: neither tracks.json nor {wanted}"])
    problems = [_unknown(stem, names, rows) for stem in there if stem not in names]
    missing = [name for name in needed if name not in there]
    problems += [f"{name}.txt is missing: a tracker that found nothing leaves an empty file" for name in missing]
    if problems:
        raise InputError(source_of(folder), problems)
    return {names.index(stem): file for stem, file in there.items() if stem in needed}


def _unknown(stem: str, names: tuple[str, ...], rows: RunRows) -> str:
    of_class = {f"{name}-{plain_name(label)}" for name in names for label in rows.scene.detector.labels}
    if stem in of_class:
        return f"{stem}.txt is of one class: give the tracks of all classes together, as for the set modsim3d-all"
    return f"{stem}.txt is of no camera of the run ({nearest(stem, names)})"


def _read(path: Path, camera: int, rows: RunRows) -> FileRows:
    text, source = read_text(path, "tracks"), source_of(path)
    begin = next(filter(str.strip, text.splitlines()), ",".join(_FIRST))
    cells = begin.count(",") + 1
    if cells < _LEAST:
        form = f"frame,identity,{','.join(MOT.names)}"
        raise InputError(source, [f"a line must have at least {_LEAST} numbers with commas between them: {form}"])
    further = (f"number {index}" for index in range(len(_FIRST) + 1, cells + 1))
    table = TextTable.of(text, [*_FIRST, *further][:cells], source)
    many = len(table)
    frame = _frames(table, rows, camera)
    track = table.identities("identity", _NO_CONFIDENCE)
    table.problems.refuse(
        track == NOBODY, lambda row: "identity is -1, as in a file of detections: tracks need one of 0 or more"
    )
    numbers = np.column_stack([table.numbers(name) for name in MOT.names])
    confidence = table.numbers("confidence") if table.has("confidence") else np.full(many, np.nan)
    table.problems.settle()
    confidence = np.where(confidence == _NO_CONFIDENCE, np.nan, confidence)
    covariance = np.full((many, 2, 2), np.nan)
    return FileRows(table.problems, frame, track, numbers, MOT, np.full(many, NOBODY), confidence, covariance)


def _frames(table: TextTable, rows: RunRows, camera: int) -> Indices:
    """Number of the frame of each row, shape (k,)."""
    taken = rows.frames[rows.frames % len(rows.scene.cameras) == camera]
    number = table.whole_numbers("frame", 0)
    name = rows.scene.cameras[camera].name
    table.problems.refuse(number == 0, lambda row: "frame is 0: frames count from 1, and here perhaps from 0")
    table.problems.refuse(
        number > len(taken),
        lambda row: f"there is no frame {number[row]}: camera '{name}' has frames 1 to {len(taken)}",
    )
    there = (number >= 1) & (number <= len(taken))
    found = np.full(len(table), NOBODY)
    found[there] = taken[number[there] - 1]
    return found
