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


def poses_at(scene: Scene, times_s: Array, attitude: Attitude | None = None) -> PosesInWaves:
    """Poses of the V vessels at some times, waves included.

    Places, heave and angles are linear between two steps, headings turn along the shorter arc, and a vessel is there
    if it is there at both. At the time of a step they are those of the step, to the last bit.

    Args:
        scene: The scene.
        times_s: Times since its first step, from 0 to that of its last, ascending, shape (n,).
        attitude: That of a vessel as it was measured, in place of the scene's waves.
    """
    every = scene.times_s(0, scene.steps)
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
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    poses = Poses(
        present=first.poses.present & second.poses.present,
        positions_m=_between(first.poses.positions_m, second.poses.positions_m, u[..., None]),
        headings_rad=first.poses.headings_rad + u * turn,
    )
    angles = _between(first.angles_rad, second.angles_rad, u[..., None])
    rotations = world_R_vehicle(poses.headings_rad)
    moved = [] if scene.waves is None else list(scene.motion.moved)
    if attitude is not None:
        column = scene.vessel_names.index(attitude.vessel)
        angles[:, column] = attitude.at(times_s, poses.headings_rad[:, column])
        moved = sorted({*moved, column})
    if moved:
        rotations[:, moved] = rotations[:, moved] @ np.swapaxes(vehicle_R_nominal(angles[:, moved]), -1, -2)
    return PosesInWaves(poses, angles, rotations)


def _between(first: Array, second: Array, share: Array) -> Array:
    between: Array = first + share * (second - first)
    return between
