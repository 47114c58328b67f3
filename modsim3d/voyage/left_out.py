"""Vessels whose AIS says too little of where they are: their boxes are ignored, and they are named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from modsim3d.ais.headings import KNOT_M_S
from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.rotations import world_R_vehicle
from modsim3d.motion.poses import Poses
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import line_of_sight
from modsim3d.voyage.reports import Reports
from modsim3d.voyage.sampling import NEAR_S

STALE_S = 60.0
"""A vessel under way that has not reported for so long before and after a frame is left out of it."""
LYING_M_S = 0.25
"""A slower vessel does not move between its reports, which come every three minutes."""
MOST_KN = 60.0
"""A vessel that would be faster has jumped, unless the scene was made with another limit."""
ALWAYS_OFF_M, OFF_M_S = 10.0, 0.5
"""How far off the place of a vessel that is left out may be: at once, and for each second since its last report."""


class Reason(Enum):
    """Why a vessel is left out of a frame."""

    STALE = "stale, no report within {stale_s:g} s"
    JUMP = "jumping"
    OFF = "off"


@dataclass(frozen=True, eq=False)
class Regions:
    """Where vessels that are left out may be in n frames: k regions.

    Attributes:
        frame: Number of the frame, non-decreasing, shape (k,).
        vessel: Index of the vessel, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        depth_m: Distance along the axis of the camera, shape (k,).
    """

    frame: Indices
    vessel: Indices
    boxes_px: Array
    depth_m: Array


@dataclass(frozen=True, eq=False)
class Freshness:
    """How well the places of a scene's vessels are known at some times.

    Attributes:
        reason: Reason → whether it holds, shape (n, V).
        since_s: Time to the nearest report, or to the nearest pose of the scene, 0 where unknown, shape (n, V).
        off: Poses of the vessels that are off, straight between the last place before and the first after.
    """

    reason: Mapping[Reason, np.ndarray]
    since_s: Array
    off: Poses

    @property
    def left_out(self) -> np.ndarray:
        """Whether each vessel is left out, shape (n, V)."""
        found: np.ndarray = np.logical_or.reduce(list(self.reason.values()))
        return found


def freshness(scene: Scene, reports: Reports | None, times_s: Array, stale_s: float = STALE_S) -> Freshness:
    """How well the places of the scene's V vessels are known.

    Args:
        scene: The scene.
        reports: When its vessels have reported, if it was made from AIS.
        times_s: Ascending times within the scene, shape (n,).
        stale_s: Least time without a report of a vessel under way that is left out.
    """
    every_s, poses = scene.times_s(0, scene.steps), scene.poses.poses(0, scene.steps)
    count, vessels = len(times_s), len(scene.vessels)
    reason = {each: np.zeros((count, vessels), dtype=bool) for each in Reason}
    since, off = np.zeros((count, vessels)), Poses.absent(count, vessels)
    for column, name in enumerate(scene.vessel_names):
        known = np.flatnonzero(poses.present[:, column])
        if not len(known):
            continue
        at_s, places_m = every_s[known], poses.positions_m[known, column]
        before = np.clip(np.searchsorted(at_s, times_s + NEAR_S, side="right") - 1, 0, len(at_s) - 1)
        after = np.minimum(before + 1, len(at_s) - 1)
        inside = (times_s >= at_s[0] - NEAR_S) & (times_s <= at_s[-1] + NEAR_S)
        gap = (known[after] - known[before] > 1) & (times_s - at_s[before] > NEAR_S) & inside
        span = np.where(after > before, at_s[after] - at_s[before], 1.0)
        speed = np.linalg.norm(places_m[after] - places_m[before], axis=1) / span
        reason[Reason.OFF][:, column] = gap
        reason[Reason.JUMP][:, column] = inside & ~gap & (speed > MOST_KN * KNOT_M_S)
        since[gap, column] = np.minimum(times_s - at_s[before], at_s[after] - times_s)[gap]
        share = np.clip((times_s - at_s[before]) / span, 0, 1)[:, None]
        off.present[:, column] = gap
        off.positions_m[:, column] = places_m[before] + share * (places_m[after] - places_m[before])
        off.headings_rad[:, column] = poses.headings_rad[known[before], column]
        if reports is not None and len(used := reports.used_s.get(name, np.empty(0))):
            previous = np.searchsorted(used, times_s, side="right") - 1
            last, first = used[np.maximum(previous, 0)], used[np.minimum(previous + 1, len(used) - 1)]
            near = np.minimum(np.abs(times_s - last), np.abs(first - times_s))
            reason[Reason.STALE][:, column] = inside & ~gap & (near > stale_s) & (speed > LYING_M_S)
            jumps = reports.jumps_s.get(name, np.empty(0))
            between = np.searchsorted(jumps, first) > np.searchsorted(jumps, last)
            reason[Reason.JUMP][:, column] |= inside & ~gap & between
            since[:, column] = np.where(gap, since[:, column], near)
    return Freshness(reason, since, off)


def told(scene: Scene, found: Freshness, in_image: np.ndarray, stale_s: float) -> Iterator[str]:
    """A line for each vessel that is left out of frames in which it is seen or would be, shape (n, V)."""
    for column, name in enumerate(scene.vessel_names):
        seen = in_image[:, column]
        parts = [
            f"{each.value.format(stale_s=stale_s)} in {count:,}"
            for each in Reason
            if (count := int((found.reason[each][:, column] & seen).sum()))
        ]
        if parts:
            yield f"vessel '{name}' is left out of frames: its AIS is {'; '.join(parts)} of {len(seen):,}"


def off_regions(scene: Scene, camera: Camera, camera_poses: CameraPoses, found: Freshness) -> Regions:
    """Where vessels without AIS may be in the frames of a camera with some poses, one for each frame."""
    poses, frames = found.off, np.arange(len(found.since_s))
    empty = np.zeros((*poses.present.shape, 3))
    places = PosesInWaves(poses, empty, world_R_vehicle(poses.headings_rad))
    sight = line_of_sight(camera, camera_poses, frames, scene.vessels, places, (), scene.sea == "curved")
    outlines = sight.outlines(as_shoeboxes=True)
    regions = Regions(outlines.frame, outlines.occluder, outlines.boxes_px, outlines.depth_m)
    return grown(regions, camera, found)


def grown(regions: Regions, camera: Camera, found: Freshness) -> Regions:
    """Regions that are as much larger as the places may be off."""
    off_m = ALWAYS_OFF_M + OFF_M_S * found.since_s[regions.frame, regions.vessel]
    share = off_m / np.maximum(regions.depth_m, camera.intrinsics.near_clip_m)
    low, high = regions.boxes_px[:, :2], regions.boxes_px[:, 2:]
    more = np.column_stack([camera.intrinsics.focal_px[0] * share, (high - low)[:, 1] * share])
    size = np.array(camera.intrinsics.image_size_px, dtype=np.float64)
    boxes = np.concatenate([np.maximum(low - more, 0), np.minimum(high + more, size)], axis=1)
    return replace(regions, boxes_px=boxes)
