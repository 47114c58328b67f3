"""Detections by a camera and a clock that differ from what the scene says by known amounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.poses import Poses
from modsim3d.motion.poses.replay import RecordedPoses
from modsim3d.runs.pipeline import Simulation, scene_census, truth_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth
from modsim3d.voyage.registration import BoxesAtTimes

WRONG = {"clock_s": 3.7, "pitch_deg": 0.4, "yaw_deg": 2.0, "height_m": 1.0, "focal_share": 0.02}


def really(scene: Scene, camera: str, changes: dict[str, float]) -> Scene:
    """The scene with only this camera, as it really is."""
    (eye,) = (each for each in scene.cameras if each.name == camera)
    mount, lens = eye.mount, eye.intrinsics
    turns = {
        f"{name}_rad": getattr(mount, f"{name}_rad") + np.radians(changes.get(f"{name}_deg", 0)) for name in ANGLES
    }
    x, y, z = mount.position_m
    mount = replace(mount, position_m=(x, y, z + changes.get("height_m", 0)), **turns)
    f1, f2 = (focal * (1 + changes.get("focal_share", 0)) for focal in lens.focal_px)
    return replace(scene, cameras=(replace(eye, mount=mount, intrinsics=replace(lens, focal_px=(f1, f2))),))


ANGLES = ("roll", "pitch", "yaw")


REPORTS_S = 5.0


def as_reported(
    scene: Scene, seed: int, stds: tuple[float, float, float], noise_m: float = 0.0, silent: Sequence[str] = ()
) -> tuple[Scene, Array]:
    """The scene that AIS gives: antennas off the centre, late reports, noise, and vessels without a transponder.

    Own ships are known. `stds` are those of the antennas' places along and across and of the delays; the second part of
    the result is what was drawn for each vessel, shape (V, 3).
    """
    rng = np.random.default_rng(seed)
    true, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    wrong = rng.normal(0, stds, (len(scene.vessels), 3))
    wrong[list(scene.own_ships)] = 0
    along, across, delay = wrong.T[..., None]
    reports = np.arange(0, times_s[-1] + REPORTS_S, REPORTS_S)
    noise = rng.normal(0, noise_m, (len(scene.vessels), 2, len(reports)))
    noise[list(scene.own_ships)] = 0
    ahead = np.stack([np.cos(true.headings_rad), np.sin(true.headings_rad)], axis=-1)
    port = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    velocity = np.gradient(true.positions_m[..., :2], times_s, axis=0)
    moved = true.positions_m.copy()
    moved[..., :2] += along * ahead + across * port - delay * velocity
    for vessel, axis in np.ndindex(noise.shape[:2]):
        moved[:, vessel, axis] += np.interp(times_s, reports, noise[vessel, axis])
    present = true.present & ~np.isin(scene.vessel_names, silent)
    poses = RecordedPoses(scene.poses.timestamps, Poses(present, moved, true.headings_rad))
    return replace(scene, poses=poses), wrong


@dataclass(frozen=True, eq=False)
class Voyage:
    """What the camera really saw; the detector is run over it with any seed."""

    scene: Scene
    truth: Truth
    clock_s: float

    @classmethod
    def of(cls, scene: Scene, camera: str, changes: dict[str, float]) -> Voyage:
        real = really(scene, camera, changes)
        return cls(real, truth_block(real, 0, real.steps, None), changes.get("clock_s", 0.0))

    def detections(self, seed: int) -> BoxesAtTimes:
        """What the detector wrote; its clock is late, so that `clock_s` is to be added."""
        scene = replace(self.scene, detector_seed=seed)
        block = self.truth, 0, scene.steps
        (part,) = Simulation(scene, scene_census(scene, [block])).detect(*block).cameras
        times_s = scene.times_s(0, scene.steps)[part.steps]
        return BoxesAtTimes(times_s - self.clock_s, part.detections.frame, part.detections.boxes_px)
