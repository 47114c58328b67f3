"""Vessels whose AIS says too little of where they are: their boxes are ignored, and they are named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses, world_R_vehicle
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.learn.voyage.attitude import NEAR_S
from modsim3d.learn.voyage.clock import Reports, read_reports
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import line_of_sight
from modsim3d.world.poses.base import Poses
from modsim3d.world.vessel_motion import PosesInWaves

STALE_S = 60.0  # a vessel under way that has not reported for so long before and after a frame is left out of it
SLOW_KN, SLOW_STALE_S = 2.0, 180.0
"""Below this speed transponders report every three minutes: of class B always, of class A when moored (ITU-R M.1371-5,
Annex 1, Tables 1 and 2)."""
LYING_M_S = 0.25  # a slower vessel does not move between its reports, which come every three minutes
MAX_KN = 60.0  # a vessel that would be faster has jumped, unless the scene was made with another limit
BEYOND_S = 3.0  # a vessel is there so long before its first place and after its last: clocks and reports may be late
ALWAYS_OFF_M, OFF_M_S = 10.0, 0.5
"""How far off the place of a vessel that is left out may be: at once, and for each second since its last report."""


class Reason(Enum):
    """Reason why a vessel is left out of a frame."""

    STALE = "stale, no report within {limit}"
    JUMP = "jumping"
    OFF = "off"


@dataclass(frozen=True, eq=False)
class Regions(Columns):
    """The k regions where vessels that are left out may be in n frames."""

    frame: Indices  # non-decreasing, (k,)
    vessel: Indices
    boxes_px: Array  # x_min, y_min, x_max, y_max, (k, 4)
    depth_m: Array  # along the axis of the camera, (k,)

    def later(self, frames: int) -> Regions:
        """The regions with a number added to that of their frames."""
        return replace(self, frame=self.frame + frames)


@dataclass(frozen=True, eq=False)
class Presence:
    """Knowledge of the places of V vessels at n times. `guessed` has poses of the vessels that are off, straight
    between the last place before and the first after, and of those just beyond their first or last one, straight on."""

    reason: Mapping[Reason, Mask]  # whether it holds, (n, V)
    beyond: Mask  # whether a time is just before the first place of a vessel, or just after the last, (n, V)
    since_s: Array  # time to the nearest report, or to the nearest pose of the scene, 0 where unknown, (n, V)
    guessed: Poses


def stale_limit_s(scene: Scene, given: float | None) -> float:
    """Least time without a report of a vessel under way that is left out: the given one, else 60 s. Raises InputError
    if it is not positive, or the scene was not made from AIS."""
    if given is None:
        return STALE_S
    if not (np.isfinite(given) and given > 0):
        raise InputError("--stale", [f"must be seconds above 0 (got {given:g})"])
    if read_reports(scene.path) is None:
        problem = f"{scene.title} was not made by modsim3d ais: nothing says when its vessels have reported"
        raise InputError("--stale", [problem])
    return given


class ReportAge:
    """Age of reports on vessels, None without AIS; left out after `stale_s` under way, three minutes if slow."""

    def __init__(self, scene: Scene, reports: Reports | None, stale_s: float = STALE_S) -> None:
        """Look at the poses of all steps."""
        self._scene, self._reports, self.stale_s = scene, reports, stale_s
        self._every_s, self._poses = scene.times_s(0, scene.steps), scene.poses.poses(0, scene.steps)

    def at(self, times_s: Array) -> Presence:
        """Knowledge of the places at ascending times within the scene, (n,)."""
        count, vessels = len(times_s), len(self._scene.vessels)
        reason = {flaw: np.zeros((count, vessels), dtype=bool) for flaw in Reason}
        beyond, since_s = np.zeros((count, vessels), dtype=bool), np.zeros((count, vessels))
        status = Presence(reason, beyond, since_s, Poses.absent(count, vessels))
        for column, name in enumerate(self._scene.vessel_names):
            steps = np.flatnonzero(self._poses.present[:, column])
            if len(steps):
                self._fill(status, column, name, steps, times_s)
        return status

    def _fill(self, status: Presence, column: int, name: str, steps: Indices, times_s: Array) -> None:
        """Fill in the column of a vessel that is there at some steps, (k,)."""
        at_s, places_m = self._every_s[steps], self._poses.positions_m[steps, column]
        early, late = times_s < at_s[0] - NEAR_S, times_s > at_s[-1] + NEAR_S
        inside = ~early & ~late
        before = np.clip(np.searchsorted(at_s, times_s + NEAR_S, side="right") - 1, 0, len(at_s) - 1)
        before[late] = max(len(at_s) - 2, 0)  # straight on
        after = np.minimum(before + 1, len(at_s) - 1)
        span_s = np.where(after > before, at_s[after] - at_s[before], 1.0)
        way_m = places_m[after] - places_m[before]
        speed = np.linalg.norm(way_m, axis=1) / span_s
        jumped = speed > MAX_KN * KNOT_M_S
        off = (steps[after] - steps[before] > 1) & (times_s - at_s[before] > NEAR_S) & inside
        present = inside & ~off
        beyond = ~inside & (times_s >= at_s[0] - BEYOND_S) & (times_s <= at_s[-1] + BEYOND_S)
        status.reason[Reason.OFF][:, column], status.beyond[:, column] = off, beyond
        status.reason[Reason.JUMP][:, column] = present & jumped
        apart_s = np.minimum(np.abs(times_s - at_s[before]), np.abs(times_s - at_s[after]))
        status.since_s[:, column] = np.where(off | beyond, apart_s, 0.0)
        way_m[~inside & jumped] = 0
        start = np.where(late, after, before)
        status.guessed.present[:, column] = off | beyond
        status.guessed.positions_m[:, column] = places_m[start] + ((times_s - at_s[start]) / span_s)[:, None] * way_m
        status.guessed.headings_rad[:, column] = self._poses.headings_rad[steps[before], column]
        self._fill_reports(status, column, name, times_s, present, speed)

    def _fill_reports(
        self, status: Presence, column: int, name: str, times_s: Array, present: Mask, speed: Array
    ) -> None:
        """Fill in what the reports of a vessel say of times (n,), given whether it is there, and its speed in m/s."""
        used_s = self._reports.used_s.get(name) if self._reports else None
        if self._reports is None or used_s is None or not len(used_s):
            return
        previous = np.searchsorted(used_s, times_s, side="right") - 1
        last_s, next_s = used_s[np.maximum(previous, 0)], used_s[np.minimum(previous + 1, len(used_s) - 1)]
        nearest_s = np.minimum(np.abs(times_s - last_s), np.abs(next_s - times_s))
        least_s = np.where(speed < SLOW_KN * KNOT_M_S, max(self.stale_s, SLOW_STALE_S), self.stale_s)
        status.reason[Reason.STALE][:, column] = present & (nearest_s > least_s) & (speed > LYING_M_S)
        jumps_s = self._reports.jumps_s.get(name, np.empty(0))
        jumps_between = np.searchsorted(jumps_s, next_s) > np.searchsorted(jumps_s, last_s)
        status.reason[Reason.JUMP][:, column] |= present & jumps_between
        status.since_s[:, column] = np.where(status.guessed.present[:, column], status.since_s[:, column], nearest_s)


@dataclass(frozen=True, eq=False)
class Exclusions:
    """Rows and regions left out of the frames of one camera."""

    rows: Mask  # of the T rows of the truth, (T,)
    boxes_px: Array  # where the vessels of those rows may be instead, (k, 4)
    off: Regions  # where vessels may be that the truth lacks
    notes: tuple[str, ...]  # a line for each vessel that is left out of frames in which it is, or would be


def exclusions(
    fresh: ReportAge, scene: Scene, camera: Camera, camera_poses: CameraPoses, times_s: Array, seen: Regions
) -> Exclusions:
    """Rows and regions left out of n frames at ascending times (n,), given the camera's poses and the truth's rows."""
    rows, pieces, boxes = np.zeros(len(seen.frame), dtype=bool), [_NOTHING], [np.empty((0, 4))]
    counts = {flaw: np.zeros(len(scene.vessels), dtype=np.int64) for flaw in Reason}
    beyond = np.zeros(len(scene.vessels), dtype=np.int64)
    length = max(1, _AT_ONCE // len(scene.vessels))
    for first in range(0, len(times_s), length):
        frames = np.arange(first, min(first + length, len(times_s)))
        status = fresh.at(times_s[frames])
        start, stop = np.searchsorted(seen.frame, (frames[0], frames[-1] + 1))
        part = seen.take(slice(start, stop)).later(-first)
        for flaw, holds in status.reason.items():
            unsure = holds[part.frame, part.vessel]
            rows[start:stop] |= unsure
            counts[flaw] += np.bincount(part.vessel[unsure], minlength=len(scene.vessels))
        look = CameraPoses(camera_poses.camera_R_world[frames], camera_poses.positions_m[frames])
        boxes.append(_grown(part.take(rows[start:stop]), camera, look, status).boxes_px)
        away = _guessed_regions(scene, camera, look, status)
        is_beyond = status.beyond[away.frame, away.vessel]
        beyond += np.bincount(away.vessel[is_beyond], minlength=len(scene.vessels))
        counts[Reason.OFF] += np.bincount(away.vessel[~is_beyond], minlength=len(scene.vessels))
        pieces.append(away.later(first))
    notes = (*_sentences(scene, counts, len(times_s), fresh.stale_s), *_beyond_sentences(beyond))
    return Exclusions(rows, np.concatenate(boxes), Regions.join(pieces), notes)


_NOTHING = Regions(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty(0))
_AT_ONCE = 1_000_000  # frames times vessels, at some 60 bytes each


def _sentences(scene: Scene, counts: Mapping[Reason, Indices], frames: int, stale_s: float) -> Iterator[str]:
    limit = f"{stale_s:g} s" + (f" ({SLOW_STALE_S:g} s below {SLOW_KN:g} kn)" if stale_s < SLOW_STALE_S else "")
    for column, name in enumerate(scene.vessel_names):
        if parts := [
            f"{flaw.value.format(limit=limit)} in {count[column]:,}" for flaw, count in counts.items() if count[column]
        ]:
            yield f"vessel '{name}' is left out of frames: its AIS is {'; '.join(parts)} of {frames:,}"


def _beyond_sentences(beyond: Indices) -> Iterator[str]:
    """Sentences on vessels that come or go, given their numbers of boxes just beyond their tracks, shape (V,)."""
    if beyond.any():
        vessels = counted(int(np.count_nonzero(beyond)), "vessel is", "vessels are")
        yield (
            f"{vessels} left out of frames up to {BEYOND_S:g} s before the first place that the scene has, or after "
            f"the last: {counted(int(beyond.sum()), 'box', 'boxes')}"
        )


def _guessed_regions(scene: Scene, camera: Camera, camera_poses: CameraPoses, status: Presence) -> Regions:
    """Regions where vessels without AIS may be in the frames of a camera with some poses, one for each frame."""
    poses, frames = status.guessed, np.arange(len(status.since_s))
    places = PosesInWaves(poses, np.zeros((*poses.present.shape, 3)), world_R_vehicle(poses.headings_rad))
    sight = line_of_sight(camera, camera_poses, frames, scene.vessels, places, (), scene.sea == "curved")
    outlines = sight.outlines(as_shoeboxes=True)
    regions = Regions(outlines.frame, outlines.occluder, outlines.boxes_px, outlines.depth_m)
    return _grown(regions, camera, camera_poses, status)


def _grown(regions: Regions, camera: Camera, camera_poses: CameraPoses, status: Presence) -> Regions:
    """Regions as much larger as places may be off, across the line of sight or along it. A vessel at distance r that is
    nearer by d is larger, and its waterline lower, by d / (r − d); one that is farther moves by less."""
    off_m = ALWAYS_OFF_M + OFF_M_S * status.since_s[regions.frame, regions.vessel]
    depth_m = np.maximum(regions.depth_m, camera.intrinsics.near_clip_m)
    share = off_m / np.maximum(depth_m - off_m, off_m)  # at most 1, which is off by half the distance
    low, high = regions.boxes_px[:, :2], regions.boxes_px[:, 2:]
    f1, f2 = camera.intrinsics.focal_px
    below_px = f2 * np.abs(camera_poses.positions_m[regions.frame, 2]) / depth_m
    more = share[:, None] * np.column_stack([np.full(len(share), f1), below_px + (high - low)[:, 1]])
    size = np.array(camera.intrinsics.image_size_px, dtype=np.float64)
    boxes = np.concatenate([np.maximum(low - more, 0), np.minimum(high + more, size)], axis=1)
    return replace(regions, boxes_px=boxes)
