"""Detections by a camera and a clock that differ from what the scene says by known amounts."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.detector.records import Detections
from modsim3d.learn.voyage.registration.icp import BoxesAtTimes
from modsim3d.runs.pipeline import Simulation, scene_statistics, truth_block
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import Truth
from modsim3d.world.poses.replay import RecordedPoses

WRONG = {"clock_s": 3.7, "pitch_deg": 0.4, "yaw_deg": 2.0, "height_m": 1.0, "focal_share": 0.02}
"""By how much, at most, the camera and the clock of the detector differ from what the user's scene says."""
ANGLES = ("roll", "pitch", "yaw")
COLUMNS = ("time_s", "camera", "label", "score", "left", "top", "right", "bottom")


def drawn_wrong(seed: int) -> dict[str, float]:
    """Amounts drawn from minus to plus those of `WRONG`."""
    rng = np.random.default_rng([seed, 3])
    return {name: float(most * rng.uniform(-1, 1)) for name, most in WRONG.items()}


def drawn_traffic(scene: Scene, seed: int) -> Scene:
    """The scene with the way of each vessel but own ship moved along its mean course, by up to a quarter of the way.

    Who is beside, before and behind whom differs by seed; speeds, turns and depths stay those of the scene.
    """
    true = scene.poses.poses(0, scene.steps)
    moved, rng = true.positions_m.copy(), np.random.default_rng([seed, 4])
    for vessel, there in enumerate(true.present.T):
        share = rng.uniform(-1, 1) / 4
        if vessel not in scene.own_ships and there.any():
            first, last = true.positions_m[there, vessel][[0, -1]]
            moved[:, vessel] += share * (last - first)
    return replace(scene, poses=RecordedPoses(scene.poses.timestamps, replace(true, positions_m=moved)))


def really(scene: Scene, camera: str, changes: Mapping[str, float]) -> Scene:
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


@dataclass(frozen=True, eq=False)
class Voyage:
    """What the camera really saw; the detector is run over it with any seed."""

    scene: Scene
    truth: Truth
    clock_s: float

    @classmethod
    def of(cls, scene: Scene, camera: str, changes: Mapping[str, float]) -> Voyage:
        real = really(scene, camera, changes)
        return cls(real, truth_block(real, 0, real.steps, None), changes.get("clock_s", 0.0))

    def detections(self, seed: int) -> BoxesAtTimes:
        """What the detector wrote; its clock is late, so that `clock_s` is to be added."""
        times_s, found = self._detected(seed)
        return BoxesAtTimes(times_s, found.frame, found.boxes_px)

    def write_log(self, seed: int, path: Path) -> None:
        """The same as a table."""
        times_s, found = self._detected(seed)
        labels = [self.scene.detector.labels[label] for label in found.label.tolist()]
        write_table(path, times_s, self.scene.cameras[0].name, found.frame, labels, found.confidence, found.boxes_px)

    def _detected(self, seed: int) -> tuple[Array, Detections]:
        """Times of the frames by the detector's clock, and its detections."""
        scene = replace(self.scene, detector_seed=seed)
        block = self.truth, 0, scene.steps
        (part,) = Simulation(scene, scene_statistics(scene, [block])).detect(*block).cameras
        return scene.times_s(0, scene.steps)[part.steps] - self.clock_s, part.detections


def write_table(
    path: Path, times_s: Array, camera: str, frame: Indices, labels: Sequence[str], scores: Array, boxes_px: Array
) -> None:
    """A log of detections (n,) in frames (F,); a frame without detections is a row without a box."""
    columns = frame.tolist(), labels, scores.tolist(), boxes_px.tolist()
    rows: list[tuple[object, ...]] = [(at, label, score, *box) for at, label, score, box in zip(*columns, strict=True)]
    rows += [(at, *[""] * (len(COLUMNS) - 2)) for at in np.setdiff1d(np.arange(len(times_s)), frame).tolist()]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for at, *rest in sorted(rows, key=lambda row: row[0]):
            table.writerow([f"{times_s[at]:.6f}", camera, *rest])
