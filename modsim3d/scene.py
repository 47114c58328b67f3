"""A scene: what is where at each step, and what each camera has before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modsim3d.annotate.camera_inside import first_body_around
from modsim3d.annotate.modes import Annotation
from modsim3d.annotate.outlines import Outlines, outline
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.bodies import Bodies, vessel_bodies
from modsim3d.camera import Camera, CameraPoses, Intrinsics, poses_ashore, poses_on_board
from modsim3d.detector.model import DetectorModel
from modsim3d.earth import lowered
from modsim3d.errors import InputError
from modsim3d.frame_timing import takes_frame
from modsim3d.frames import vehicle_R_nominal, world_R_vehicle
from modsim3d.imu import PERFECT_IMU, Imu
from modsim3d.kinematics import velocities
from modsim3d.obstacles import PREFIX, Obstacle, obstacle_bodies
from modsim3d.plugins import Plugin
from modsim3d.poses import LivePoses, Poses, PoseSource
from modsim3d.scene_copy import SceneCopy
from modsim3d.vessels import Vessel
from modsim3d.waves import Passage, WaveMotion


@dataclass(frozen=True, eq=False)
class Waves:
    """How waves move the vessels of a scene.

    Attributes:
        motion: Gives heave and angles.
        apply_to: `ownship`: only vessels that carry a camera are moved; `all`: every vessel.
        composition: How a camera's own angles and its vessel's combine: `rigid` or `additive`.
    """

    motion: WaveMotion
    apply_to: str = "ownship"
    composition: str = "rigid"


@dataclass(frozen=True, eq=False)
class AtSea:
    """How V vessels lie in the water at S steps.

    Attributes:
        poses: Positions with heave, and nominal headings.
        angles_rad: Roll, pitch and yaw in waves, shape (S, V, 3); zero for vessels that no wave moves.
        world_R_vessel: Rotations VCF to WCF, waves included, shape (S, V, 3, 3).
    """

    poses: Poses
    angles_rad: Array
    world_R_vessel: Array


@dataclass(frozen=True, eq=False)
class Sight:
    """What a camera has before it at S steps, and from where.

    Attributes:
        steps: Shape (S,).
        poses: Of all V vessels, as the camera sees them: others lower where the sea is curved.
        world_R_vessel: Rotations VCF to WCF, waves included, shape (S, V, 3, 3).
        others: Vessels that are there and do not carry the camera, shape (S, V).
        carriers: The vessel that carries the camera, shape (S, V).
        camera_poses: Of the camera.
        obstacles: Of the scene.
        curved: Whether the sea is.
    """

    steps: Indices
    poses: Poses
    world_R_vessel: Array
    others: Mask
    carriers: Mask
    camera_poses: CameraPoses
    obstacles: tuple[Obstacle, ...] = ()
    curved: bool = False

    def outlines(self, intrinsics: Intrinsics, vessels: Sequence[Vessel], *, as_shoeboxes: bool = False) -> Outlines:
        """What is before the camera: the other vessels, the obstacles, and the hull that carries it if that has a mesh.

        Args:
            intrinsics: Of the camera.
            vessels: Of the scene.
            as_shoeboxes: Whether vessels with a mesh are to be taken for their shoeboxes.
        """
        bodies = self._bodies(vessels, self.others, as_shoeboxes=as_shoeboxes)
        if not as_shoeboxes:
            bodies += self._own_hull(vessels)
        bodies += self._obstacle_bodies(vessels)
        return outline(intrinsics, self.camera_poses, bodies)

    def _own_hull(self, vessels: Sequence[Vessel]) -> list[Bodies]:
        """The vessel that carries the camera, if it has a mesh: it hides others, and has no box."""
        with_mesh = np.array([vessel.has_mesh for vessel in vessels])
        return self._bodies(vessels, self.carriers & with_mesh, boxed=False)

    def _bodies(
        self, vessels: Sequence[Vessel], present: Mask, *, as_shoeboxes: bool = False, boxed: bool = True
    ) -> list[Bodies]:
        return vessel_bodies(
            vessels, present, self.poses.positions_m, self.world_R_vessel, as_shoeboxes=as_shoeboxes, boxed=boxed
        )

    def _obstacle_bodies(self, vessels: Sequence[Vessel]) -> list[Bodies]:
        cameras_m = self.camera_poses.positions_m if self.curved else None
        return obstacle_bodies(self.obstacles, len(vessels), len(self.steps), cameras_m)

    def body_around(self, vessels: Sequence[Vessel]) -> tuple[int, int] | None:
        """The first step (as an index) and occluder that the camera is inside of, or None."""
        bodies = self._bodies(vessels, self.others) + self._own_hull(vessels)
        bodies += self._obstacle_bodies(vessels)
        return first_body_around(self.camera_poses.positions_m, bodies)


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
        steps: Number of time steps; of a live scene the most that are taken.
        vessels: In the order of the vessels file.
        poses: Where they are.
        cameras: In the order of the scene file.
        annotation: Mode, source and filters.
        detector: The statistical detector's parameters.
        copy: What it was read from.
        waves: How vessels move in waves, if they do.
        sea: `flat`, or `curved` as the Earth is.
        obstacles: What stands still and hides vessels.
        imu: The inertial unit on board of each vessel that carries a camera.
        plugins: What other packages brought to it.
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
    sea: str = "flat"
    obstacles: tuple[Obstacle, ...] = ()
    imu: Imu = PERFECT_IMU
    plugins: tuple[Plugin, ...] = ()

    @property
    def vessel_names(self) -> tuple[str, ...]:
        """IDs of the vessels."""
        return tuple(vessel.name for vessel in self.vessels)

    @property
    def occluder_names(self) -> tuple[str, ...]:
        """Names of what can hide a vessel: the vessels, then the obstacles."""
        return self.vessel_names + tuple(PREFIX + obstacle.name for obstacle in self.obstacles)

    @property
    def live(self) -> bool:
        """Whether its steps come in while it runs."""
        return isinstance(self.poses, LivePoses)

    def timestamps(self, first: int, stop: int) -> tuple[str, ...]:
        """The text of the times of steps first to stop − 1."""
        return tuple(self.poses.timestamps[first:stop])

    def times_s(self, first: int, stop: int) -> Array:
        """Times since the first step, shape (stop − first,)."""
        start = float(self.poses.timestamps[0])
        return np.array([float(text) for text in self.timestamps(first, stop)]) - start

    def frame_steps(self, camera: Camera, first: int, stop: int) -> Indices:
        """The steps first to stop − 1 at which a camera takes a frame, ascending; where a run is split changes nothing.

        Args:
            camera: One of the scene's.
            first: First step.
            stop: The step after the last.
        """
        if camera.frame_rate_hz is None and not camera.start_offset_s:
            return np.arange(first, stop)
        begin = max(first - 1, 0)
        taken = takes_frame(self.times_s(begin, stop), camera.frame_rate_hz, camera.start_offset_s)
        return first + np.flatnonzero(taken[first - begin :])

    def last_frame(self, camera: Camera, stop: int) -> int | None:
        """The last step before `stop` at which a camera takes a frame; None if there is none."""
        looked_at = 16
        while stop > 0:
            first = max(stop - looked_at, 0)
            if len(steps := self.frame_steps(camera, first, stop)):
                return int(steps[-1])
            stop, looked_at = first, 4 * looked_at
        return None

    def sight(self, camera: Camera, steps: Indices) -> Sight:
        """What a camera has before it at some steps, and from where.

        Args:
            camera: One of the scene's.
            steps: Ascending, shape (S,).

        Raises:
            InputError: The vessel that carries the camera is not there at a step.
        """
        sea = self.at_sea(steps)
        camera_poses, poses = self._camera_poses(camera, sea, steps), sea.poses
        carrier = np.array(self.vessel_names) == camera.mount.vessel
        if self.sea == "curved":
            lower = lowered(poses.positions_m, camera_poses.positions_m[:, None])
            poses = replace(poses, positions_m=np.where(carrier[:, None], poses.positions_m, lower))
        return Sight(
            steps,
            poses,
            sea.world_R_vessel,
            others=poses.present & ~carrier,
            carriers=poses.present & carrier,
            camera_poses=camera_poses,
            obstacles=self.obstacles,
            curved=self.sea == "curved",
        )

    def at_sea(self, steps: Indices) -> AtSea:
        """How the vessels lie in the water, each moved as everybody sees it.

        Args:
            steps: Ascending, shape (S,).
        """
        if self.waves is None:
            poses = self._poses_at(steps)
            return AtSea(poses, np.zeros((*poses.present.shape, 3)), world_R_vehicle(poses.headings_rad))
        poses, angles = self._in_waves(self.waves.motion, steps)
        rotations = world_R_vehicle(poses.headings_rad)
        moved = self._moved
        in_waves = np.swapaxes(vehicle_R_nominal(angles[:, moved]), -1, -2)
        rotations[:, moved] = rotations[:, moved] @ in_waves
        return AtSea(poses, angles, rotations)

    @property
    def own_ships(self) -> tuple[int, ...]:
        """Indices of the vessels that carry a camera, ascending."""
        carriers = {camera.mount.vessel for camera in self.cameras}
        return tuple(i for i, name in enumerate(self.vessel_names) if name in carriers)

    @property
    def _moved(self) -> list[int]:
        """Indices of the vessels that waves move."""
        everybody = self.waves is not None and self.waves.apply_to == "all"
        return list(range(len(self.vessels)) if everybody else self.own_ships)

    def with_neighbours(self, steps: Indices, margin: int = 1) -> tuple[int, int]:
        """First step and the step after the last of a range that holds the steps and those beside them.

        A velocity needs the neighbouring steps, wherever a block ends; beyond its own ends the scene has none.
        """
        first, stop = int(steps[0]), int(steps[-1]) + 1
        known = len(self.poses.timestamps) if self.live else self.steps
        return max(first - margin, 0), max(min(stop + margin, known), stop)

    def sea_half_planes(self, camera: Camera, steps: Indices) -> Array:
        """The side of the horizon on which the sea lies in a camera's images at some steps, shape (S, 3)."""
        if not len(steps):
            return np.empty((0, 3))
        return camera.intrinsics.sea_half_plane(self.sight(camera, steps).camera_poses.camera_R_world)

    def _poses_at(self, steps: Indices) -> Poses:
        first, stop = int(steps[0]), int(steps[-1]) + 1
        return _chosen(self.poses.poses(first, stop), steps - first)

    def _in_waves(self, motion: WaveMotion, steps: Indices) -> tuple[Poses, Array]:
        """Poses with heave, and roll, pitch and yaw, shape (S, V, 3)."""
        first, stop = self.with_neighbours(steps, 1 if motion.needs_velocity else 0)
        around, times_s, chosen = self.poses.poses(first, stop), self.times_s(first, stop), steps - first
        velocity = velocities(times_s, around.positions_m, around.present)[chosen]
        calm, times_s = _chosen(around, chosen), times_s[chosen]
        positions, angles = calm.positions_m.copy(), np.zeros(calm.positions_m.shape)
        for column in self._moved:
            place, heading = calm.positions_m[:, column], calm.headings_rad[:, column]
            passage = Passage(times_s, steps, place, heading, velocity[:, column])
            moved, there = motion.motion(self.vessel_names[column], passage), calm.present[:, column]
            positions[there, column, 2] += moved.heave_m[there]
            angles[there, column] = moved.angles_rad[there]
        return Poses(calm.present, positions, calm.headings_rad), angles

    def _camera_poses(self, camera: Camera, sea: AtSea, steps: Indices) -> CameraPoses:
        mount, poses = camera.mount, sea.poses
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
        return poses_on_board(
            mount,
            poses.positions_m[:, column],
            poses.headings_rad[:, column],
            sea.angles_rad[:, column],
            composition,
        )


def _chosen(poses: Poses, rows: Indices) -> Poses:
    return Poses(poses.present[rows], poses.positions_m[rows], poses.headings_rad[rows])
