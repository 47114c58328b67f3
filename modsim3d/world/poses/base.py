"""Poses, and the interface of every pose source."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import ClassVar, Protocol, overload

import numpy as np
from pydantic import RootModel

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.geometry.camera_poses import heading_of
from modsim3d.io.validation import MAX_PROBLEMS, Metres, Number, Strict, join_path, nearest
from modsim3d.world.bodies import Obstacle
from modsim3d.world.vessels import Vessel


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of V vessels at S steps.

    Attributes:
        present: Whether each vessel is in the scene, shape (S, V).
        positions_m: Centres of the bottom plane in WCF, shape (S, V, 3); zero where absent.
        headings_rad: Counter-clockwise from w1, shape (S, V); zero where absent.
    """

    present: Mask
    positions_m: Array
    headings_rad: Array

    @classmethod
    def absent(cls, steps: int, vessels: int) -> Poses:
        """Poses to be filled in, in which every vessel is absent at every step."""
        shape = steps, vessels
        return cls(np.zeros(shape, dtype=bool), np.zeros((*shape, 3)), np.zeros(shape))

    def rows(self, rows: Indices | slice) -> Poses:
        """Poses at some of the S steps, by index, shape (n,), or slice."""
        return Poses(self.present[rows], self.positions_m[rows], self.headings_rad[rows])


class PoseSource(Protocol):
    """A source of poses for the vessels of a scene, in the order in which the scene names them."""

    @property
    def timestamps(self) -> Sequence[str]:
        """Texts of the steps' times in seconds, in order."""

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first, first + 1, …, stop − 1, with a column for each vessel."""


@dataclass(frozen=True)
class PoseRequest:
    """Facts about its scene for a pose source.

    Attributes:
        folder: Folder of the scene file; paths in it are relative to this.
        names: IDs of the vessels, in the scene's order; None if the vessels cannot be read.
        vessels: The vessels; empty if one of them is wrong.
        steps: Number of time steps, if the scene gives it.
        time_step_s: Interval between steps, if the scene gives it.
        seed: Seed of all random numbers.
        obstacles: The scene's obstacles.
    """

    folder: Path
    names: tuple[str, ...] | None
    vessels: tuple[Vessel, ...] = ()
    steps: int | None = None
    time_step_s: float | None = None
    seed: int = 0
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def timestamps(self) -> tuple[str, ...]:
        """Texts of the times for a source that has none of its own."""
        return generated_timestamps(self.steps or 0, self.time_step_s or 0.0)


class SourceKeys:
    """The keys of a pose source in a scene file, and the way from them to poses: a mixin for a pydantic model.

    Attributes:
        generated: Whether the source uses the scene's times, so that the scene must give `steps` and `time_step_s`.
            Such a source is built only if the rest of the scene is valid; one with its own times is always built.
        drawn: Whether the traffic, that is who is where, depends on the seed.
    """

    generated: ClassVar[bool] = True
    drawn: ClassVar[bool] = True

    @property
    def files(self) -> tuple[str, ...]:
        """Files that the source reads, as the scene file names them."""
        return ()

    def vessels(self, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
        """Entries of the vessels that the source itself draws, in the form of a vessels file; none by default.

        They are added to those of the scene file, which are all that the request has here. `build` gets both: the
        scene file's, then these.

        Raises:
            InputError: With every problem found.
        """
        return {}

    def build(self, request: PoseRequest) -> PoseSource:
        """The poses of a scene's vessels.

        Raises:
            InputError: With every problem found.
        """
        raise NotImplementedError


def times_s(timestamps: Sequence[str], first: int, stop: int) -> Array:
    """Times of steps first to stop − 1 since the first step, in seconds, shape (stop − first,)."""
    return np.array([float(text) for text in timestamps[first:stop]]) - float(timestamps[0])


def generated_timestamps(steps: int, time_step_s: float, first: int = 0) -> tuple[str, ...]:
    """Exact decimals of step × interval, at least one, from step `first` to steps − 1: 0.0, 0.2, 0.4, 0.6."""
    interval = Decimal(repr(float(time_step_s)))
    parts = (f"{interval * step:f}".partition(".") for step in range(first, steps))
    return tuple(f"{whole}.{decimals.rstrip('0') or '0'}" for whole, _, decimals in parts)


Place = tuple[Sequence[float], float]  # centre of the bottom plane in WCF, three metres, and the heading in radians


class PosesByTime(SourceKeys, Strict):
    """A pose source as a function of time. Its fields are its keys in the scene file."""

    def at(self, time_s: float, request: PoseRequest) -> Mapping[str, Place]:
        """Place and heading of each vessel that is present.

        The result may depend on the arguments only: it is called for times in any order, more than once, and in several
        processes.

        Returns:
            Vessel ID → place and heading; vessels that are not named are absent.
        """
        raise NotImplementedError

    def build(self, request: PoseRequest) -> TimedPoses:
        """Poses at the scene's steps."""
        return TimedPoses(request.timestamps, self.at, request)


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """Poses from the function `at` of the time in seconds."""

    timestamps: Sequence[str]
    at: Callable[[float, PoseRequest], Mapping[str, Place]]
    request: PoseRequest

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1. Raises ModsimError if `at` names a vessel that the scene does not have."""
        names = self.request.names or ()
        columns = {name: column for column, name in enumerate(names)}
        poses = Poses.absent(stop - first, len(names))
        for row, timestamp in enumerate(self.timestamps[first:stop]):
            for name, (position_m, heading_rad) in self.at(float(timestamp), self.request).items():
                if name not in columns:
                    raise ModsimError(f"at time {timestamp} s: no vessel '{name}' ({nearest(name, names)})")
                poses.present[row, columns[name]] = True
                poses.positions_m[row, columns[name]] = position_m
                poses.headings_rad[row, columns[name]] = heading_rad
        return poses


TOGETHER = 1024  # steps whose texts are worked out together


@dataclass(frozen=True)
class LongTimes(Sequence[str]):
    """Times of `generated_timestamps`, worked out where they are asked for; slices are tuples."""

    steps: int
    time_step_s: float

    def __len__(self) -> int:
        """The number of steps."""
        return self.steps

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[str, ...]: ...
    def __getitem__(self, index: int | slice) -> str | tuple[str, ...]:
        """The text of a step, or of some."""
        chosen = range(self.steps)[index]
        if isinstance(chosen, int):
            return _texts(self.time_step_s, chosen // TOGETHER)[chosen % TOGETHER]
        if not chosen:
            return ()
        low, high = min(chosen[0], chosen[-1]), max(chosen[0], chosen[-1])
        first = low // TOGETHER
        pieces = (_texts(self.time_step_s, number) for number in range(first, high // TOGETHER + 1))
        texts, before = tuple(chain.from_iterable(pieces)), first * TOGETHER
        return texts[low - before : high - before + 1][:: chosen.step]


@lru_cache(maxsize=8)
def _texts(time_step_s: float, number: int) -> tuple[str, ...]:
    return generated_timestamps((number + 1) * TOGETHER, time_step_s, first=number * TOGETHER)


Waypoint = tuple[Number, Metres, Metres]  # time in seconds, w1 and w2 in metres


class TracksKeys(SourceKeys, RootModel[dict[str, list[Waypoint]]]):
    """Vessels along waypoints: vessel ID → waypoints."""

    drawn: ClassVar[bool] = False

    def build(self, request: PoseRequest) -> WaypointTracks:
        """The tracks through the waypoints."""
        return waypoint_tracks(self.root, request.names or (), request.steps or 0, request.time_step_s or 0.0)


@dataclass(frozen=True, eq=False)
class WaypointTracks:
    """Vessels that follow waypoints and head along their legs. `waypoints` are times in seconds and places w1, w2 in
    metres of each vessel: (k, 3); None without a track."""

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
    """Whether V vessels are there at S ascending times (S, V), their places (S, V, 2), and headings in radians (S, V).
    Each track has times in seconds and places w1, w2 in metres of at least two waypoints: (k, 3). Where a vessel is not
    there, its place and heading mean nothing."""
    waypoints, counts = np.concatenate(tracks), np.array([len(track) for track in tracks])
    first = np.cumsum(counts) - counts
    step, vessel = np.searchsorted(times_s, waypoints[:, 0]), np.repeat(np.arange(len(tracks)), counts)
    size = len(times_s) + 1, len(tracks)
    reached = np.cumsum(np.bincount(step * size[1] + vessel, minlength=size[0] * size[1]).reshape(size), axis=0)[:-1]
    leg = first + np.clip(reached - 1, 0, counts - 2)
    start, end = waypoints[leg], waypoints[leg + 1]
    present = (times_s[:, None] >= waypoints[first, 0]) & (times_s[:, None] <= waypoints[first + counts - 1, 0])
    share = (times_s[:, None] - start[..., 0]) / (end[..., 0] - start[..., 0])
    places_m = start[..., 1:] + share[..., None] * (end - start)[..., 1:]
    return present, places_m, heading_of((end - start)[..., 1:])


def waypoint_tracks(
    tracks: Mapping[str, Sequence[Waypoint]], vessels: Sequence[str], steps: int, time_step_s: float
) -> WaypointTracks:
    """Tracks from waypoints in a scene file; vessels without one are absent. Raises InputError with every problem."""
    problems: list[str] = []
    names = set(vessels)
    for name, waypoints in tracks.items():
        if len(problems) >= MAX_PROBLEMS:
            break
        path = join_path("poses", "tracks", name)
        if name not in names:
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
    return WaypointTracks(LongTimes(steps, time_step_s), arrays)
