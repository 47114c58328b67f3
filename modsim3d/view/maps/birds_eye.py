"""A scene from above: where vessels go, what obstacles cover, what cameras look at. w1 is to the right, w2 upwards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.unions import union_of
from modsim3d.motion.poses.circular import CircularMotion
from modsim3d.scene.scene import Scene
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Vessel

MOST_TRACK_POINTS = 1500
MARGIN = 0.06
"""Margin around everything that is shown, as a share of the map."""
LEAST_ASPECT, MOST_ASPECT = 0.65, 2.4
REACH, REACH_M = 1.5, 2000.0
"""A camera ashore is on the map unless it is farther from the traffic than this many of its extents, and metres."""
NEAR, NEAR_M = 0.06, 50.0
"""So far beyond the traffic obstacles are shown, as a share of its extent or, if that is more, in metres."""
VIEW_POINTS = 33


@dataclass(frozen=True, eq=False)
class BirdsEye:
    """What a map of a scene shows, in metres in the world: tracks over a number of steps, and some of the cameras."""

    scene: Scene
    steps: int
    cameras: tuple[int, ...]

    @cached_property
    def track_steps(self) -> Indices:
        """The steps at which tracks have a point, shape (n,)."""
        return np.unique(np.rint(np.linspace(0, self.steps - 1, min(self.steps, MOST_TRACK_POINTS))).astype(np.int64))

    @cached_property
    def track_times_s(self) -> Array:
        """The times of `track_steps`, shape (n,)."""
        times: Array = self.scene.times_s(0, self.steps)[self.track_steps]
        return times

    @cached_property
    def tracks_m(self) -> Array:
        """w1 and w2 of each vessel at `track_steps`, NaN where it is absent, shape (n, V, 2)."""
        poses = self.scene.poses.poses(0, self.steps)
        tracks: Array = np.where(poses.present[..., None], poses.positions_m[..., :2], np.nan)[self.track_steps]
        return tracks

    @cached_property
    def circles_m(self) -> tuple[Array, ...]:
        """The whole circle of each vessel in circular motion, even if the run ends earlier, shape (181, 2) each."""
        motion = self.scene.poses
        if not isinstance(motion, CircularMotion):
            return ()
        angles = np.linspace(0, 2 * np.pi, 181)
        unit = np.column_stack([np.cos(angles), np.sin(angles)])
        return tuple(np.array(motion.centre_m) + radius * unit for radius in motion.radii_m)

    @cached_property
    def land(self) -> tuple[Any, ...]:
        """The footprint of each obstacle, as shapely geometry."""
        return tuple(footprint(obstacle) for obstacle in self.scene.obstacles)

    @cached_property
    def ashore_m(self) -> tuple[Array, ...]:
        """w1 and w2 of each camera ashore, shape (2,) each."""
        mounts = [self.scene.cameras[index].mount for index in self.cameras]
        return tuple(np.array(mount.position_m[:2]) for mount in mounts if mount.vessel is None)

    @cached_property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Least and greatest w1, least and greatest w2: all tracks, and the cameras ashore and obstacles near them."""
        half = np.array([vessel.length_m for vessel in self.scene.vessels])[:, None] / 2
        points = [(self.tracks_m + half).reshape(-1, 2), (self.tracks_m - half).reshape(-1, 2), *self.circles_m]
        points = points if any(np.isfinite(some).any() for some in points) else [*self.ashore_m, *_corners(self.land)]
        low, high = _bounds(points)
        span = float((high - low).max())
        reach, near = max(REACH * span, REACH_M), max(NEAR * span, NEAR_M)
        cameras = [at for at in self.ashore_m if np.all((low - reach <= at) & (at <= high + reach))]
        shown = shapely.box(*(low - near), *(high + near))
        low, high = _bounds([np.array([low, high]), *cameras, *_corners(each & shown for each in self.land)])
        middle, size = (low + high) / 2, (high - low) * (1 + 2 * MARGIN)
        size = np.maximum(size, [size[1] * LEAST_ASPECT, size[0] / MOST_ASPECT])
        (x0, y0), (x1, y1) = (middle - size / 2).tolist(), (middle + size / 2).tolist()
        return x0, x1, y0, y1


def _corners(shapes: Iterable[Any]) -> list[Array]:
    """Two corners of the box around each shape that is not empty, shape (2, 2) each."""
    return [np.array(shape.bounds).reshape(2, 2) for shape in shapes if not shape.is_empty]


def _bounds(points: Sequence[Array]) -> tuple[Array, Array]:
    """Least and greatest w1 and w2 of points, shape (..., 2) each, without those that are NaN; shape (2,) each."""
    every = np.concatenate([some.reshape(-1, 2) for some in points])
    every = every[np.isfinite(every).all(axis=1)]
    return every.min(axis=0), every.max(axis=0)


def view_of(scene: Scene, camera: Camera, step: int) -> tuple[Array, Array]:
    """w1 and w2 of a camera in metres, shape (2,), and where its image looks: horizontal unit vectors, shape (n, 2).

    They are of the row of the principal point, about where the horizon is, from left to right; zero straight down.
    """
    poses = scene.sight(camera, np.array([step])).camera_poses
    width, height = camera.intrinsics.image_size_px
    row = float(np.clip(camera.intrinsics.principal_point_px[1], 0, height))
    pixels = np.column_stack([np.linspace(0, width, VIEW_POINTS), np.full(VIEW_POINTS, row)])
    rays = camera.intrinsics.unproject(pixels, np.ones(VIEW_POINTS)) @ poses.camera_R_world[0]
    flat: Array = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=1, keepdims=True), 1e-12)
    return poses.positions_m[0, :2], flat


def footprint(obstacle: Obstacle) -> Any:
    """The footprint of an obstacle, with what it stands over, as a shapely multipolygon in metres."""
    parts = []
    for solid, vertices in obstacle.solids:
        flat = vertices[:, :2]
        if solid.convex:
            parts.append(shapely.convex_hull(shapely.multipoints(flat)))
        else:
            faces = shapely.polygons(flat[solid.faces])
            parts.append(union_of(faces[shapely.area(faces) > 0]))
    pieces = [part for part in shapely.get_parts(union_of(parts)).tolist() if part.geom_type == "Polygon"]
    return shapely.multipolygons(pieces)


def hull_m(vessel: Vessel, world_R_vessel: Array) -> Array:
    """The outline of a vessel from above, in metres about its centre, shape (k, 2)."""
    turned = (vessel.solid.vertices * vessel.extents_m) @ world_R_vessel.T
    ring: Array = shapely.get_coordinates(shapely.convex_hull(shapely.multipoints(turned[:, :2])))
    return ring


def ring_step(about_m: float) -> float:
    """A distance rounded up to 1, 2, 5, 10, ... metres."""
    power = 10.0 ** np.floor(np.log10(about_m))
    return float(min(factor * power for factor in (1, 2, 5, 10) if factor * power >= about_m * (1 - 1e-9)))
