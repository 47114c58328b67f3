"""What a tracker is: it is given the detections of a camera frame by frame, and answers each frame with its tracks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.inputs.validation import Strict


@dataclass(frozen=True, eq=False)
class CameraFacts:
    """What a tracker knows of the camera.

    Attributes:
        name: Name of the camera.
        image_size_px: Width and height.
        rate_hz: Frames a second, on average.
        labels: Names of the classes.
    """

    name: str
    image_size_px: tuple[int, int]
    rate_hz: float
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SensedFrame:
    """The detections of one frame: m rows, the most confident first; m may be 0.

    Attributes:
        time_s: Time since the scene's first step.
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        label: Index of the class, shape (m,).
        confidence: From 0 to 1, shape (m,).
    """

    time_s: float
    boxes_px: Array
    label: Indices
    confidence: Array


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """The tracks that a tracker reports in one frame: k rows in any order; k may be 0.

    Attributes:
        track: A number for each track, the same in all frames, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        label: Index of the class, shape (k,); None if the tracker says none.
        confidence: Shape (k,); None if the tracker says none.
        covariance_px2: Of x and y of the centre of the box, shape (k, 2, 2); None if the tracker has none.
    """

    track: Indices
    boxes_px: Array
    label: Indices | None = None
    confidence: Array | None = None
    covariance_px2: Array | None = None

    @classmethod
    def empty(cls) -> TrackedFrame:
        """No track."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 4)))


class Tracker(Strict):
    """A tracker; its fields are its settings, with their defaults.

    A plug-in names a subclass of it under the entry point group `modsim3d.trackers`.
    """

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        """Track the detections of one camera: for each frame, in order of time, one answer before the next is read."""
        raise NotImplementedError
