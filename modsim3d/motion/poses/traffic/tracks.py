"""A vessel under way on her path, and where hulls are at many times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.motion.poses.traffic.kinds import Hull
from modsim3d.motion.poses.traffic.paths import Path


@dataclass(frozen=True, eq=False)
class Track:
    """A hull that follows a path at constant speed; she starts along it at `start_s`, and is absent before and after.

    `cost` says how far the track is from what was drawn at first.
    """

    hull: Hull
    path: Path
    speed_m_s: float
    start_s: float
    cost: float = 0.0

    @property
    def end_s(self) -> float:
        """When she reaches the end of the path."""
        return self.start_s + self.path.length_m / self.speed_m_s

    def at(self, times_s: Array) -> tuple[Array, Array]:
        """Places, shape (n, 2), and headings, shape (n,), at any times; straight on beyond the path's ends."""
        return self.path.at(self.speed_m_s * (times_s - self.start_s))

    def present(self, times_s: Array, margin_s: float = 0.0) -> Mask:
        """Whether she is there at each of n times."""
        there: Mask = (times_s >= self.start_s - margin_s) & (times_s <= self.end_s + margin_s)
        return there


@dataclass(frozen=True, eq=False)
class Sweep:
    """C tracks of one hull at T times: what is compared with other hulls and with land.

    Attributes:
        tracks: The tracks.
        present: Whether she is there, or enters or has left within an interval, shape (C, T).
        places_m: Shape (C, T, 2).
        axes: Unit vectors along the hull, shape (C, T, 2).
        speeds_m_s: Shape (C,).
    """

    tracks: Sequence[Track]
    present: Mask
    places_m: Array
    axes: Array
    speeds_m_s: Array

    @classmethod
    def of(cls, tracks: Sequence[Track], times_s: Array, interval_s: float) -> Sweep:
        """The tracks, at least one, at times an interval apart."""
        placed = [track.at(times_s) for track in tracks]
        headings = np.stack([heading for _, heading in placed])
        return cls(
            tracks=tracks,
            present=np.stack([track.present(times_s, interval_s) for track in tracks]),
            places_m=np.stack([place for place, _ in placed]),
            axes=np.stack([np.cos(headings), np.sin(headings)], axis=-1),
            speeds_m_s=np.array([track.speed_m_s for track in tracks]),
        )

    @property
    def hull(self) -> Hull:
        """The hull that all the tracks have."""
        return self.tracks[0].hull

    def during(self, steps: slice) -> Sweep:
        """The tracks at some of the times."""
        present, places, axes = self.present[:, steps], self.places_m[:, steps], self.axes[:, steps]
        return Sweep(self.tracks, present, places, axes, self.speeds_m_s)

    def row(self, index: int) -> Sweep:
        """One track alone."""
        one = slice(index, index + 1)
        return Sweep(self.tracks[one], self.present[one], self.places_m[one], self.axes[one], self.speeds_m_s[one])
