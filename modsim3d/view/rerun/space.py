"""The world of a run in a recording: vessels, obstacles and cameras in space."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.view import palette
from modsim3d.view.maps.birds_eye import view_of
from modsim3d.view.rerun.log import Log, image_path

MOST_NAMES = 10
"""Names of more vessels would lie on each other; they are shown for the vessel under the pointer."""
MOST_FACES = 5000
"""A hull with more faces would make a large file; it is left out, and its box stays."""
NEAREST = 0.4
"""The share of the vessels that are seen at first."""
IMAGE_SHARE = 0.15
"""How wide the image before a camera is, as a share of the traffic's extent."""


@dataclass(frozen=True, eq=False)
class Eye:
    """From where the world is looked at first: both of shape (3,); `span_m` is the extent of the traffic before it."""

    position_m: Array
    target_m: Array
    span_m: float


def first_eye(log: Log) -> Eye:
    """Behind and above the first camera, so that the nearest of the vessels at the first step are seen."""
    scene = log.scene
    poses = scene.poses.poses(0, 1)
    at, looks = view_of(scene, scene.cameras[0], 0)
    there = poses.positions_m[0, poses.present[0], :2]
    distance = np.linalg.norm(there - at, axis=1)
    near = there[distance <= np.quantile(distance, NEAREST)] if len(there) else there
    points = np.vstack([at, near])
    middle, span = (points.min(axis=0) + points.max(axis=0)) / 2, max(float(np.ptp(points, axis=0).max()), 50.0)
    ahead = looks[len(looks) // 2] if looks[len(looks) // 2].any() else np.array([1.0, 0.0])
    behind = middle - 0.85 * span * ahead
    return Eye(np.append(behind, 0.55 * span), np.append(middle, 0.0), span)


@dataclass(eq=False)
class Space:
    """Puts what is in the world into a recording."""

    log: Log
    _present: dict[int, bool] = field(default_factory=dict)

    def fixed(self, span_m: float) -> None:
        """Log what never changes: axes, lenses and obstacles.

        Args:
            span_m: Extent of the traffic, of which the images before the cameras are a share.
        """
        log, sdk = self.log, self.log.sdk
        log.put(["world"], sdk.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for camera in log.scene.cameras:
            lens = camera.intrinsics
            pinhole = sdk.Pinhole(
                image_from_camera=lens.matrix,
                resolution=lens.image_size_px,
                camera_xyz=sdk.ViewCoordinates.RDF,  # c1 right, c2 down, c3 forward
                image_plane_distance=IMAGE_SHARE * span_m * lens.focal_px[0] / lens.image_size_px[0],
                color=palette.SOFT_INK,
            )
            log.put(image_path(camera.name), pinhole, static=True)
        for index, obstacle in enumerate(log.scene.obstacles):
            corners = np.concatenate([vertices[solid.faces] for solid, vertices in obstacle.solids])
            mesh = self._mesh(corners, palette.obstacle_colour(index))
            log.put(["world", "obstacles", obstacle.name], mesh, static=True)

    def show(self, steps: Indices) -> None:
        """Log where cameras and vessels are at some steps, shape (n,)."""
        scene = self.log.scene
        sea = scene.motion.at(steps)
        for camera in scene.cameras:
            poses = scene.sight(camera, steps).camera_poses
            world_R_camera = np.swapaxes(poses.camera_R_world, -1, -2)
            self._move(["world", "cameras", camera.name], steps, poses.positions_m, world_R_camera)
        for index in range(len(scene.vessels)):
            self._vessel(index, steps, sea)

    def _vessel(self, index: int, steps: Indices, sea: PosesInWaves) -> None:
        vessel, present = self.log.scene.vessels[index], sea.poses.present[:, index]
        path = ["world", "vessels", vessel.name]
        self._move(path, steps[present], sea.poses.positions_m[present, index], sea.world_R_vessel[present, index])
        before = np.append(self._present.get(index, False), present[:-1])
        for i in np.flatnonzero(before != present):
            self.log.at(int(steps[i]))
            if present[i]:
                self.log.put(path, *self._body(index))
            else:
                self.log.put(path, self.log.sdk.Clear(recursive=False))
        self._present[index] = bool(present[-1])

    def _body(self, index: int) -> list[Any]:
        """The box of a vessel with its name, and its hull."""
        vessel, colour = self.log.scene.vessels[index], palette.vessel_colour(index)
        length, beam, height = vessel.extents_m
        box = self.log.sdk.Boxes3D(
            half_sizes=[[length / 2, beam / 2, height / 2]],
            centers=[[0, 0, height / 2]],
            colors=[colour],
            labels=[vessel.name],
            show_labels=len(self.log.scene.vessels) <= MOST_NAMES,
        )
        if len(vessel.solid.faces) > MOST_FACES:
            return [box]
        return [box, self._mesh((vessel.solid.vertices * vessel.extents_m)[vessel.solid.faces], colour)]

    def _mesh(self, corners: Array, colour: palette.Colour) -> Any:
        """Faces with flat shading, shape (f, 3, 3)."""
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return self.log.sdk.Mesh3D(
            vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=colour
        )

    def _move(self, path: list[str], steps: Indices, positions_m: Any, rotations: Any) -> None:
        if len(steps):
            moves = self.log.sdk.Transform3D.columns(translation=positions_m, mat3x3=rotations)
            self.log.columns(path, steps, moves)
