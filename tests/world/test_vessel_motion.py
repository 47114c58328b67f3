"""Poses in waves at some steps."""

from __future__ import annotations

import numpy as np
import pytest

from modsim3d.scene.reading import load_scene


def test_the_latest_poses_are_kept_and_are_those_of_the_steps_asked_for():
    motion, other = (load_scene("simulation_2", steps=40).motion for _ in range(2))
    steps, later = np.array([3, 5]), np.array([5, 7])
    first = motion.at(steps)
    assert motion.at(steps.copy()) is first
    second = motion.at(later)
    np.testing.assert_array_equal(second.world_R_vessel, other.at(later).world_R_vessel)
    np.testing.assert_array_equal(second.poses.positions_m[0], first.poses.positions_m[1])
    with pytest.raises(ValueError, match="read-only"):
        second.poses.positions_m[0] = 0
