"""A scene: what was configured, and what follows from it at each step."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.lazy_names import public
from modsim3d.core.text import column_table, counted, listed
from modsim3d.detector.model import DetectorModel
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses, poses_ashore
from modsim3d.io.plugins import Plugin
from modsim3d.scene.copy import SceneCopy
from modsim3d.scene.keys import USUAL_AIS, Ais, LookKeys, usual_look
from modsim3d.scene.parts import title_of
from modsim3d.scene.sight import Sight, Snapshot, line_of_sight
from modsim3d.truth.record import Annotation
from modsim3d.world.bodies import PREFIX, Obstacle
from modsim3d.world.poses.base import PoseSource, times_s
from modsim3d.world.poses.labelled import EVERYWHERE, LabelledPoses
from modsim3d.world.poses.replay import LivePoses
from modsim3d.world.vessel_motion import PERFECT_IMU, Imu, PosesInWaves, VesselMotion, Waves
from modsim3d.world.vessels import Vessel


def scene_lines(scene: Scene) -> str:
    """Three lines: what is in it; its steps, seed and truth; its detector."""
    cameras = listed([camera.name for camera in scene.cameras])
    return "\n".join(
        [
            f"<Scene {scene.name}: {_vessels(scene)}, {counted(len(scene.cameras), 'camera')} ({cameras})",
            f"  {_steps(scene)}, seed {scene.seed}, truth {scene.annotation.source}, mode {scene.annotation.mode}",
            f"  detector: {scene.detector.in_words()}>",
        ]
    )


def scene_table(scene: Scene) -> str:
    """HTML table of a scene, with sizes of images and all that is there besides."""
    detector_seed = scene.detector_seed
    cameras = [
        f"{camera.name} ({camera.intrinsics.image_size_px[0]} × {camera.intrinsics.image_size_px[1]} px, "
        f"{'on ' + camera.mount.vessel if camera.mount.vessel else 'ashore'})"
        for camera in scene.cameras
    ]
    obstacles = listed([obstacle.name for obstacle in scene.obstacles])
    moved = "every vessel" if scene.waves and scene.waves.apply_to == "all" else "vessels with a camera"
    rows = {
        "vessels": _vessels(scene),
        "cameras": listed(cameras),
        "obstacles": f"{len(scene.obstacles)} ({obstacles})" if scene.obstacles else "none",
        "waves": f"move {moved}" if scene.waves else "none",
        "traffic": scene.traffic,
        "steps": _steps(scene),
        "seed": str(scene.seed) + (f", of the detector {detector_seed}" if detector_seed != scene.seed else ""),
        "truth": f"{scene.annotation.source}, mode {scene.annotation.mode}",
        "detector": scene.detector.in_words(),
    }
    return column_table(f"Scene {scene.name}", (), rows.items())


def _vessels(scene: Scene) -> str:
    return f"{counted(len(scene.vessels), 'vessel')} ({listed(scene.vessel_names)})"


def _steps(scene: Scene) -> str:
    if scene.live:
        return "steps as they arrive"
    return f"{counted(scene.steps, 'step')} in {scene.times_s(scene.steps - 1, scene.steps)[0]:g} s"


_EARLY = 1e-6  # of an interval: 0.3 / 0.1 is a hair below 3, and the frame at 0.3 s is due


def takes_frame(times_s: Array, rate_hz: float | None, offset_s: float) -> Mask:
    """Whether a camera takes a frame at each of consecutive steps, shape (n,): one has become due since the last step;
    those due by the first step are taken there. Frame k is due at offset + k / rate. A step has one frame at most: if
    several become due between two steps, the later ones are lost. `rate_hz` is None for one at every step from the
    offset on. `times_s` are times since the scene's first step, shape (n,)."""
    if rate_hz is None:
        return times_s >= offset_s - _EARLY
    due = np.maximum(np.floor((times_s - offset_s) * rate_hz + _EARLY).astype(np.int64) + 1, 0)
    taken: Mask = np.diff(due, prepend=0) > 0
    return taken


_SAME_DECIMALS = 4  # of metres and radians of the same traffic: the last bits of exact ones depend on the processor


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """A validated scene, from `load_scene`: what to simulate, and where everything is at each step.

        scene = modsim3d.load_scene("strait")
        scene.vessel_names, scene.steps, scene.at(0).to_trimesh()

    Attributes:
        name: File name without its ending.
        path: The scene file.
        sha256: Checksum of `copy`.
        seed: Seed of all random numbers but the detector's.
        detector_seed: Seed of the detector; the same unless the scene file says otherwise.
        traffic_has_seed: Whether the traffic, that is who is where, is drawn from the seed.
        truth_has_seed: Whether what the cameras see depends on the seed: through the traffic or the waves.
        steps: Number of time steps; of a live scene the most that are taken.
        vessels: Vessels in the order of the vessels file, then those that the pose source draws.
        poses: Source of the vessels' poses.
        cameras: Cameras in the order of the scene file.
        annotation: Annotation mode, and where the truth comes from.
        detector: Parameters of the statistical detector.
        copy: The files that the scene was read from.
        waves: The waves; None for calm water.
        sea: `flat` or `curved`.
        obstacles: Obstacles in the order of the scene file.
        imu: Inertial unit on board each vessel that carries a camera.
        origin: Latitude and longitude in degrees of w1 = w2 = 0, if the scene lies on the Earth.
        ais: AIS equipment of the vessels.
        looks: Weather in which performance states are drawn, by name, where it is not as their names tell.
        plugins: Plug-ins that the scene uses.
        drawn_vessels: Number of vessels that the pose source has drawn, the last ones.
    """

    name: str
    path: Path
    sha256: str
    seed: int
    detector_seed: int
    traffic_has_seed: bool
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
    origin: tuple[float, float] | None = None
    ais: Ais = USUAL_AIS
    looks: Mapping[str, LookKeys] = field(default_factory=dict)
    plugins: tuple[Plugin, ...] = ()
    drawn_vessels: int = 0

    def __repr__(self) -> str:
        """Three lines: vessels and cameras; steps, seed and truth; the detector."""
        return scene_lines(self)

    def _repr_html_(self) -> str:
        return scene_table(self)

    @classmethod
    def from_dict(
        cls,
        data: Mapping[str, Any],
        *,
        name: str = "scene",
        seed: int | None = None,
        steps: int | None = None,
        mode: int | None = None,
        source: str | None = None,
        supersample: int | None = None,
        render: str | None = None,
        detector: str | os.PathLike[str] | Mapping[str, Any] | DetectorModel | None = None,
        detector_seed: int | None = None,
    ) -> Scene:
        """A scene without files: the keys of a scene file, with values in place of the files that it names.

            scene = modsim3d.Scene.from_dict({
                "vessels": {"own": {"length_m": 10, "beam_m": 4, "air_draft_m": 3, "label": "Vessel"}},
                "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 0.5},
                "cameras": {"shore": {..., "pose": {"position_m": [0, -80, 5], "yaw_rad": 1.57}}},
                "detector": modsim3d.load_detector("my/detector.yaml"),
            })

        Args:
            data: The mapping; it is copied. `vessels` and `detector` are mappings or files; the detector may also be
                one that was read. `poses` may have arrays: `positions_m` of shape (T, N, 2) or (T, N, 3) and
                `headings_rad` (T, N), NaN where a vessel is absent; `time_step_s` or `times_s` (T,); and the `names`
                of the N columns, if they are not the vessels in their order. Paths are relative to the working
                directory. NumPy's numbers and arrays may stand for numbers and lists.
            name: Name of the scene, and of its file in a run. Each of the following replaces what stands in the
                mapping; see `load_scene`.
            seed: Seed of all random numbers but the detector's.
            steps: Number of time steps.
            mode: Annotation mode.
            source: Annotation source.
            supersample: Buffer pixels for each pixel of the image and axis.
            render: What the rendered source draws.
            detector: The detector.
            detector_seed: Seed of the detector.

        Raises:
            InputError: With every problem found, each with its path in the mapping.
        """
        numbers: dict[str, Any] = {"seed": seed, "steps": steps, "mode": mode, "supersample": supersample}
        given = {**numbers, "source": source, "render": render, "detector": detector, "detector_seed": detector_seed}
        scene: Scene = public("scene_from_dict")(data, name=name, **given)
        return scene

    @cached_property
    def vessel_names(self) -> tuple[str, ...]:
        """IDs of the vessels, in order."""
        return tuple(vessel.name for vessel in self.vessels)

    @property
    def traffic_seed(self) -> int | None:
        """The seed that its traffic is drawn from; None if every seed has the same traffic."""
        return self.seed if self.traffic_has_seed else None

    @property
    def traffic(self) -> str:
        """Origin of the traffic in words: `drawn from seed 7`, or `this traffic only`."""
        return "this traffic only" if self.traffic_seed is None else f"drawn from seed {self.traffic_seed}"

    def traffic_sha256(self) -> str | None:
        """Checksum of the vessels and their poses at all steps, to 0.0001 m and rad; None if no vessel was drawn."""
        if not self.drawn_vessels:
            return None
        poses = self.poses.poses(0, self.steps)
        sizes = (np.round(vessel.extents_m, _SAME_DECIMALS).tolist() for vessel in self.vessels)
        entries = [(vessel.name, vessel.label, *size) for vessel, size in zip(self.vessels, sizes, strict=True)]
        digest = hashlib.sha256(repr(entries).encode())
        digest.update(poses.present.tobytes())
        for values in (poses.positions_m, poses.headings_rad):
            digest.update((np.round(values, _SAME_DECIMALS) + 0.0).tobytes())
        return digest.hexdigest()

    @property
    def occluder_names(self) -> tuple[str, ...]:
        """Names of all that can hide a vessel: the vessels, then the obstacles."""
        return self.vessel_names + tuple(PREFIX + obstacle.name for obstacle in self.obstacles)

    @property
    def title(self) -> str:
        """Name of the scene in errors."""
        return title_of(self.path)

    @property
    def live(self) -> bool:
        """Whether its steps arrive while it runs."""
        return isinstance(self.poses, LivePoses)

    @cached_property
    def labels(self) -> LabelledPoses | None:
        """The labels of videos that its truth is; None if vessels are where their poses are."""
        return self.poses if isinstance(self.poses, LabelledPoses) else None

    def look_of(self, state: str) -> LookKeys | None:
        """The weather in which a performance state is drawn; None if neither the scene nor its name says."""
        return self.looks.get(state) or usual_look(state)

    def check_world(self, what: str) -> None:
        """Raise ModsimError where something needs to know where things are, and the truth is labels of videos."""
        if self.labels is not None:
            raise ModsimError(f"scene '{self.name}': {what} needs places in the world, and labels of videos have none")

    def timestamps(self, first: int, stop: int) -> tuple[str, ...]:
        """Texts of the times of steps first to stop − 1."""
        return tuple(self.poses.timestamps[first:stop])

    def times_s(self, first: int, stop: int) -> Array:
        """Times of steps first to stop − 1 since the first step, in seconds, shape (stop − first,)."""
        return times_s(self.poses.timestamps, first, stop)

    @cached_property
    def own_ships(self) -> tuple[int, ...]:
        """Indices of the vessels that carry a camera, ascending."""
        carriers = {camera.mount.vessel for camera in self.cameras}
        return tuple(i for i, name in enumerate(self.vessel_names) if name in carriers)

    @cached_property
    def motion(self) -> VesselMotion:
        """The motion of its vessels."""
        moved = self.own_ships
        if self.waves is not None and self.waves.apply_to == "all":
            moved = tuple(range(len(self.vessels)))
        return VesselMotion(self.poses, self.vessel_names, self.waves, moved, self.steps)

    @cached_property
    def own_motion(self) -> VesselMotion:
        """Motion with waves only for the vessels that carry cameras: waves take time to compute."""
        return self.motion if self.motion.moved == self.own_ships else replace(self.motion, moved=self.own_ships)

    def sight(self, camera: Camera, steps: Indices, vessel_poses: PosesInWaves | None = None) -> Sight:
        """View of a camera at some ascending steps of shape (S,): what is in front of it, and from where it looks.

        Args:
            camera: A camera of the scene.
            steps: The steps.
            vessel_poses: The vessels at these steps, if they are known already.

        Raises:
            InputError: The vessel that carries the camera has no pose at a step.
        """
        if vessel_poses is None:
            vessel_poses = self.motion.at(steps)
        camera_poses = self.camera_poses(camera, vessel_poses, steps)
        curved = self.sea == "curved"
        return line_of_sight(camera, camera_poses, steps, self.vessels, vessel_poses, self.obstacles, curved)

    def at(self, step: int) -> Snapshot:
        """The scene at one step: where all vessels, obstacles and cameras are.

        Raises:
            InputError: The vessel that carries a camera has no pose at this step.
            ModsimError: The scene has no such step.
        """
        self.check_world("a view of a step")
        if not 0 <= step < self.steps:
            raise ModsimError(f"{self.title}: there is no step {step}; the scene has steps 0 to {self.steps - 1}")
        steps = np.array([step])
        vessel_poses = self.motion.at(steps)
        sights = tuple(self.sight(camera, steps, vessel_poses) for camera in self.cameras)
        return Snapshot(self.vessels, vessel_poses, self.obstacles, sights, self.annotation.supersample)

    def sea_half_planes(self, camera: Camera, steps: Indices) -> Array:
        """The sea's side of the horizon in a camera's images at ascending steps of shape (S,), shape (S, 3). See
        `Intrinsics.sea_half_plane`."""
        if not len(steps):
            return np.empty((0, 3))
        if self.labels is not None:
            return np.tile(self.labels.sequence(camera.name).sea or EVERYWHERE, (len(steps), 1))
        if camera.mount.vessel is None:  # then no vessel's poses are needed
            poses = poses_ashore(camera.mount, len(steps))
        else:
            poses = self.camera_poses(camera, self.own_motion.at(steps), steps)
        return camera.intrinsics.sea_half_plane(poses.camera_R_world)

    def camera_poses(self, camera: Camera, vessel_poses: PosesInWaves, steps: Indices) -> CameraPoses:
        """Poses of a camera at ascending steps of shape (S,), at which the vessels have the given poses.

        Raises:
            InputError: The vessel that carries the camera has no pose at a step.
        """
        carrier = camera.mount.vessel
        if carrier is None:
            return poses_ashore(camera.mount, len(steps))
        column = self.vessel_names.index(carrier)
        present = vessel_poses.poses.present[:, column]
        if not present.all():
            when = self.poses.timestamps[int(steps[present.argmin()])]
            problem = f"cameras.{camera.name}.mount.vessel: '{carrier}' has no pose at time {when} s"
            raise InputError(self.title, [problem])
        composition = self.waves.composition if self.waves else "rigid"
        return vessel_poses.of_camera(camera.mount, column, composition)

    def frame_steps(self, camera: Camera, first: int, stop: int) -> Indices:
        """The steps first to stop − 1 at which a camera takes a frame, ascending, shape (n,). The result does not
        depend on where a run is split into blocks."""
        if self.labels is not None:
            return self.labels.frame_steps(camera.name, first, stop)
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
