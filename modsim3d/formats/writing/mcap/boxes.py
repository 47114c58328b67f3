"""The boxes of a camera's frames: what the detector makes of them, and the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.runs.blocks import CameraBlock
from modsim3d.runs.told import Told
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes


@dataclass(frozen=True, eq=False)
class Boxes:
    """The n boxes of a frame.

    Attributes:
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        labels: Classes.
        scores: Confidences.
        ids: Names of the vessels; empty texts where a tracker must not know them.
    """

    boxes_px: Array
    labels: list[str]
    scores: list[float]
    ids: list[str]


def detected_boxes(part: CameraBlock, scene: Scene) -> Iterator[Boxes]:
    """The detections of each frame without their origin, as `tracker_input_CAMERA.jsonl` has them."""
    found = Told.of(part.detections)
    labels = [scene.detector.labels[label] for label in found.label.tolist()]
    scores = found.confidence.tolist()
    for rows in _rows(np.searchsorted(found.frame, np.arange(len(part.steps) + 1))):
        yield Boxes(found.boxes_px[rows], labels[rows], scores[rows], [""] * (rows.stop - rows.start))


def true_boxes(part: CameraBlock, scene: Scene) -> Iterator[Boxes]:
    """The annotated vessels of each frame, by name."""
    truth = part.truth.take(part.target_rows)
    vessels = [scene.vessels[vessel] for vessel in truth.vessel.tolist()]
    boxes = annotation_boxes(truth, scene.annotation.mode)
    for rows in _rows(np.searchsorted(truth.step, np.append(part.steps, np.iinfo(np.int64).max))):
        found = vessels[rows]
        names, labels = [vessel.name for vessel in found], [vessel.label for vessel in found]
        yield Boxes(boxes[rows], labels, [1.0] * len(found), names)


def _rows(starts: np.ndarray) -> Iterator[slice]:
    """The rows between each start and the next."""
    return map(slice, starts[:-1].tolist(), starts[1:].tolist())
