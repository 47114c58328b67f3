"""From where a camera looks, with the true attitude of its vessel or the measured one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.random_streams import Streams
from modsim3d.scene.scene import Scene

_NO_TURN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """A camera at S ascending steps.

    Attributes:
        steps: Shape (S,).
        vessels: Poses of the vessels at these steps; the roll, pitch and yaw of the one that carries the camera are
            those that are known of it.
        attitude_std_rad: Standard deviations of known roll, pitch and heading, shape (3,).
    """

    scene: Scene
    camera: Camera
    steps: Indices
    vessels: PosesInWaves
    attitude_std_rad: Array

    @classmethod
    def of(cls, scene: Scene, camera: Camera, steps: Indices, *, measured: bool) -> Viewpoints:
        """With the attitude that the vessel's inertial unit measures, or with the true one.

        Raises:
            InputError: The vessel that carries the camera has no pose at a step.
        """
        vessels, carrier = scene.motion.at(steps), camera.mount.vessel
        if carrier is None or not measured:
            return cls(scene, camera, steps, vessels, np.zeros(3))
        first, count = int(steps[0]), int(steps[-1] - steps[0]) + 1
        errors = scene.imu.attitude_errors(Streams(scene.seed), carrier, first, count)
        known = _turned(vessels, scene.vessel_names.index(carrier), errors[steps - first])
        return cls(scene, camera, steps, known, scene.imu.attitude_std_rad)

    def poses(self, turn_rad: tuple[float, ...] = _NO_TURN) -> CameraPoses:
        """Poses of the camera, if the known roll, pitch and heading of its vessel are turned by so much."""
        vessels = self.vessels
        if self.camera.mount.vessel is not None and any(turn_rad):
            carrier = self.scene.vessel_names.index(self.camera.mount.vessel)
            vessels = _turned(vessels, carrier, np.array(turn_rad))
        return self.scene.camera_poses(self.camera, vessels, self.steps)


def _turned(vessels: PosesInWaves, carrier: int, by_rad: Array) -> PosesInWaves:
    """The same poses with other angles of one vessel; rotations of the hulls stay, as a camera's follow from angles."""
    angles = vessels.angles_rad.copy()
    angles[:, carrier] += by_rad
    return PosesInWaves(vessels.poses, angles, vessels.world_R_vessel)
