"""A scene at one step, as a trimesh scene for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.vessels.obstacles import PREFIX, Obstacle
from modsim3d.vessels.vessel import Vessel

if TYPE_CHECKING:
    import trimesh

CV_TO_GL = np.diag([1.0, -1.0, -1.0])
"""From camera axes as in computer vision (c2 down, c3 forward) to those of OpenGL and glTF (y up, z backward)."""
BASE_FRAME = "#world"
CAMERA_PREFIX = "camera#"
"""A vessel's ID never has a '#', so no vessel has the name of a camera's frame or of the base frame."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A scene at one step: all its vessels, obstacles and cameras; the poses are those of the one step."""

    vessels: tuple[Vessel, ...]
    vessel_poses: PosesInWaves
    obstacles: tuple[Obstacle, ...]
    cameras: tuple[Camera, ...]
    camera_poses: tuple[CameraPoses, ...]

    def to_trimesh(self) -> trimesh.Scene:
        """The scene in the world's axes, in metres, w3 up; the sea is flat.

        Each vessel that is present is a geometry and a node under its ID, with its pose in waves. An obstacle is one
        under `obstacle:NAME`. A camera is a frame `camera#NAME` that looks along its −z, with y up, as in OpenGL and
        glTF. The first camera is also the trimesh scene's camera, which has no skew, distortion or principal point.
        """
        import trimesh  # takes 0.3 s

        scene = trimesh.Scene(base_frame=BASE_FRAME)
        poses = self.vessel_poses.poses
        for index in np.flatnonzero(poses.present[0]).tolist():
            vessel = self.vessels[index]
            pose = _transform(self.vessel_poses.world_R_vessel[0, index], poses.positions_m[0, index])
            scene.add_geometry(vessel.to_trimesh(), vessel.name, vessel.name, transform=pose)
        for obstacle in self.obstacles:
            name = PREFIX + obstacle.name
            scene.add_geometry(obstacle.to_trimesh(), name, name)
        for camera, place in zip(self.cameras, self.camera_poses, strict=True):
            pose = _transform(place.camera_R_world[0].T @ CV_TO_GL, place.positions_m[0])
            scene.graph.update(CAMERA_PREFIX + camera.name, matrix=pose)
        lens = self.cameras[0].intrinsics
        scene.camera = trimesh.scene.Camera(
            CAMERA_PREFIX + self.cameras[0].name, lens.image_size_px, lens.focal_px, z_near=lens.near_clip_m
        )
        return scene


def _transform(rotation: Array, position_m: Array) -> Array:
    """Homogeneous transform, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position_m
    return matrix
