"""Vessels put where a registration says that they are, from where their reports put them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.poses import Poses
from modsim3d.motion.poses.replay import RecordedPoses
from modsim3d.scene.scene import Scene


def with_moved_vessels(scene: Scene, offsets: Array) -> Scene:
    """A scene whose vessels are off their reports by antennas and delays.

    A report that is late says where a vessel was; before its first and after its last pose a vessel is at that pose.

    Args:
        scene: The scene.
        offsets: Antenna towards the bow and to port of the centre in metres, and delay of reports in seconds, of each
            vessel, shape (V, 3).
    """
    if not offsets.any():
        return scene
    every_s, known = scene.times_s(0, scene.steps), scene.poses.poses(0, scene.steps)
    positions, headings = known.positions_m.copy(), known.headings_rad.copy()
    for vessel in np.flatnonzero(offsets.any(axis=1)).tolist():
        steps = np.flatnonzero(known.present[:, vessel])
        if not len(steps):
            continue
        along, across, delay = offsets[vessel].tolist()
        at_s = every_s[steps] + delay
        heading = np.interp(at_s, every_s[steps], np.unwrap(known.headings_rad[steps, vessel]))
        places = [np.interp(at_s, every_s[steps], axis) for axis in known.positions_m[steps, vessel].T]
        ahead, port = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        places[:2] = np.array(places[:2]) - along * ahead - across * port
        positions[steps, vessel], headings[steps, vessel] = np.stack(places, axis=-1), heading
    poses = RecordedPoses(scene.poses.timestamps, Poses(known.present, positions, headings))
    return replace(scene, poses=poses)
