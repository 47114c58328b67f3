"""Files of tracks that are wrong as a whole: read in another way they fit the run's detections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, extents, ranges
from modsim3d.errors import InputError
from modsim3d.runs.files.columns import NOBODY, positions
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.files.box_forms import CENTRE, CORNERS, MOT, TOP_LEFT, BoxForm
from modsim3d.tracks.files.file_rows import FileRows

_LOOKED_AT = 2000
"""Rows, spread over the file."""
_LEAST_ROWS = 8
"""Fewer rows may be false tracks, which fit nothing, or anything by chance."""
_FITS, _TIMES_BETTER = 0.1, 2.0
"""Another reading is meant if its boxes are at most this share of the image's diagonal away from detections, and nearer
by this factor than those of the file as it is. Tracks that are right lie nearer as they are than in any other reading.
"""
_NEAR = 0.001
"""So near, two pixels of a large image, are no boxes that are read in a wrong way."""
_SIZES_PX = (
    *((320, 320), (416, 416), (512, 512), (640, 360), (640, 480), (640, 640), (800, 600), (960, 540)),
    *((1024, 768), (1280, 720), (1280, 1280), (1920, 1080), (2560, 1440), (3840, 2160)),
)
"""Sizes to which images are often scaled for a detector or a tracker; halves and doubles of the run's are tried too."""
_MOST_NORMALISED = 2.0


@dataclass(frozen=True, eq=False)
class _Reading:
    """Another way to read a file.

    Attributes:
        told: What is wrong then, and what would be right.
        frame: Number of the frame, shape (k,).
        boxes_px: Shape (k, 4).
    """

    told: str
    frame: Indices
    boxes_px: Array


def check_reading(source: str, files: Sequence[FileRows], rows: RunRows) -> None:
    """Refuse files that lie far from the run's detections as they are, and near if they are read in another way.

    Raises:
        InputError: They are such files; the message says which reading fits.
    """
    frame = np.concatenate([file.frame for file in files])
    if len(frame) < _LEAST_ROWS:
        return
    chosen = np.unique(np.linspace(0, len(frame) - 1, _LOOKED_AT).astype(np.int64))
    frame, numbers = frame[chosen], np.concatenate([file.numbers for file in files])[chosen]
    form, detections = files[0].form, _Detections.of(rows)
    as_it_is = detections.distance(frame, form.boxes_px(numbers))
    best, found = _FITS, None
    for reading in _readings(frame, numbers, form, rows):
        away = detections.distance(reading.frame, reading.boxes_px)
        if away < best:
            best, found = away, reading
    if found is not None and max(_TIMES_BETTER * best, _NEAR) < as_it_is:
        fits = f"{best:.2%} of the image's diagonal from a detection instead of {as_it_is:.2%}"
        raise InputError(source, [f"{found.told} (then half of them lie within {fits})"])


@dataclass(frozen=True, eq=False)
class _Detections:
    """The m detections of a run in order of frame.

    Attributes:
        frame: Number of the frame, shape (m,).
        boxes_px: Shape (m, 4).
        diagonal_px: Of the images of each camera, shape (C,).
    """

    frame: Indices
    boxes_px: Array
    diagonal_px: Array

    @classmethod
    def of(cls, rows: RunRows) -> _Detections:
        order = np.argsort(rows.detection_frame, kind="stable")
        diagonal = np.array([np.hypot(*camera.intrinsics.image_size_px) for camera in rows.scene.cameras])
        return cls(rows.detection_frame[order], rows.detection_boxes_px()[order], diagonal)

    def distance(self, frame: Indices, boxes_px: Array) -> float:
        """How far boxes are from the nearest detection of their frame: the median of those that have one there.

        The distance of two boxes is the largest of their four edges, as a share of the image's diagonal. Unlike the
        IoU it tells boxes that are near from others also where boats are smaller than the errors of their boxes.
        """
        first, many = extents(self.frame, frame)
        row, other = np.repeat(np.arange(len(frame)), many), ranges(first, many)
        nearest = np.full(len(frame), np.inf)
        np.minimum.at(nearest, row, np.abs(boxes_px[row] - self.boxes_px[other]).max(axis=1))
        share = (nearest / self.diagonal_px[frame % len(self.diagonal_px)])[many > 0]
        return float(np.median(share)) if len(share) else np.inf


def _readings(frame: Indices, numbers: Array, form: BoxForm, rows: RunRows) -> Iterator[_Reading]:
    """All other readings, the likeliest first: of equally good ones the first counts."""
    cameras = rows.scene.cameras
    size = np.array([camera.intrinsics.image_size_px for camera in cameras])[frame % len(cameras)]
    others = [each for each in (CORNERS, CENTRE, TOP_LEFT) if each.meaning != form.meaning and not _like(each, form)]
    plain = TOP_LEFT if form is MOT else form
    for other in others:
        yield _Reading(f"the boxes are read as {form.meaning}, but are {other.meaning}", frame, other.boxes_px(numbers))
    if np.abs(numbers).max() <= _MOST_NORMALISED:
        scaled = numbers * np.tile(size, 2)
        for other in (plain, *others):
            told = f"the boxes are shares of the image ({other.meaning}), must be in pixels: {form.meaning}"
            yield _Reading(told, frame, other.boxes_px(scaled))
    own = {camera.intrinsics.image_size_px for camera in cameras}
    near = [(round(width * by), round(height * by)) for width, height in sorted(own) for by in (0.25, 0.5, 2, 4)]
    for image in dict.fromkeys((*near, *_SIZES_PX)):
        told = f"the boxes are those of an image of {image[0]} x {image[1]} px, must be in pixels of the camera's image"
        sizes_told = ", ".join(f"{width} x {height}" for width, height in sorted(own))
        yield _Reading(f"{told} ({sizes_told})", frame, form.boxes_px(numbers) * np.tile(size / image, 2))
    if form is MOT:
        yield _Reading("frames count from 0, must count from 1", _next_frames(frame, rows), form.boxes_px(numbers))


def _like(one: BoxForm, other: BoxForm) -> bool:
    """Whether two forms differ by the number of the first pixel alone."""
    return one.to_corners is other.to_corners


def _next_frames(frame: Indices, rows: RunRows) -> Indices:
    """The camera's next frame after each, `NOBODY` after the last, shape (k,)."""
    count, found = len(rows.scene.cameras), np.full(len(frame), NOBODY)
    for camera in range(count):
        taken, here = rows.frames[rows.frames % count == camera], frame % count == camera
        found[here] = np.append(taken, NOBODY)[positions(taken, frame[here]) + 1]
    return found
