"""Columns of small integers for the player of a run's page."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.view.report.silhouettes import NONE

Column = NDArray[Any]


def in_quanta(lengths_px: Array, quantum: float) -> NDArray[np.uint16]:
    """Lengths in pixels as multiples of a quantum, `NONE` for NaN, of the same shape."""
    counted = np.clip(np.rint(np.nan_to_num(lengths_px) / quantum), 0, NONE - 1)
    return np.where(np.isnan(lengths_px), NONE, counted).astype(np.uint16)


def starts(frame: Indices, frames: int) -> NDArray[np.uint32]:
    """The first row of each frame, and the number of rows, shape (frames + 1,); from each row's frame, shape (n,)."""
    return np.searchsorted(frame, np.arange(frames + 1)).astype(np.uint32)
