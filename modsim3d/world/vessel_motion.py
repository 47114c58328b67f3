"""Motion of the vessels of a scene: the pose source says where they are, and waves lift and turn them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.random_streams import Purpose, Streams, grid_normals, normals
from modsim3d.geometry.camera_poses import CameraPoses, Mount, poses_on_board, vehicle_R_nominal, world_R_vehicle
from modsim3d.geometry.kinematics import velocities
from modsim3d.world.floating_vessels import FloatingVessels, Passage, Sea, WaveMotion
from modsim3d.world.poses.base import Poses, PoseSource, times_s
from modsim3d.world.poses.replay import LivePoses


@dataclass(frozen=True, eq=False)
class Waves:
    """Motion of the vessels of a scene in waves."""

    motion: WaveMotion  # gives heave and angles
    apply_to: str = "ownship"  # `ownship`: only vessels that carry a camera are moved; `all`: every vessel
    composition: str = "rigid"  # of a camera's own angles and its vessel's: `rigid` or `additive`

    @property
    def sea(self) -> Sea | None:
        """The waves of a spectrum; None if the water is flat, or only the vessels' angles are known."""
        motion = self.motion
        return motion.sea if isinstance(motion, FloatingVessels) and motion.sea.amplitudes_m.any() else None


@dataclass(frozen=True, eq=False)
class PosesInWaves:
    """Poses of V vessels at S steps, waves included."""

    poses: Poses  # positions with heave, and headings without waves
    angles_rad: Array  # roll, pitch and yaw in waves: (S, V, 3); zero for vessels that no wave moves
    world_R_vessel: Array  # rotations VCF to WCF, waves included: (S, V, 3, 3)
    _of_cameras: dict[tuple[Mount, int, str], CameraPoses] = field(init=False, repr=False, default_factory=dict)

    def rows(self, rows: Indices) -> PosesInWaves:
        """Poses at some of the S steps, by index, shape (n,)."""
        return PosesInWaves(self.poses.rows(rows), self.angles_rad[rows], self.world_R_vessel[rows])

    def of_camera(self, mount: Mount, carrier: int, composition: str) -> CameraPoses:
        """Poses of a camera on the vessel with the index `carrier`; for `composition` see `Waves`. Checks, truth and
        horizon ask for the same camera one after the other: they are kept."""
        key = mount, carrier, composition
        if key not in self._of_cameras:
            positions_m, headings_rad = self.poses.positions_m[:, carrier], self.poses.headings_rad[:, carrier]
            waves_rad = self.angles_rad[:, carrier]
            self._of_cameras[key] = poses_on_board(mount, positions_m, headings_rad, waves_rad, composition)
        return self._of_cameras[key]


@dataclass(frozen=True, eq=False)
class VesselMotion:
    """Motion of V vessels over the steps of a scene."""

    source: PoseSource  # poses on calm water
    names: tuple[str, ...]  # IDs of the vessels
    waves: Waves | None  # None for calm water
    moved: tuple[int, ...]  # indices of the vessels that waves move, ascending
    steps: int  # number of the scene's steps; of a live scene the most that are taken
    _latest: dict[bytes, PosesInWaves] = field(init=False, repr=False, default_factory=dict)

    def at(self, steps: Indices) -> PosesInWaves:
        """Poses at ascending steps (S,); arrays that cannot be written to. Truth, horizon, attitudes and checks ask for
        the same steps one after the other: the latest ones are kept."""
        key = steps.tobytes()
        placement = self._latest.get(key)
        if placement is None:
            placement = self._at(steps)
            for values in (*vars(placement.poses).values(), placement.angles_rad, placement.world_R_vessel):
                values.setflags(write=False)
            self._latest.clear()
            self._latest[key] = placement
        return placement

    def _at(self, steps: Indices) -> PosesInWaves:
        if self.waves is None:
            first, stop = int(steps[0]), int(steps[-1]) + 1
            poses = self.source.poses(first, stop).rows(steps - first)
            return PosesInWaves(poses, np.zeros((*poses.present.shape, 3)), world_R_vehicle(poses.headings_rad))
        poses, angles = self._in_waves(self.waves.motion, steps)
        rotations, moved = world_R_vehicle(poses.headings_rad), list(self.moved)
        rotations[:, moved] = rotations[:, moved] @ np.swapaxes(vehicle_R_nominal(angles[:, moved]), -1, -2)
        return PosesInWaves(poses, angles, rotations)

    def with_neighbours(self, steps: Indices, margin: int = 1) -> tuple[int, int]:
        """First step and stop of a range that holds ascending steps (S,) and `margin` neighbours on each side. A
        velocity needs the neighbouring steps, wherever a block ends. The range stays within the scene."""
        first, stop = int(steps[0]), int(steps[-1]) + 1
        count = len(self.source.timestamps) if isinstance(self.source, LivePoses) else self.steps
        return max(first - margin, 0), max(min(stop + margin, count), stop)

    def _in_waves(self, motion: WaveMotion, steps: Indices) -> tuple[Poses, Array]:
        """Poses with heave, and roll, pitch and yaw, shape (S, V, 3)."""
        first, stop = self.with_neighbours(steps, 1 if motion.needs_velocity else 0)
        around, times = self.source.poses(first, stop), times_s(self.source.timestamps, first, stop)
        rows = steps - first
        calm = around.rows(rows)
        velocity = np.zeros_like(calm.positions_m)
        if motion.needs_velocity:
            velocity = velocities(times, around.positions_m, around.present)[rows]
        positions, angles = calm.positions_m.copy(), np.zeros(calm.positions_m.shape)
        for column in self.moved:
            here = calm.present[:, column].nonzero()[0]
            place, heading = calm.positions_m[here, column], calm.headings_rad[here, column]
            passage = Passage(times[rows[here]], steps[here], place, heading, velocity[here, column])
            moved = motion.motion(self.names[column], passage)
            positions[here, column, 2] += moved.heave_m
            angles[here, column] = moved.angles_rad
        return Poses(calm.present, positions, calm.headings_rad), angles


@dataclass(frozen=True)
class Imu:
    """A strapdown unit with its axes along the vessel's, v1, v2, v3. Noises and biases are standard deviations: noise
    is independent at each sample, a bias is drawn once a run for each vessel. Rates are angular, accelerations are the
    components of the specific force, and attitude and heading are the measured ones (attitude: roll and pitch)."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in VCF
    rate_noise_rad_s: float = 0.0
    rate_bias_rad_s: float = 0.0
    acceleration_noise_m_s2: float = 0.0
    acceleration_bias_m_s2: float = 0.0
    attitude_noise_rad: float = 0.0
    attitude_bias_rad: float = 0.0
    heading_noise_rad: float = 0.0
    heading_bias_rad: float = 0.0

    @property
    def attitude_std_rad(self) -> Array:
        """Standard deviations of the errors of measured roll, pitch and heading over all runs, shape (3,)."""
        return np.hypot(self._attitude_noises_rad, self._attitude_biases_rad)

    @property
    def _attitude_noises_rad(self) -> Array:
        return np.array([self.attitude_noise_rad, self.attitude_noise_rad, self.heading_noise_rad])

    @property
    def _attitude_biases_rad(self) -> Array:
        return np.array([self.attitude_bias_rad, self.attitude_bias_rad, self.heading_bias_rad])

    def attitude_errors(self, streams: Streams, vessel: str, first: int, count: int) -> Array:
        """Errors of measured roll, pitch and heading of a vessel in rad, n = `count` steps from `first` on, (n, 3)."""
        noises, biases = self._attitude_noises_rad, self._attitude_biases_rad
        if not (noises.any() or biases.any()):
            return np.zeros((count, 3))
        sample = grid_normals(streams.uniforms(Purpose.ATTITUDE_NOISE, vessel, first=first, count=count))
        offset = grid_normals(streams.uniforms(Purpose.ATTITUDE_BIAS, vessel, first=0, count=1))
        return noises * sample + biases * offset

    def errors(self, streams: Streams, vessel: str, first: int, count: int) -> tuple[Array, Array]:
        """Errors of the angular rates in rad/s and of the specific force in m/s², each (n, 3), of the unit of a vessel
        at the n = `count` steps from `first` on."""
        sample = normals(streams.uniforms(Purpose.IMU_NOISE, vessel, first=first, count=count))
        offset = normals(streams.uniforms(Purpose.IMU_BIAS, vessel, first=0, count=1))
        rates = self.rate_noise_rad_s * sample[:, :3] + self.rate_bias_rad_s * offset[:, :3]
        forces = self.acceleration_noise_m_s2 * sample[:, 3:] + self.acceleration_bias_m_s2 * offset[:, 3:]
        return rates, forces


PERFECT_IMU = Imu()  # at the vessel's origin, without any error
