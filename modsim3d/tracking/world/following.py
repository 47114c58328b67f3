"""Which track follows which vessel on the sea, step by step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.runs.files.columns import NOBODY
from modsim3d.tracking.scores.point_sets import distances
from modsim3d.tracking.world.truth import WorldTruth
from modsim3d.tracks.following import best_pairs
from modsim3d.tracks.world_tracks import WorldTracks

_LEAST = 0.5
"""Similarity at the gate, which is 1 for two equal places: then two pairs are better than one, wherever they can be."""


@dataclass(frozen=True, eq=False)
class WorldFollowing:
    """The one matching of K tracks and V vessels at S steps that all scores are taken from.

    At each step as many pairs of the step before as possible stay, and then the sum of 1 − distance / (2 gate) is
    largest. Vessels that are not scored take part: a track that follows one is not counted.

    Attributes:
        truth: The vessels.
        tracks: The tracks.
        estimate: Row of the tracks that stands for each track at each step, `NOBODY` for none, shape (S, K).
        track: Index of the track that follows each vessel, `NOBODY` for none, shape (S, V).
        vessel: Index of the vessel that each track follows, `NOBODY` for none, shape (S, K).
    """

    truth: WorldTruth
    tracks: WorldTracks
    estimate: Indices
    track: Indices
    vessel: Indices

    @property
    def found(self) -> Mask:
        """Which vessels are scored and followed, shape (S, V)."""
        return self.truth.scored & np.not_equal(self.track, NOBODY)

    @property
    def counted(self) -> Mask:
        """Which tracks are there and not on a vessel that is not scored, shape (S, K)."""
        on = np.take_along_axis(np.pad(self.truth.scored, ((0, 0), (0, 1)), constant_values=True), self.vessel, axis=1)
        counted: Mask = np.not_equal(self.estimate, NOBODY) & np.asarray(on, dtype=np.bool_)
        return counted


def follow_in_world(truth: WorldTruth, tracks: WorldTracks, gate_m: float) -> WorldFollowing:
    """Assign tracks to vessels at each step, no pair farther apart than the gate."""
    estimate = estimates_at(truth.times_s, tracks)
    track, vessel = np.full(truth.scored.shape, NOBODY), np.full(estimate.shape, NOBODY)
    last = track[0]
    for step in range(len(estimate)):
        a, b, apart = distances_at(truth, tracks, estimate, step)
        if not len(a) or not len(b):
            continue  # as in `follow`: such a step lies between two steps and is not the one before
        alike = np.maximum(1 - (1 - _LEAST) * apart / gate_m, 0)
        i, j = best_pairs(alike, _LEAST, last[a][:, None] == b)
        track[step, a[i]], vessel[step, b[j]] = b[j], a[i]
        last = track[step]
    return WorldFollowing(truth, tracks, estimate, track, vessel)


def distances_at(
    truth: WorldTruth, tracks: WorldTracks, estimate: Indices, step: int
) -> tuple[Indices, Indices, Array]:
    """Vessels and tracks at a step, shapes (a,) and (b,), and their distances at the tracks' times, shape (a, b)."""
    present = np.flatnonzero(np.isfinite(truth.hulls.centres_m[step, :, 0]))
    there = np.flatnonzero(estimate[step] != NOBODY)
    rows = estimate[step, there]
    times_s = tracks.time_s[rows]
    if (times_s == truth.times_s[step]).all():
        return present, there, distances(truth.hulls.centres_m[step, present], tracks.position_m[rows])
    vessels, columns = (each.reshape(-1) for each in np.meshgrid(present, np.arange(len(rows)), indexing="ij"))
    offset = truth.positions_at(times_s[columns], vessels) - tracks.position_m[rows[columns]]
    apart = np.hypot(offset[:, 0], offset[:, 1]).reshape(len(present), len(rows))
    return present, there, np.where(np.isnan(apart), np.inf, apart)


def estimates_at(times_s: Array, tracks: WorldTracks) -> Indices:
    """The row of each track that is nearest in time to each step, `NOBODY` if none is near enough, shape (S, K).

    Near enough is half of the median time between two estimates of a track, or half a step if that is longer: so a
    tracker may be slower than the run's steps and is still there at each.
    """
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    reach_s = max(step_s, tracks.interval_s) / 2
    reach_s += 1e-6 * max(reach_s, 1.0)  # times have rounding errors
    edges = np.searchsorted(tracks.track, np.arange(len(tracks.track_names) + 1))
    found = np.full((len(times_s), len(tracks.track_names)), NOBODY)
    for index, (first, stop) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        if first == stop:
            continue
        mine = tracks.time_s[first:stop]
        after = np.clip(np.searchsorted(mine, times_s), 0, len(mine) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(times_s - mine[before] <= mine[after] - times_s, before, after)
        near = np.abs(mine[nearer] - times_s) <= reach_s
        found[near, index] = first + nearer[near]
    return found
