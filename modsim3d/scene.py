"""A scene: what is where at each step, and what each camera has before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modsim3d.annotate.inside import check_cameras_outside
from modsim3d.annotate.modes import Annotation
from modsim3d.annotate.outlines import Outlines, outline
from modsim3d.camera import Camera, CameraPoses, Intrinsics, poses_ashore, poses_on_board
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError
from modsim3d.frames import Array, vehicle_R_nominal, world_R_vehicle
from modsim3d.poses import Poses, PoseSource
from modsim3d.scene_copy import SceneCopy
from modsim3d.vessels import Vessel
from modsim3d.waves import WaveMotion

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Waves:
    """How waves move the vessels of a scene.

    Attributes:
        motion: Gives angles.
        apply_to: `ownship`: only vessels that carry a camera are turned; `all`: every vessel.
        composition: How a camera's own angles and its vessel's combine: `rigid` or `additive`.
    """

    motion: WaveMotion
    apply_to: str = "ownship"
    composition: str = "rigid"


@dataclass(frozen=True, eq=False)
class Sight:
    """What a camera has before it at S steps, and from where.

    Attributes:
        steps: Shape (S,).
        poses: Of all V vessels.
        world_R_vessel: Rotations VCF to WCF, waves included, shape (S, V, 3, 3).
        others: Vessels that are there and do not carry the camera, shape (S, V).
        camera_poses: Of the camera.
    """

    steps: Indices
    poses: Poses
    world_R_vessel: Array
    others: NDArray[np.bool_]
    camera_poses: CameraPoses

    def outlines(self, intrinsics: Intrinsics, vessels: Sequence[Vessel]) -> Outlines:
        """The other vessels before the camera."""
        return outline(intrinsics, self.camera_poses, vessels, self.others, self.poses.positions_m, self.world_R_vessel)

    def vessel_around(self, vessels: Sequence[Vessel]) -> tuple[int, int] | None:
        """The first step (as an index) and vessel that the camera is inside of, or None."""
        return check_cameras_outside(
            self.camera_poses.positions_m, vessels, self.others, self.poses, self.world_R_vessel
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """A validated scene.

    Attributes:
        name: The file's name without its ending.
        path: The scene file.
        sha256: Of what is in `copy`.
        seed: Everything random comes from it.
        detector_seed: What is random in the detector comes from it; the same unless the scene file says otherwise.
        truth_has_seed: Whether what the cameras see depends on the seed.
        steps: Number of time steps.
        vessels: In the order of the vessels file.
        poses: Where they are.
        cameras: In the order of the scene file.
        annotation: Mode, source and filters.
        detector: The statistical detector's parameters.
        copy: What it was read from.
        waves: How vessels move in waves, if they do.
    """

    name: str
    path: Path
    sha256: str
    seed: int
    detector_seed: int
    truth_has_seed: bool
    steps: int
    vessels: tuple[Vessel, ...]
    poses: PoseSource
    cameras: tuple[Camera, ...]
    annotation: Annotation
    detector: DetectorModel
    copy: SceneCopy
    waves: Waves | None = None

    @property
    def vessel_names(self) -> tuple[str, ...]:
        """IDs of the vessels."""
        return tuple(vessel.name for vessel in self.vessels)

    @property
    def occluder_names(self) -> tuple[str, ...]:
        """Names of what can hide a vessel: the vessels."""
        return self.vessel_names

    def timestamps(self, first: int, stop: int) -> tuple[str, ...]:
        """The text of the times of steps first to stop − 1."""
        return tuple(self.poses.timestamps[first:stop])

    def times_s(self, first: int, stop: int) -> Array:
        """Times since the first step, shape (stop − first,)."""
        start = float(self.poses.timestamps[0])
        return np.array([float(text) for text in self.timestamps(first, stop)]) - start

    def sight(self, camera: Camera, steps: Indices) -> Sight:
        """What a camera has before it at some steps, and from where.

        Args:
            camera: One of the scene's.
            steps: Ascending, shape (S,).

        Raises:
            InputError: The vessel that carries the camera is not there at a step.
        """
        poses = self._poses_at(steps)
        rotations = self._world_R_vessel(poses, steps)
        others = poses.present & (np.array(self.vessel_names) != camera.mount.vessel)
        return Sight(steps, poses, rotations, others, self._camera_poses(camera, poses, steps))

    def _poses_at(self, steps: Indices) -> Poses:
        first, stop = int(steps[0]), int(steps[-1]) + 1
        poses = self.poses.poses(first, stop)
        chosen = steps - first
        return Poses(poses.present[chosen], poses.positions_m[chosen], poses.headings_rad[chosen])

    def _times_at(self, steps: Indices) -> Array:
        start = float(self.poses.timestamps[0])
        return np.array([float(self.poses.timestamps[step]) for step in steps.tolist()]) - start

    def wave_angles(self, vessel: str, steps: Indices) -> Array:
        """Roll, pitch and yaw of a vessel in waves, shape (S, 3)."""
        if self.waves is None:
            return np.zeros((len(steps), 3))
        return self.waves.motion.angles(vessel, self._times_at(steps), steps)

    def _world_R_vessel(self, poses: Poses, steps: Indices) -> Array:
        nominal = world_R_vehicle(poses.headings_rad)
        if self.waves is None or self.waves.apply_to == "ownship":
            return nominal  # own ship is in nobody's picture but its own
        angles = np.stack([self.wave_angles(name, steps) for name in self.vessel_names], axis=1)
        return nominal @ np.swapaxes(vehicle_R_nominal(angles), -1, -2)

    def _camera_poses(self, camera: Camera, poses: Poses, steps: Indices) -> CameraPoses:
        mount = camera.mount
        if mount.vessel is None:
            return poses_ashore(mount, len(steps))
        column = self.vessel_names.index(mount.vessel)
        absent = np.flatnonzero(~poses.present[:, column])
        if len(absent):
            when = self.poses.timestamps[int(steps[absent[0]])]
            raise InputError(
                f"scene {self.path}",
                [f"cameras.{camera.name}.mount.vessel: '{mount.vessel}' has no pose at time {when} s"],
            )
        composition = self.waves.composition if self.waves else "rigid"
        angles = self.wave_angles(mount.vessel, steps)
        return poses_on_board(mount, poses.positions_m[:, column], poses.headings_rad[:, column], angles, composition)
