"""Tracks in the images of a run."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask


@dataclass(frozen=True, eq=False)
class Tracks:
    """The boxes of all tracks: k rows in order of frame and track.

    Attributes:
        cameras: Number of cameras of the run.
        frame: Number of the frame, step × cameras + camera as in `RunRows`, shape (k,).
        track: Number that the tracker gave the track; equal ones in one camera are one track, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        label: Index of the label, −1 where the tracker says none, shape (k,).
        confidence: NaN where the tracker says none, shape (k,).
        covariance_px2: Of x and y of the box's centre, NaN where the tracker says none, shape (k, 2, 2).
    """

    cameras: int
    frame: Indices
    track: Indices
    boxes_px: Array
    label: Indices
    confidence: Array
    covariance_px2: Array

    @classmethod
    def of(
        cls,
        cameras: int,
        frame: Indices,
        track: Indices,
        boxes_px: Array,
        label: Indices | None = None,
        confidence: Array | None = None,
        covariance_px2: Array | None = None,
    ) -> Self:
        """Rows in any order; what is None is unknown."""
        count = len(frame)
        rows = cls(
            cameras,
            np.asarray(frame, dtype=np.int64),
            np.asarray(track, dtype=np.int64),
            np.asarray(boxes_px, dtype=np.float64).reshape(count, 4),
            np.full(count, -1) if label is None else np.asarray(label, dtype=np.int64),
            np.full(count, np.nan) if confidence is None else np.asarray(confidence, dtype=np.float64),
            np.full((count, 2, 2), np.nan) if covariance_px2 is None else np.asarray(covariance_px2, dtype=np.float64),
        )
        return rows.take(np.lexsort((rows.track, rows.frame)))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    @property
    def camera(self) -> Indices:
        """Index of the camera of each row, shape (k,)."""
        return self.frame % self.cameras

    @property
    def step(self) -> Indices:
        """Time step of each row, shape (k,)."""
        return self.frame // self.cameras

    @cached_property
    def identity(self) -> Indices:
        """Number of each row's track among those of all cameras, from 0 without gaps, shape (k,)."""
        keys = np.column_stack([self.camera, self.track])
        _, identity = np.unique(keys, axis=0, return_inverse=True)
        return np.asarray(identity, dtype=np.int64).reshape(-1)

    def take(self, chosen: Mask | Indices) -> Self:
        """The chosen rows."""
        columns = (getattr(self, field.name) for field in fields(self)[1:])
        return type(self)(self.cameras, *(column[chosen] for column in columns))
