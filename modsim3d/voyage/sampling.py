"""Where the vessels of a scene are at any time: poses between its steps."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.rotations import vehicle_R_nominal, world_R_vehicle
from modsim3d.motion.poses import Poses
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.scene.scene import Scene
from modsim3d.voyage.attitude import Attitude

NEAR_S = 1e-6
"""A time nearer than this to a step is that of the step."""


class Sampler:
    """The poses of a scene at any time."""

    def __init__(self, scene: Scene, attitude: Attitude | None = None) -> None:
        """Take a scene, and perhaps the attitude of a vessel as it was measured, in place of the scene's waves."""
        self._scene, self._attitude = scene, attitude
        self._every_s = scene.times_s(0, scene.steps)

    def at(self, times_s: Array) -> PosesInWaves:
        """Poses of the V vessels at some times, waves included.

        Places, heave and angles are linear between two steps, headings turn along the shorter arc, and a vessel is
        there if it is there at both. At the time of a step they are those of the step, to the last bit.

        Args:
            times_s: Times since the first step, from 0 to that of the last, ascending, shape (n,).
        """
        scene, every = self._scene, self._every_s
        before = np.clip(np.searchsorted(every, times_s + NEAR_S, side="right") - 1, 0, scene.steps - 1)
        after = np.minimum(before + 1, scene.steps - 1)
        share = (times_s - every[before]) / np.where(after > before, every[after] - every[before], 1.0)
        share = np.where(times_s - every[before] <= NEAR_S, 0.0, np.clip(share, 0, 1))
        after = np.where(share > 0, after, before)
        steps, places = np.unique(np.concatenate([before, after]), return_inverse=True)
        known = scene.motion.at(steps)
        first, second = known.rows(places[: len(times_s)]), known.rows(places[len(times_s) :])
        u = share[:, None]
        turn = second.poses.headings_rad - first.poses.headings_rad
        poses = Poses(
            present=first.poses.present & second.poses.present,
            positions_m=_between(first.poses.positions_m, second.poses.positions_m, u[..., None]),
            headings_rad=first.poses.headings_rad + u * np.arctan2(np.sin(turn), np.cos(turn)),
        )
        angles = _between(first.angles_rad, second.angles_rad, u[..., None])
        return PosesInWaves(poses, *self._turned(poses, angles, times_s))

    def _turned(self, poses: Poses, angles_rad: Array, times_s: Array) -> tuple[Array, Array]:
        """Roll, pitch and yaw with what was measured, shape (n, V, 3), and the rotations that follow."""
        scene, attitude = self._scene, self._attitude
        moved = set() if scene.waves is None else set(scene.motion.moved)
        if attitude is not None:
            column = scene.vessel_names.index(attitude.vessel)
            angles_rad[:, column] = attitude.at(times_s, poses.headings_rad[:, column])
            moved.add(column)
        rotations = world_R_vehicle(poses.headings_rad)
        if columns := sorted(moved):
            turned = np.swapaxes(vehicle_R_nominal(angles_rad[:, columns]), -1, -2)
            rotations[:, columns] = rotations[:, columns] @ turned
        return angles_rad, rotations


def _between(first: Array, second: Array, share: Array) -> Array:
    between: Array = first + share * (second - first)
    return between
