"""The rows of a file of tracks before it is known whether its boxes are boxes in these images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.runs.files.columns import NOBODY, positions
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.credibility import FAR, covariances, far_tracks
from modsim3d.tracks.files.box_forms import BoxForm
from modsim3d.tracks.files.row_problems import RowProblems
from modsim3d.tracks.tracks import Tracks


@dataclass(frozen=True, eq=False)
class FileRows:
    """The k rows of a file.

    Attributes:
        problems: What is wrong with the rows.
        frame: Number of the frame as in `RunRows`, shape (k,).
        track: Number of the track, shape (k,).
        numbers: The box as the file has it, shape (k, 4).
        form: What these are.
        label: Index of the label, `NOBODY` for none, shape (k,).
        confidence: NaN for none, shape (k,).
        covariance_px2: Of the centre, NaN for none, shape (k, 2, 2).
    """

    problems: RowProblems
    frame: Indices
    track: Indices
    numbers: Array
    form: BoxForm
    label: Indices
    confidence: Array
    covariance_px2: Array

    @property
    def boxes_px(self) -> Array:
        """Boxes as x_min, y_min, x_max, y_max, shape (k, 4)."""
        return self.form.boxes_px(self.numbers)

    def check(self, rows: RunRows) -> None:
        """Check all that a row says beside its frame.

        Raises:
            InputError: A row cannot be right.
        """
        self._check_boxes(rows)
        self._check_attributes()
        self._check_once(rows)
        self.problems.settle()

    def _check_boxes(self, rows: RunRows) -> None:
        boxes = self.boxes_px
        width, height = sizes(boxes).T
        self.problems.refuse(
            ~((width > 0) & (height > 0)),  # NaN too
            lambda row: (
                f"the box has width {width[row]:g} and height {height[row]:g}, must be above 0 "
                f"({self._numbers(row)}, read as {self.form.meaning})"
            ),
        )
        cameras = rows.scene.cameras
        images = np.array([camera.intrinsics.image_size_px for camera in cameras])
        size = images[self.frame % len(cameras)]
        self.problems.refuse(
            far_tracks(boxes, np.column_stack([self.frame % len(cameras), self.track]), size),
            lambda row: f"{FAR}; the image has {size[row, 0]} x {size[row, 1]} px ({self._numbers(row)})",
        )

    def _check_attributes(self) -> None:
        self.problems.refuse(
            (self.confidence < 0) | (self.confidence > 1),
            lambda row: f"confidence must be from 0 to 1 (got {self.confidence[row]:g})",
        )
        (a, b), (_, d) = np.moveaxis(self.covariance_px2, 0, -1)
        known = ~np.isnan(self.covariance_px2)[:, [0, 0, 1], [0, 1, 1]]
        self.problems.refuse(
            known.any(axis=1) & ~known.all(axis=1), lambda row: "the covariance needs all three numbers, or none"
        )
        self.problems.refuse(
            known.all(axis=1) & ~covariances(a, b, d),
            lambda row: (
                f"var_x_px2 {a[row]:g}, cov_xy_px2 {b[row]:g} and var_y_px2 {d[row]:g} are no covariance: both "
                "variances must be above 0, and their product above the square of cov_xy_px2"
            ),
        )

    def _check_once(self, rows: RunRows) -> None:
        order = np.lexsort((self.track, self.frame))  # stable: of equal ones the first in the file comes first
        again = (np.diff(self.frame[order]) == 0) & (np.diff(self.track[order]) == 0)
        before = np.full(len(order), NOBODY)
        before[order[1:][again]] = order[:-1][again]
        cameras = [camera.name for camera in rows.scene.cameras]

        def say(row: int) -> str:
            frame = int(self.frame[row])
            where = f"step {frame // len(cameras)} of camera '{cameras[frame % len(cameras)]}'"
            there = f"{self.problems.word} {self.problems.line[before[row]]}"
            return f"track {self.track[row]} is at {where} already ({there}): a track has one box in a frame"

        self.problems.refuse(before != NOBODY, say)

    def _numbers(self, row: int) -> str:
        pairs = zip(self.form.names, self.numbers[row].tolist(), strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def frames_at(rows: RunRows, camera: Indices, step: Indices, problems: RowProblems) -> Indices:
    """Number of the frame of each row; a camera that takes none at the step is a problem, shape (k,)."""
    count = len(rows.scene.cameras)
    wanted = step * count + camera
    there = positions(rows.frames, np.where((camera < 0) | (step < 0), NOBODY, wanted)) != NOBODY

    def say(row: int) -> str:
        name = rows.scene.cameras[camera[row]].name
        steps = rows.frames[rows.frames % count == camera[row]] // count
        if not 0 <= step[row] < rows.steps:
            return f"there is no step {step[row]}: the run has steps 0 to {rows.steps - 1}"
        near = steps[np.argsort(np.abs(steps - step[row]), kind="stable")[:1]].tolist()
        return f"camera '{name}' takes no frame at step {step[row]}" + (f"; the nearest is {near[0]}" if near else "")

    problems.refuse(~there & (camera >= 0) & (step != NOBODY), say)
    return np.where(there, wanted, NOBODY)


def tracks_of(files: Sequence[FileRows], cameras: int) -> Tracks:
    """The checked rows of files as tracks."""
    names = ("frame", "track", "boxes_px", "label", "confidence", "covariance_px2")
    return Tracks.of(cameras, *(np.concatenate([getattr(file, name) for file in files]) for name in names))
