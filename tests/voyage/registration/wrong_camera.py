"""Detections by a camera and a clock that differ from what the scene says by known amounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

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


def as_reported(
    scene: Scene, seed: int, antenna_m: float, delay_s: float, noise_m: float, silent: Sequence[str] = ()
) -> tuple[Scene, dict[str, tuple[float, float, float]]]:
    """The scene that AIS gives: each vessel with an antenna off its centre, late reports and noise; some are silent.

    Own ships are known. The second part are antennas, along and across, and delays by vessel.
    """
    rng = np.random.default_rng(seed)
    steps = np.arange(scene.steps)
    true, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    positions, headings, present = true.positions_m.copy(), true.headings_rad.copy(), true.present.copy()
    wrong = {}
    for column, name in enumerate(scene.vessel_names):
        if column in scene.own_ships:
            continue
        if name in silent:
            present[:, column] = False
        along, across, delay = rng.normal(0, [antenna_m, antenna_m / 3, delay_s])
        wrong[name] = (along, across, delay)
        late = times_s - delay
        place = [np.interp(late, times_s, true.positions_m[:, column, axis]) for axis in range(2)]
        if delay_s:  # beyond the ends a vessel goes on as it went
            for end in (slice(0, 2), slice(-2, None)):
                slope = np.diff(true.positions_m[end, column, :2], axis=0)[0] / np.diff(times_s[end])[0]
                outside = late < times_s[0] if end.start == 0 else late > times_s[-1]
                anchor = 0 if end.start == 0 else -1
                for axis in range(2):
                    beyond = true.positions_m[anchor, column, axis] + slope[axis] * (late - times_s[anchor])
                    place[axis] = np.where(outside, beyond, place[axis])
        ahead, port = (np.array([np.cos(headings[:, column]), np.sin(headings[:, column])]), None)
        port = np.array([-ahead[1], ahead[0]])
        slow = np.interp(times_s, times_s[::25], rng.normal(0, noise_m, (2, len(times_s[::25])))[0])
        noise = np.stack([slow, np.roll(slow, 40)])
        positions[:, column, :2] = (np.array(place) + along * ahead + across * port + noise).T
    poses = RecordedPoses(scene.poses.timestamps, Poses(present, positions, headings))
    assert len(steps) == len(times_s)
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
