"""Poses as JSON Lines, one step a line, in the form of the thesis's pose file (Jessen & Mohr (2023), Figure 7.3)."""

from __future__ import annotations

import orjson

from modsim3d.scene.scene import Scene


def pose_lines(scene: Scene, first: int, stop: int) -> bytes:
    """The poses of steps first to stop − 1; reading the lines gives exactly the same numbers."""
    poses = scene.poses.poses(first, stop)
    lines = []
    for row, timestamp in enumerate(scene.timestamps(first, stop)):
        entries = {
            name: {
                "center_position_m": poses.positions_m[row, column].tolist(),
                "heading_rad": float(poses.headings_rad[row, column]),
            }
            for column, name in enumerate(scene.vessel_names)
            if poses.present[row, column]
        }
        lines.append(orjson.dumps({timestamp: entries}) + b"\n")
    return b"".join(lines)
