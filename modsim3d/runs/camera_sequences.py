"""The frames of each camera in order, with what is true in them and what a tracker may read of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.runs.files.columns import indices, numbers, positions
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.runs.told import Told, told


@dataclass(frozen=True, eq=False)
class TrueBoxes:
    """The vessels in a camera's images: n rows in order of frame and vessel.

    Attributes:
        frame: Row of the camera's frames, shape (n,).
        vessel: Index of the vessel, shape (n,).
        label: Index of its true label, shape (n,).
        annotated: Whether it was given to the detector, shape (n,).
        boxes_px: The box of the annotation mode, or the whole vessel's where it is not annotated, shape (n, 4).
        visible_fraction: NaN where unknown, shape (n,).
        silhouette_px: Pixels of the whole vessel, hidden or not, shape (n,).
        visible_px: Pixels of it that are visible; NaN where unknown, shape (n,).
    """

    frame: Indices
    vessel: Indices
    label: Indices
    annotated: Mask
    boxes_px: Array
    visible_fraction: Array
    silhouette_px: Array
    visible_px: Array

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    def take(self, chosen: Mask | Indices) -> Self:
        """The chosen rows."""
        return type(self)(**{name: column[chosen] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class CameraSequence:
    """The F frames of one camera.

    Attributes:
        camera: The camera.
        steps: The step of each frame, ascending, shape (F,).
        times_s: Times since the scene's first step, shape (F,).
        truth: What is true in them.
        detections: What a tracker may read of them.
    """

    camera: Camera
    steps: Indices
    times_s: Array
    truth: TrueBoxes
    detections: Told

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.camera.intrinsics.image_size_px

    @property
    def rate_hz(self) -> float:
        """Frames a second, on average."""
        if len(self.times_s) < 2:
            return self.camera.frame_rate_hz or 1.0
        return (len(self.times_s) - 1) / float(self.times_s[-1] - self.times_s[0])


def camera_sequences(run: StoredRun, cameras: tuple[int, ...]) -> tuple[CameraSequence, ...]:
    """The sequences of cameras, by their indices."""
    return sequences_of(RunRows.of(run), cameras)


def sequences_of(rows: RunRows, cameras: tuple[int, ...]) -> tuple[CameraSequence, ...]:
    """The sequences of cameras, by their indices, from rows in memory."""
    count = len(rows.scene.cameras)
    times_s = rows.scene.times_s(0, rows.steps)
    sequences = []
    for index in cameras:
        frames = rows.frames[rows.frames % count == index]
        steps = frames // count
        found = _truth(rows, frames), _detections(rows, frames)
        sequences.append(CameraSequence(rows.scene.cameras[index], steps, times_s[steps], *found))
    return tuple(sequences)


def _truth(rows: RunRows, frames: Indices) -> TrueBoxes:
    labels = rows.scene.detector.labels
    every = TrueBoxes(
        positions(frames, rows.truth_frame),
        rows.truth_vessel,
        indices(rows.truth, "label", labels),
        rows.annotated,
        np.where(rows.annotated[:, None], rows.annotated_boxes_px, rows.boxes_px("full")),
        *(rows.numbers(name) for name in ("visible_fraction", "silhouette_px", "visible_px")),
    )
    order = np.lexsort((every.vessel, every.frame))
    return every.take(order[every.frame[order] >= 0])


def _detections(rows: RunRows, frames: Indices) -> Told:
    every = told(
        positions(frames, rows.detection_frame),
        indices(rows.detections, "label", rows.scene.detector.labels),
        rows.detection_boxes_px(),
        numbers(rows.detections, "confidence"),
    )
    return every.take(every.frame >= 0)
