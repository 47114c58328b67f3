"""Tracks of vessels in the world, in the axes of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class WorldTracks:
    """The estimates of all tracks: k rows in order of track and time.

    Attributes:
        name: What tables call them.
        track_names: The tracker's names of the tracks.
        track: Index of each row's track, shape (k,).
        time_s: Times since the scene's first step, shape (k,).
        position_m: Centres of the vessels along w1 and w2, shape (k, 2).
        velocity_m_s: Over ground along w1 and w2, NaN where unknown, shape (k, 2).
        covariance: Of position (0, 1) and velocity (2, 3), in m², m²/s and m²/s²; NaN where unknown, shape (k, 4, 4).
    """

    name: str
    track_names: tuple[str, ...]
    track: Indices
    time_s: Array
    position_m: Array
    velocity_m_s: Array
    covariance: Array

    @classmethod
    def of(
        cls,
        name: str,
        track: Indices,
        track_names: tuple[str, ...],
        time_s: Array,
        position_m: Array,
        velocity_m_s: Array | None = None,
        covariance: Array | None = None,
    ) -> Self:
        """Rows in any order; what is None is unknown. A covariance may be that of the positions alone, (k, 2, 2)."""
        count = len(time_s)
        whole = np.full((count, 4, 4), np.nan)
        if covariance is not None:
            size = covariance.shape[-1]
            whole[:, :size, :size] = covariance
        velocity = np.full((count, 2), np.nan) if velocity_m_s is None else velocity_m_s
        order = np.lexsort((time_s, track))
        return cls(name, track_names, track[order], time_s[order], position_m[order], velocity[order], whole[order])

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.track)

    @property
    def interval_s(self) -> float:
        """Median time between two estimates of a track, 0 if no track has two."""
        gaps = np.diff(self.time_s)[np.diff(self.track) == 0]
        return float(np.median(gaps)) if len(gaps) else 0.0
