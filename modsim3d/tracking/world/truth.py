"""Where the vessels of a run are, and which of them a camera sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.closest_approach import HullTracks
from modsim3d.geometry.kinematics import velocities
from modsim3d.motion.encounters import hull_tracks
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows

_SAME = 1e-5
"""Shares of a step that are rounding errors of a time: of seconds since 1970 in steps of 0.1 s they are up to 5e-6."""


@dataclass(frozen=True, eq=False)
class WorldTruth:
    """V vessels at S steps.

    Attributes:
        names: Their IDs.
        own_ships: Indices of those that carry cameras, ascending.
        hulls: Where they are.
        scored: Whether a tracker is expected to follow each: some camera saw a pixel of it in its last frame, and it
            carries no camera itself, shape (S, V).
    """

    names: tuple[str, ...]
    own_ships: tuple[int, ...]
    hulls: HullTracks
    scored: Mask

    @classmethod
    def of(cls, rows: RunRows) -> Self:
        """The truth of a run."""
        scene = rows.scene
        hulls = hull_tracks(scene.vessels, scene.poses, rows.steps)
        scored = seen(rows) & np.isfinite(hulls.centres_m[..., 0])
        scored[:, list(scene.own_ships)] = False
        return cls(scene.vessel_names, scene.own_ships, hulls, scored)

    @property
    def times_s(self) -> Array:
        """Times of the steps since the first, shape (S,)."""
        return self.hulls.times_s

    @cached_property
    def velocities_m_s(self) -> Array:
        """By central differences, NaN where a vessel is absent, shape (S, V, 2)."""
        centres_m = self.hulls.centres_m
        present = np.isfinite(centres_m[..., 0])
        found = velocities(self.times_s, np.where(present[..., None], centres_m, 0.0), present)
        return np.where(present[..., None], found, np.nan)

    def positions_at(self, times_s: Array, vessels: Indices) -> Array:
        """Centres of m vessels at m times, straight between steps, NaN where absent, shape (m, 2)."""
        return self._between(self.hulls.centres_m, times_s, vessels)

    def velocities_at(self, times_s: Array, vessels: Indices) -> Array:
        """Velocities of m vessels at m times, NaN where absent, shape (m, 2)."""
        return self._between(self.velocities_m_s, times_s, vessels)

    def _between(self, values: Array, times_s: Array, vessels: Indices) -> Array:
        before, share = self._legs(times_s)
        after = np.minimum(before + 1, len(values) - 1)
        start, end = values[before, vessels], values[after, vessels]
        # At a step only that step counts: its neighbour may be absent.
        between = (1 - share) * start + share * end
        found: Array = np.where(share == 0, start, np.where(share == 1, end, between))
        return found

    def _legs(self, times_s: Array) -> tuple[Indices, Array]:
        """Step before each time, and the share of the way to the next, shapes (m,) and (m, 1).

        Half an interval before the first step and after the last the vessel goes on along its leg.
        """
        if len(self.times_s) < 2:
            return np.zeros(len(times_s), dtype=np.int64), np.zeros((len(times_s), 1))
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.times_s) - 2)
        share = (times_s - self.times_s[before]) / np.diff(self.times_s)[before]
        nearest = np.round(share)
        share = np.where(np.abs(share - nearest) < _SAME, nearest, share)
        return before, share[:, None]


def seen(rows: RunRows) -> Mask:
    """Whether a camera's last frame has a visible pixel of each vessel at each step, shape (S, V).

    Where it is unknown what is visible, a vessel in the image is taken as seen, as in `TrueTracks`.
    """
    scene = rows.scene
    cameras, vessels = len(scene.cameras), len(scene.vessels)
    in_frame = np.zeros((rows.steps * cameras + 1, vessels), dtype=bool)  # the last is that of NOBODY
    visible = rows.numbers("visible_px") != 0
    in_frame[rows.truth_frame[visible], rows.truth_vessel[visible]] = True
    last = rows.last_taken(np.arange(rows.steps))
    frames = np.where(last == NOBODY, -1, last * cameras + np.arange(cameras))
    return np.asarray(in_frame[frames].any(axis=1), dtype=np.bool_)
