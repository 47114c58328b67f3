"""Tracks in a run, from a folder that `modsim3d track` has written or from somebody's own files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from modsim3d.errors import InputError
from modsim3d.runs.files.columns import NOBODY, positions
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.files.csv_tracks import read_csv_tracks
from modsim3d.tracks.files.diagnosis import BoxRows, KnownBoxes, misreading
from modsim3d.tracks.files.file_rows import FileRows, tracks_of
from modsim3d.tracks.files.mot_tracks import read_mot_tracks
from modsim3d.tracks.files.text_table import name_of, source_of
from modsim3d.tracks.stored_tracks import TRACK_FILES, read_stored_tracks
from modsim3d.tracks.track_set import TrackSet

_FORMS = "a folder of `modsim3d track`, a .csv file, a MOT .txt file or a folder of such"


def read_tracks(path: Path, run: StoredRun, rows: RunRows, cameras: Sequence[int] = ()) -> TrackSet:
    """Read the tracks of a tracker in a run.

    Args:
        path: A folder that `modsim3d track` has written, a CSV file, a MOT file of the only camera, or a folder with a
            MOT file for each camera, in it or in its folder `data`.
        run: The run.
        rows: Its rows.
        cameras: Indices of the cameras whose tracks are wanted; all if there are none. No others need a MOT file.

    Raises:
        InputError: There are no such tracks, or they are wrong; each problem names its line.
    """
    try:
        path.stat()
    except (OSError, ValueError) as error:  # a ValueError is a null character
        missing = isinstance(error, FileNotFoundError)
        problem = "no such file or folder" if missing else getattr(error, "strerror", None) or "is no valid name"
        raise InputError(source_of(path), [f"{problem}; tracks are {_FORMS}"]) from None
    if path.is_dir() and any((path / name).exists() for name in TRACK_FILES):
        return read_stored_tracks(path, run, rows)
    files = _files(path, rows, cameras)
    known = _known(rows)
    for file in files:
        if problem := misreading(_box_rows(file, rows), known):
            raise InputError(file.problems.source, [problem.told])
    for file in files:
        file.check(rows)
    tracks = tracks_of(files, len(rows.scene.cameras))
    named = set(tracks.camera.tolist()) if len(files) == 1 and path.is_file() else set()
    unnamed = (camera.name for index, camera in enumerate(rows.scene.cameras) if named and index not in named)
    return TrackSet(_name(path), tracks, None, tuple(unnamed))


def _files(path: Path, rows: RunRows, cameras: Sequence[int]) -> list[FileRows]:
    suffix = Path(path.name.removesuffix(".gz")).suffix.lower()
    if path.is_dir() or suffix == ".txt":
        return read_mot_tracks(path, rows, cameras)
    if suffix == ".csv":
        return [read_csv_tracks(path, rows)]
    if path.name in TRACK_FILES:
        raise InputError(source_of(path), [f"this is one of the files {' and '.join(TRACK_FILES)}: give their folder"])
    raise InputError(source_of(path), [f"is none of what tracks may be: {_FORMS}"])


def _known(rows: RunRows) -> KnownBoxes:
    order = np.argsort(rows.detection_frame, kind="stable")
    return KnownBoxes("a detection", rows.detection_frame[order], rows.detection_boxes_px()[order])


def _box_rows(file: FileRows, rows: RunRows) -> BoxRows:
    cameras, frame = rows.scene.cameras, file.frame
    before, after = np.full(len(frame), NOBODY), np.full(len(frame), NOBODY)
    for index in range(len(cameras)):
        taken, here = rows.frames[rows.frames % len(cameras) == index], frame % len(cameras) == index
        place = positions(taken, frame[here])
        before[here], after[here] = np.append(NOBODY, taken)[place], np.append(taken, NOBODY)[place + 1]
    image_px = np.array([camera.intrinsics.image_size_px for camera in cameras])[frame % len(cameras)]
    return BoxRows(file.numbers, file.form, image_px, frame, before, after)


def _name(path: Path) -> str:
    """What tables call somebody's own tracks."""
    whole = path.resolve()
    if whole.name == "data" and whole.is_dir():
        return whole.parent.name
    return whole.name if whole.is_dir() else name_of(whole)
