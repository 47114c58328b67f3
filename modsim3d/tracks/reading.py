"""Tracks in a run, from a folder that `modsim3d track` has written or from somebody's own files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from modsim3d.arrays import Array, Indices
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
    known = _known("a detection", rows.detection_frame, rows.detection_boxes_px())
    true_px = np.concatenate([rows.boxes_px("visible"), rows.boxes_px("full")])
    truth = _known("a vessel", np.tile(rows.truth_frame, 2), true_px)
    for file in files:
        _check_reading(file, rows, known, truth)
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


def _known(word: str, frame: Indices, boxes_px: Array) -> KnownBoxes:
    """Those of some boxes that are boxes, in order of frame."""
    order = np.argsort(frame, kind="stable")
    order = order[np.isfinite(boxes_px[order]).all(axis=1)]
    return KnownBoxes(word, frame[order], boxes_px[order])


def _check_reading(file: FileRows, rows: RunRows, known: KnownBoxes, truth: KnownBoxes) -> None:
    """Hold the boxes of each camera of a file against known ones.

    Raises:
        InputError: They are meant otherwise than they are read.
    """
    for index, camera in enumerate(rows.scene.cameras):
        if problem := misreading(_box_rows(file, rows, index), known, truth):
            where = f"camera '{camera.name}': " if len(rows.scene.cameras) > 1 else ""
            raise InputError(file.problems.source, [where + problem.told])


def _box_rows(file: FileRows, rows: RunRows, camera: int) -> BoxRows:
    """The boxes of one camera."""
    count = len(rows.scene.cameras)
    taken, here = rows.frames[rows.frames % count == camera], file.frame % count == camera
    frame = file.frame[here]
    place = positions(taken, frame)
    before, after = np.append(NOBODY, taken)[place], np.append(taken, NOBODY)[place + 1]
    image_px = np.tile(rows.scene.cameras[camera].intrinsics.image_size_px, (len(frame), 1))
    return BoxRows(file.numbers[here], file.form, image_px, frame, before, after)


def _name(path: Path) -> str:
    """What tables call somebody's own tracks."""
    whole = path.resolve()
    if whole.name == "data" and whole.is_dir():
        return whole.parent.name
    return whole.name if whole.is_dir() else name_of(whole)
