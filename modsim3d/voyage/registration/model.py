"""Where the edges of a vessel's box are in the image, for any values of the parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import lowered
from modsim3d.geometry.lens import Distortion
from modsim3d.scene.scene import Scene
from modsim3d.vessels.vessel import shoebox
from modsim3d.voyage.hulls import hull_of, stacked
from modsim3d.voyage.registration.parameters import Values
from modsim3d.voyage.registration.traffic import Traffic

AXIS = np.array([0, 1, 0, 1])
"""Whether the left, top, right and bottom edges are columns (0) or rows (1)."""


@dataclass(frozen=True, eq=False)
class BoxModel:
    """The boxes of V vessels before a camera.

    Attributes:
        traffic: Where they are.
        hulls_m: Vertices of each vessel's convex hull in VCF, the last one repeated, shape (V, K, 3).
    """

    traffic: Traffic
    hulls_m: Array

    @classmethod
    def of(cls, scene: Scene, traffic: Traffic) -> BoxModel:
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
        """Points of n vessels in VCF, shape (n, K, 3), at times of the detector's clock, in WCF, shape (n, K, 3).

        What AIS reports is the antenna: its offset is taken off. A delayed report says where a vessel was, so that
        the vessel is where it reports to be that much later.
        """
        along, across, delay = values.vessels[vessel].T
        positions, rotations = self.traffic.at(times_s + values["clock_s"] + delay, vessel)
        antenna = np.stack([along, across, np.zeros(len(along))], axis=-1)
        world: Array = (points_m - antenna[:, None]) @ np.swapaxes(rotations, -1, -2) + positions[:, None]
        return world

    def pixels(self, values: Values, times_s: Array, vessel: Indices, points_m: Array) -> Array:
        """The same points in the image, NaN behind the camera, shape (n, K, 2)."""
        if not len(vessel):
            return np.empty((*points_m.shape[:2], 2))
        world = self.points_world(values, times_s, vessel, points_m)
        poses = self.camera_poses(values, times_s)
        if self.traffic.curved:
            world = lowered(world, poses.positions_m[:, None])
        return self.intrinsics(values).project(poses.to_camera(world))

    def boxes(self, values: Values, times_s: Array, vessel: Indices) -> tuple[Array, Array]:
        """Boxes that are not cut at the image, shape (n, 4), and the vertex in VCF at each edge, (n, 4, 3).

        Boxes of vessels that are absent, or partly behind the camera, are NaN.
        """
        hulls = self.hulls_m[vessel]
        pixels = self.pixels(values, times_s, vessel, hulls)
        shown = self.traffic.there(times_s + values["clock_s"] + values.vessels[vessel, 2], vessel)
        shown &= np.isfinite(pixels).all(axis=(1, 2))
        if self.traffic.carrier is not None:
            carrier = np.full(len(vessel), self.traffic.carrier)
            shown &= (vessel != carrier) & self.traffic.there(times_s + values["clock_s"], carrier)
        safe = np.where(shown[:, None, None], pixels, 0.0)
        ends = np.concatenate([safe.argmin(axis=1), safe.argmax(axis=1)], axis=1)
        corners = np.take_along_axis(hulls, ends[..., None], axis=1)
        boxes = np.concatenate([safe.min(axis=1), safe.max(axis=1)], axis=1)
        boxes[~shown] = np.nan
        return boxes, corners

    def edges(self, values: Values, times_s: Array, vessel: Indices, corners_m: Array) -> Array:
        """Left, top, right and bottom edge from the vertices that make them, shape (n, 4, 3) to (n, 4)."""
        pixels = self.pixels(values, times_s, vessel, corners_m)
        edges: Array = np.take_along_axis(pixels, AXIS[None, :, None], axis=2)[..., 0]
        return edges
