"""Tracks in the world that follow vessels, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.geometry.kinematics import HullTracks, velocities
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.scores.errors import distances
from modsim3d.tracks.tracks import TrackEstimates, WorldTracks
from modsim3d.tracks.true_tracks import best_pairs
from modsim3d.world.encounters import hull_tracks

_SAME = 1e-5  # of a step, are rounding errors of a time: of seconds since 1970 in steps of 0.1 s they are up to 5e-6


@dataclass(frozen=True, eq=False)
class WorldTruth:
    """V vessels at S steps."""

    names: tuple[str, ...]  # their IDs
    own_ships: tuple[int, ...]  # indices of those that carry cameras, ascending
    hulls: HullTracks  # where they are
    # Whether a tracker is expected to follow each, shape (S, V): some camera saw a pixel of it in its last frame, and
    # it carries no camera itself.
    scored: Mask

    @classmethod
    def of(cls, rows: RunRows) -> Self:
        """The truth of a run."""
        scene = rows.scene
        hulls = hull_tracks(scene.vessels, scene.poses, rows.steps)
        scored = visibility(rows).any(axis=1) & np.isfinite(hulls.centres_m[..., 0])
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
        vectors = velocities(self.times_s, np.where(present[..., None], centres_m, 0.0), present)
        return np.where(present[..., None], vectors, np.nan)

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
        blend: Array = np.where(share == 0, start, np.where(share == 1, end, between))
        return blend

    def _legs(self, times_s: Array) -> tuple[Indices, Array]:
        """Step before each time, and the share of the way to the next, shapes (m,) and (m, 1). Half an interval before
        the first step and after the last the vessel goes on along its leg."""
        if len(self.times_s) < 2:
            return np.zeros(len(times_s), dtype=np.int64), np.zeros((len(times_s), 1))
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.times_s) - 2)
        share = (times_s - self.times_s[before]) / np.diff(self.times_s)[before]
        nearest = np.round(share)
        share = np.where(np.abs(share - nearest) < _SAME, nearest, share)
        return before, share[:, None]


def in_last_frames(rows: RunRows, frame: Indices, vessel: Indices, value: Indices | int) -> Indices:
    """Values of n vessels in frames, as they were in the last frame of each camera at each step, (n,) to (S, C, V);
    `NOBODY` for none."""
    cameras = len(rows.scene.cameras)
    table = np.full((rows.steps * cameras + 1, len(rows.scene.vessels)), NOBODY)  # the last is the frame NOBODY
    table[frame, vessel] = value
    last = rows.last_taken(np.arange(rows.steps))
    return table[np.where(last == NOBODY, -1, last * cameras + np.arange(cameras))]


def visibility(rows: RunRows) -> Mask:
    """Whether each camera's last frame has a visible pixel of each vessel at each step, shape (S, C, V). Where it is
    unknown what is visible, a vessel in the image is taken as seen, as in `TrueTracks`."""
    visible = rows.numbers("visible_px") != 0
    return np.not_equal(in_last_frames(rows, rows.truth_frame[visible], rows.truth_vessel[visible], 0), NOBODY)


_MIN_SIMILARITY = 0.5  # at the gate, 1 for two equal places: then two pairs are better than one, wherever they can be


@dataclass(frozen=True, eq=False)
class WorldMatching:
    """The one matching of tracks and V vessels at S steps that all scores are taken from. At each step as many pairs of
    the step before as possible stay, and then the sum of 1 − distance / (2 gate) is largest. Vessels that are not
    scored take part: a track that follows one is not counted."""

    truth: WorldTruth
    tracks: WorldTracks
    estimates: TrackEstimates  # what stands for the tracks at the steps
    followed_by: Indices  # row of the tracks that follows each vessel, `NOBODY` for none, shape (S, V)
    vessel: Indices  # index of the vessel that each of the m estimates follows, `NOBODY` for none, shape (m,)

    @property
    def found(self) -> Mask:
        """Mask of the vessels that are scored and followed, shape (S, V)."""
        return self.truth.scored & np.not_equal(self.followed_by, NOBODY)

    @property
    def counted(self) -> Mask:
        """Mask of the m estimates that are not on a vessel that is not scored, shape (m,)."""
        scored = np.pad(self.truth.scored, ((0, 0), (0, 1)), constant_values=True)  # the last is for NOBODY
        return np.asarray(scored[self.estimates.step, self.vessel], dtype=bool)

    def scored_frames(self) -> Iterator[tuple[Indices, Indices, Array]]:
        """Indices of the scored vessels (a,), numbers of the counted tracks (b,), and distances (a, b) at each step."""
        counted = self.counted
        for step, (first, stop) in enumerate(_edges(self.truth, self.estimates)):
            rows = self.estimates.row[first:stop][counted[first:stop]]
            vessels = np.flatnonzero(self.truth.scored[step])
            yield vessels, self.tracks.track[rows], distances_at(self.truth, self.tracks, step, vessels, rows)


def follow_in_world(truth: WorldTruth, tracks: WorldTracks, gate_m: float) -> WorldMatching:
    """Assign tracks to vessels at each step, no pair farther apart than the gate."""
    estimates = TrackEstimates.of(truth.times_s, tracks)
    followed_by, vessel = np.full(truth.scored.shape, NOBODY), np.full(len(estimates.row), NOBODY)
    last = np.full(len(truth.names), NOBODY)  # track of each vessel at the step before
    for step, (first, stop) in enumerate(_edges(truth, estimates)):
        present, rows = np.flatnonzero(np.isfinite(truth.hulls.centres_m[step, :, 0])), estimates.row[first:stop]
        if not len(present) or not len(rows):
            continue  # as in `follow`: such a step lies between two steps and is not the one before
        apart = distances_at(truth, tracks, step, present, rows)
        alike = np.maximum(1 - (1 - _MIN_SIMILARITY) * apart / gate_m, 0)
        i, j = best_pairs(alike, _MIN_SIMILARITY, last[present][:, None] == tracks.track[rows])
        followed_by[step, present[i]], vessel[first + j] = rows[j], present[i]
        last[:] = NOBODY
        last[present[i]] = tracks.track[rows[j]]
    return WorldMatching(truth, tracks, estimates, followed_by, vessel)


def distances_at(truth: WorldTruth, tracks: WorldTracks, step: int, vessels: Indices, rows: Indices) -> Array:
    """Distances of a vessels to b estimates of a step, each at the estimate's own time, shape (a, b); infinite where
    the vessel is absent at that time."""
    times_s = tracks.time_s[rows]
    if (times_s == truth.times_s[step]).all():
        return distances(truth.hulls.centres_m[step, vessels], tracks.position_m[rows])
    pairs = np.meshgrid(vessels, np.arange(len(rows)), indexing="ij")
    vessel, column = (grid.reshape(-1) for grid in pairs)
    offset = truth.positions_at(times_s[column], vessel) - tracks.position_m[rows[column]]
    apart = np.hypot(offset[:, 0], offset[:, 1]).reshape(len(vessels), len(rows))
    return np.where(np.isnan(apart), np.inf, apart)


def _edges(truth: WorldTruth, estimates: TrackEstimates) -> list[tuple[int, int]]:
    edges = np.searchsorted(estimates.step, np.arange(len(truth.times_s) + 1)).tolist()
    return list(pairwise(edges))
