"""How long each frame stands for, and stretches of rows without a break."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.tracking.scores.scored import Scored


def frame_lengths_s(scored: Scored, frames: Indices) -> Array:
    """The time from each frame to the camera's next one, shape (k,).

    A camera's last frame stands for as long as the one before it, and an only frame for a frame of the camera's rate.

    Args:
        scored: The run.
        frames: Numbers of frames of the run, shape (k,).
    """
    every, cameras = scored.rows.frames, scored.by_step
    length_s = np.empty(len(every))
    for index, camera in enumerate(scored.rows.scene.cameras):
        here = np.flatnonzero(every % cameras == index)
        apart = np.diff(scored.times_s[every[here] // cameras])
        alone = 1 / (camera.frame_rate_hz or 1.0)
        length_s[here] = np.append(apart, apart[-1:] if len(apart) else alone)[: len(here)]
    found: Array = length_s[np.searchsorted(every, frames)]
    return found


class Stretches(NamedTuple):
    """Stretches of rows that follow each other: r of them.

    Attributes:
        first: Place of each stretch's first row, shape (r,).
        last: Place of its last row, shape (r,).
    """

    first: Indices
    last: Indices


def stretches(group: Indices, place: Indices) -> Stretches:
    """Stretches in which the group stays and the place grows by 1 from row to row.

    Args:
        group: Group of each row; rows of a group stand together, shape (k,).
        place: Place of each row in its group, ascending in it, shape (k,).
    """
    ends = np.flatnonzero((np.diff(group) != 0) | (np.diff(place) != 1)) + 1
    if not len(group):
        return Stretches(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    return Stretches(np.append(0, ends), np.append(ends, len(group)) - 1)
