"""Edges of a vessel's box in the image, for any values of the parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera, Distortion, Intrinsics
from modsim3d.geometry.camera_poses import CameraPoses, poses_ashore, poses_on_board, vehicle_R_nominal, world_R_vehicle
from modsim3d.geometry.curved_sea import lowered
from modsim3d.learn.voyage.attitude import Attitude, Sampler
from modsim3d.learn.voyage.log_to_scene import hull_of, stacked
from modsim3d.learn.voyage.registration.parameters import Values
from modsim3d.scene.scene import Scene
from modsim3d.world.vessels import shoebox

# ---- Where the vessels and the camera of a scene are at any time ----

BEYOND_S = 60.0  # how long before the first step and after the last one vessels go on
MEAN_S = 30.0


@dataclass(frozen=True, eq=False)
class KnownTraffic:
    """Poses of V vessels at S ascending times, to interpolate between. Where absent, before and after they go on at
    their speed: a fit of the clock moves times, and a match near a track's end must not tear away."""

    camera: Camera  # that looks at them
    times_s: Array  # of the steps since the scene's first, with one `BEYOND_S` before and one after them, (S,)
    present: Mask  # (S, V); nowhere at the first and the last of these times
    places_m: Array  # positions in metres, unwrapped heading, roll, pitch and yaw in waves in radians, (S, V, 7)
    carrier: int | None  # index of the vessel that carries the camera; None ashore
    composition: str  # how its angles and the camera's combine; see `poses_on_board`
    curved: bool  # as the sea is

    @classmethod
    def of(cls, scene: Scene, camera: Camera, attitude: Attitude | None = None) -> KnownTraffic:
        """That of a scene, all its steps, before one of its cameras; an attitude as it was measured replaces waves."""
        motion = Sampler(scene, attitude).at(scene.times_s(0, scene.steps))
        headings = motion.poses.headings_rad[..., None]
        places = np.concatenate([motion.poses.positions_m, headings, motion.angles_rad], axis=-1)
        name = camera.mount.vessel
        steps_s = scene.times_s(0, scene.steps)
        times_s = np.concatenate([[steps_s[0] - BEYOND_S], steps_s, [steps_s[-1] + BEYOND_S]])
        present = np.pad(motion.poses.present, ((1, 1), (0, 0)))
        return cls(
            camera,
            times_s,
            present,
            _continued(times_s, present, np.pad(places, ((1, 1), (0, 0), (0, 0)))),
            None if name is None else scene.vessel_names.index(name),
            scene.waves.composition if scene.waves else "rigid",
            scene.sea == "curved",
        )

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the scene's first and last step."""
        return float(self.times_s[1]), float(self.times_s[-2])

    def presence(self, times_s: Array, vessel: Indices) -> Mask:
        """Whether vessels are there at times: at the steps before and after, shape (n,)."""
        before, share = self._between(times_s)
        return self.present[before, vessel] & self.present[np.where(share > 0, before + 1, before), vessel]

    def at(self, times_s: Array, vessel: Indices) -> tuple[Array, Array]:
        """Positions in WCF, shape (n, 3), and rotations VCF to WCF, (n, 3, 3), of vessels at times, both (n,)."""
        places = self._interpolated(self.places_m, times_s, vessel)
        nominal = world_R_vehicle(places[:, 3])
        if not self.places_m[..., 4:].any():
            return places[:, :3], nominal
        return places[:, :3], nominal @ np.swapaxes(vehicle_R_nominal(places[:, 4:]), -1, -2)

    def velocities(self, times_s: Array, vessel: Indices) -> Array:
        """Mean velocities along and across from `MEAN_S` before to `MEAN_S` after n times, in m/s, shape (n, 2). They
        turn with the vessel: one that goes round in a circle keeps its speed ahead."""
        steps = [np.flatnonzero(column) for column in self.present.T]
        first, last = (np.array([self.times_s[rows[end]] if len(rows) else 0.0 for rows in steps]) for end in (0, -1))
        ends_s = first[vessel], np.maximum(last[vessel], first[vessel] + 1e-3)
        start, stop = (np.clip(times_s + side, *ends_s) for side in (-MEAN_S, MEAN_S))
        before, after = (self._interpolated(self._travelled_m, at_s, vessel) for at_s in (start, stop))
        return (after - before) / np.maximum(stop - start, 1e-3)[:, None]

    def camera_at(self, times_s: Array, turn_rad: Array, raised_m: float) -> CameraPoses:
        """Poses of the camera at n times, with roll, pitch and yaw (3,) added to its mount's, and so much higher."""
        mount = self.camera.mount
        roll, pitch, yaw = (np.array([mount.roll_rad, mount.pitch_rad, mount.yaw_rad]) + turn_rad).tolist()
        along, port, up = mount.position_m
        mount = replace(mount, position_m=(along, port, up + raised_m), roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)
        if self.carrier is None:
            return poses_ashore(mount, len(times_s))
        places = self._interpolated(self.places_m, times_s, np.full(len(times_s), self.carrier))
        return poses_on_board(mount, places[:, :3], places[:, 3], places[:, 4:], self.composition)

    def _between(self, times_s: Array) -> tuple[Indices, Array]:
        """The step before each time, and the share of the way to the next."""
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.times_s) - 2)
        share = (times_s - self.times_s[before]) / (self.times_s[before + 1] - self.times_s[before])
        return before, np.clip(share, 0.0, 1.0)

    @cached_property
    def _travelled_m(self) -> Array:
        """Distances come since the first of the times, along and across the vessels' headings, (S, V, 2)."""
        moved, heading = np.diff(self.places_m[..., :2], axis=0), self.places_m[..., 3]
        midway = (heading[1:] + heading[:-1]) / 2
        cosine, sine = np.cos(midway), np.sin(midway)
        along, across = moved[..., 0] * cosine + moved[..., 1] * sine, moved[..., 1] * cosine - moved[..., 0] * sine
        return np.pad(np.cumsum(np.stack([along, across], axis=-1), axis=0), ((1, 0), (0, 0), (0, 0)))

    def _interpolated(self, of_steps: Array, times_s: Array, vessel: Indices) -> Array:
        """Values of vessels at the steps, shape (S, V, k), at times (n,), shape (n, k)."""
        before, share = self._between(times_s)
        start, end = of_steps[before, vessel], of_steps[before + 1, vessel]
        return start + share[:, None] * (end - start)


def _continued(times_s: Array, present: Mask, places_m: Array) -> Array:
    """Places with absent vessels' filled in, linearly or, at the ends, at their speed; headings unwrap; (S, V, 7)."""
    filled = places_m.copy()
    for vessel in np.flatnonzero(present.any(axis=0)).tolist():
        steps = np.flatnonzero(present[:, vessel])
        path_s, path = times_s[steps], places_m[steps, vessel]
        path[:, 3] = filled[steps, vessel, 3] = np.unwrap(path[:, 3])
        columns = [np.interp(times_s, path_s, column) for column in path.T]
        absent = np.flatnonzero(~present[:, vessel])
        filled[absent, vessel] = np.stack(columns, axis=-1)[absent]
        if len(steps) > 1:
            for edge, inner, beyond in ((0, 1, absent < steps[0]), (-1, -2, absent > steps[-1])):
                speed = (path[edge, :2] - path[inner, :2]) / (path_s[edge] - path_s[inner])
                rows = absent[beyond]
                filled[rows, vessel, :2] += (times_s[rows] - path_s[edge])[:, None] * speed
    return filled


AXIS = np.array([0, 1, 0, 1])  # whether the left, top, right and bottom edges are columns (0) or rows (1)


@dataclass(frozen=True, eq=False)
class BoxModel:
    """The boxes of V vessels before a camera."""

    traffic: KnownTraffic
    hulls_m: Array  # vertices of each vessel's convex hull in VCF, the last one repeated, (V, K, 3)

    @classmethod
    def of(cls, scene: Scene, traffic: KnownTraffic) -> BoxModel:
        """That of a scene's vessels, with their dimensions and the shapes that its source of truth gives them."""
        meshes = scene.annotation.source != "rectangles"
        solids = [vessel.solid if meshes else shoebox() for vessel in scene.vessels]
        hulls = [hull_of(solid) * vessel.extents_m for solid, vessel in zip(solids, scene.vessels, strict=True)]
        return cls(traffic, stacked(hulls))

    def intrinsics(self, values: Values) -> Intrinsics:
        """The camera's intrinsics with other focal length and k1."""
        lens = self.traffic.camera.intrinsics
        (f1, f2), larger = lens.focal_px, 1 + values["focal_share"]
        bent, k1 = lens.distortion or Distortion(), values["k1"]
        distortion = replace(bent, k1=bent.k1 + k1) if k1 else lens.distortion
        return replace(lens, focal_px=(f1 * larger, f2 * larger), distortion=distortion)

    def camera_poses(self, values: Values, times_s: Array) -> CameraPoses:
        """Poses of the camera at times of the detector's clock, shape (n,)."""
        turn = np.radians([values["roll_deg"], values["pitch_deg"], values["yaw_deg"]])
        return self.traffic.camera_at(times_s + values["clock_s"], turn, values["height_m"])

    def points_world(self, values: Values, times_s: Array, vessel: Indices, points_m: Array) -> Array:
        """Points of n vessels in VCF, (n, K, 3), at the detector's times, in WCF. AIS reports the antenna: its offset
        is taken off; and where a vessel was, if late, so that it is there that much later."""
        along, across, delay = values.vessels[vessel].T
        positions, rotations = self.traffic.at(times_s + values["clock_s"] + delay, vessel)
        antenna = np.stack([along, across, np.zeros(len(along))], axis=-1)
        return np.asarray((points_m - antenna[:, None]) @ np.swapaxes(rotations, -1, -2) + positions[:, None])

    def pixels(self, values: Values, times_s: Array, vessel: Indices, points_m: Array) -> Array:
        """Points of vessels in the image, NaN behind the camera, shape (n, K, 2)."""
        if not len(vessel):
            return np.empty((*points_m.shape[:2], 2))
        world = self.points_world(values, times_s, vessel, points_m)
        poses = self.camera_poses(values, times_s)
        if self.traffic.curved:
            world = lowered(world, poses.positions_m[:, None])
        return self.intrinsics(values).project(poses.to_camera(world))

    def boxes(self, values: Values, times_s: Array, vessel: Indices) -> tuple[Array, Array]:
        """Uncut boxes, (n, 4), and each edge's vertex in VCF, (n, 4, 3); nan for absent vessels or ones behind."""
        hulls = self.hulls_m[vessel]
        pixels = self.pixels(values, times_s, vessel, hulls)
        shown = self.traffic.presence(times_s + values["clock_s"] + values.vessels[vessel, 2], vessel)
        shown &= np.isfinite(pixels).all(axis=(1, 2))
        if self.traffic.carrier is not None:
            carrier = np.full(len(vessel), self.traffic.carrier)
            shown &= (vessel != carrier) & self.traffic.presence(times_s + values["clock_s"], carrier)
        safe = np.where(shown[:, None, None], pixels, 0.0)
        ends = np.concatenate([safe.argmin(axis=1), safe.argmax(axis=1)], axis=1)
        corners = np.take_along_axis(hulls, ends[..., None], axis=1)
        boxes = np.concatenate([safe.min(axis=1), safe.max(axis=1)], axis=1)
        boxes[~shown] = np.nan
        return boxes, corners

    def edges(self, values: Values, times_s: Array, vessel: Indices, corners_m: Array) -> Array:
        """Left, top, right and bottom edge from the vertices that make them, shape (n, 4, 3) to (n, 4)."""
        pixels = self.pixels(values, times_s, vessel, corners_m)
        return np.take_along_axis(pixels, AXIS[None, :, None], axis=2)[..., 0]


# ---- Which edges of a vessel's box something else hides ----

NEARLY = 0.999  # a ray is hidden before this share of its way: the end is on the vessel itself


@dataclass(frozen=True, eq=False)
class HidingBodies:
    """Bodies that can hide vessels from a camera; each vessel hides others with the box around it."""

    model: BoxModel
    obstacles: tuple[Array, ...]  # planes of convex solids, n · p + d <= 0 inside, each (F, 4)
    extents_m: Array  # length, beam and air draft of the vessels, (V, 3)

    @classmethod
    def of(cls, scene: Scene, model: BoxModel) -> HidingBodies:
        """The vessels and obstacles of a scene; own ship's hull is left out."""
        solids = [planes_of(vertices) for obstacle in scene.obstacles for _, vertices in obstacle.solids]
        extents = np.array([vessel.extents_m for vessel in scene.vessels])
        return cls(model, tuple(planes for planes in solids if planes is not None), extents)

    def hidden(self, values: Values, times_s: Array, vessel: Indices, corners_m: Array, group: Indices) -> Mask:
        """Mask (n, 4) of hidden ones of the vertices in VCF that make edges of boxes, (n, 4, 3), of vessels at times
        (n,). `group` is the frame of each row, ascending: only vessels of the same one hide each other."""
        ends = self.model.points_world(values, times_s, vessel, corners_m)
        starts = self.model.camera_poses(values, times_s).positions_m[:, None]
        hidden = np.zeros(ends.shape[:2], dtype=bool)
        for planes in self.obstacles:
            hidden |= crosses(starts, ends, planes)
        row, other = same_frame(group, group)
        row, other = row[row != other], other[row != other]
        delay = values.vessels[vessel[other], 2]
        places, rotations = self.model.traffic.at(times_s[other] + values["clock_s"] + delay, vessel[other])
        begin, stop = ((points - places[:, None]) @ rotations for points in (starts[row], ends[row]))
        np.logical_or.at(hidden, row, crosses_box(begin, stop, self.extents_m[vessel[other]]))
        return hidden


def planes_of(vertices_m: Array) -> Array | None:
    """The planes around the convex hull of vertices (K, 3), shape (F, 4); None if they lie in one plane."""
    try:
        planes: Array = np.unique(ConvexHull(vertices_m).equations.round(9), axis=0)
    except QhullError:
        return None
    return planes


def crosses(starts_m: Array, ends_m: Array, planes: Array) -> Mask:
    """Whether ways from starts to ends cross a convex solid, (..., 3) to (...), found by a cut at each plane."""
    at_start = starts_m @ planes[:, :3].T + planes[:, 3]
    at_end = ends_m @ planes[:, :3].T + planes[:, 3]
    return _stays(np.broadcast_to(at_start, at_end.shape), at_end)


def crosses_box(starts_m: Array, ends_m: Array, extents_m: Array) -> Mask:
    """Whether ways of shapes (n, ..., 3) cross boxes in their own VCF, with extents of shape (n, 3)."""
    half = extents_m / 2 * (1, 1, 0) + extents_m * (0, 0, 1)
    upper, lower = half[:, None], (-half * (1, 1, 0))[:, None]
    at_start = np.concatenate([starts_m - upper, lower - starts_m], axis=-1)
    at_end = np.concatenate([ends_m - upper, lower - ends_m], axis=-1)
    return _stays(np.broadcast_to(at_start, at_end.shape), at_end)


def _stays(at_start: Array, at_end: Array) -> Mask:
    """Whether some part of a way is on the inner side of all planes; values at its ends, shape (..., F)."""
    change = at_end - at_start
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = -at_start / change
    enters = np.where(change < 0, cut, np.where((change == 0) & (at_start > 0), np.inf, 0.0)).max(axis=-1)
    return np.asarray(np.maximum(enters, 0.0) < np.minimum(np.where(change > 0, cut, 1.0).min(axis=-1), NEARLY))


def same_frame(first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """All pairs of rows of two columns of frames that are in the same frame; the second ascends."""
    start, stop = (np.searchsorted(second, first, side=side) for side in ("left", "right"))
    count = stop - start
    row = np.repeat(np.arange(len(first)), count)
    return row, np.repeat(start - (np.cumsum(count) - count), count) + np.arange(len(row))
