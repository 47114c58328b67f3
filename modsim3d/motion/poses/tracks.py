"""Vessels along waypoints, at constant speed between two of them, present from the first to the last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from pydantic import RootModel

from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError
from modsim3d.geometry.rotations import heading_of
from modsim3d.inputs.validation import MOST_PROBLEMS, Metres, Number, join_path, nearest
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys
from modsim3d.motion.poses.long_times import LongTimes

Waypoint = tuple[Number, Metres, Metres]
"""Time in seconds, w1 and w2 in metres."""


class TracksKeys(SourceKeys, RootModel[dict[str, list[Waypoint]]]):
    """Vessels along waypoints: vessel ID → waypoints."""

    drawn: ClassVar[bool] = False

    def build(self, request: PoseRequest) -> Tracks:
        """The tracks through the waypoints."""
        return waypoint_tracks(self.root, request.names or (), request.steps or 0, request.time_step_s or 0.0)


@dataclass(frozen=True, eq=False)
class Tracks:
    """Vessels that follow waypoints and head along their legs.

    `waypoints` are times in seconds and places w1, w2 in metres of each vessel, shape (k, 3); None without a track.
    """

    timestamps: Sequence[str]
    waypoints: tuple[Array | None, ...]

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1."""
        times_s = np.array([float(text) for text in self.timestamps[first:stop]])
        poses = Poses.absent(len(times_s), len(self.waypoints))
        tracks = {column: track for column, track in enumerate(self.waypoints) if track is not None}
        if tracks:
            columns = list(tracks)
            poses.present[:, columns], places_m, headings_rad = _along(list(tracks.values()), times_s)
            poses.positions_m[:, columns, :2] = np.where(poses.present[:, columns, None], places_m, 0.0)
            poses.headings_rad[:, columns] = np.where(poses.present[:, columns], headings_rad, 0.0)
        return poses


def _along(tracks: Sequence[Array], times_s: Array) -> tuple[Mask, Array, Array]:
    """Whether V vessels are there at S times, shape (S, V), their places, (S, V, 2), and headings in radians, (S, V).

    Times ascend. Each track has times in seconds and places w1, w2 in metres of at least two waypoints, shape (k, 3).
    Where a vessel is not there, its place and heading mean nothing.
    """
    waypoints, counts = np.concatenate(tracks), np.array([len(track) for track in tracks])
    first = np.cumsum(counts) - counts
    step, vessel = np.searchsorted(times_s, waypoints[:, 0]), np.repeat(np.arange(len(tracks)), counts)
    size = len(times_s) + 1, len(tracks)
    reached = np.cumsum(np.bincount(step * size[1] + vessel, minlength=size[0] * size[1]).reshape(size), axis=0)[:-1]
    leg = first + np.clip(reached - 1, 0, counts - 2)
    start, end = waypoints[leg], waypoints[leg + 1]
    there = (times_s[:, None] >= waypoints[first, 0]) & (times_s[:, None] <= waypoints[first + counts - 1, 0])
    share = (times_s[:, None] - start[..., 0]) / (end[..., 0] - start[..., 0])
    places_m = start[..., 1:] + share[..., None] * (end - start)[..., 1:]
    return there, places_m, heading_of((end - start)[..., 1:])


def waypoint_tracks(
    tracks: Mapping[str, Sequence[Waypoint]], vessels: Sequence[str], steps: int, time_step_s: float
) -> Tracks:
    """Tracks from the waypoints of each vessel in a scene file; a vessel without a track is always absent.

    Raises:
        InputError: With every problem found.
    """
    problems: list[str] = []
    known = set(vessels)
    for name, waypoints in tracks.items():
        if len(problems) >= MOST_PROBLEMS:
            break
        path = join_path("poses", "tracks", name)
        if name not in known:
            problems.append(f"{path}: no vessel '{name}' ({nearest(name, vessels)})")
        if len(waypoints) < 2:
            problems.append(f"{path}: at least two waypoints [time_s, w1_m, w2_m] are needed (got {len(waypoints)})")
        for i, (before, after) in enumerate(pairwise(waypoints), start=1):
            if after[0] <= before[0]:
                problems.append(f"{path}[{i}]: times must increase, but {after[0]:g} s follows {before[0]:g} s")
            if before[1:] == after[1:]:
                problems.append(f"{path}[{i}]: same place as the waypoint before; a heading needs two places")
    if problems:
        raise InputError("poses.tracks", problems)
    arrays = tuple(np.array(tracks[name], dtype=np.float64) if name in tracks else None for name in vessels)
    return Tracks(LongTimes(steps, time_step_s), arrays)
