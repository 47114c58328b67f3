"""Vessels along waypoints, all at once against one after another."""

import numpy as np
import pytest

from modsim3d.geometry.camera_poses import heading_of
from modsim3d.world.poses.base import WaypointTracks


def along(track, times_s):
    """Places and headings on one track, at times between its first and its last waypoint."""
    leg = np.clip(np.searchsorted(track[:, 0], times_s, side="right") - 1, 0, len(track) - 2)
    start, end = track[leg], track[leg + 1]
    share = (times_s - start[:, 0]) / (end[:, 0] - start[:, 0])
    return start[:, 1:] + share[:, None] * (end - start)[:, 1:], heading_of((end - start)[:, 1:])


@pytest.mark.parametrize(("first", "stop"), [(0, 300), (41, 42), (120, 127), (7, 7)])
def test_poses_of_all_vessels_at_once_are_those_of_each_track_bit_for_bit(first, stop):
    rng, tracks = np.random.default_rng(0), []
    for vessel in range(40):
        times_s = np.sort(rng.choice(300, rng.integers(2, 6), replace=False)) * 0.1  # some are those of steps
        track = np.column_stack([times_s, rng.normal(0, 500, (len(times_s), 2))])
        tracks.append(None if vessel % 9 == 4 else track)
    timestamps = [f"{step * 0.1:.3f}" for step in range(300)]
    poses = WaypointTracks(timestamps, tuple(tracks)).poses(first, stop)
    times_s = np.array([float(text) for text in timestamps[first:stop]])
    for column, track in enumerate(tracks):
        there = np.zeros(len(times_s), dtype=bool)
        places_m, headings_rad = np.zeros((len(times_s), 3)), np.zeros(len(times_s))
        if track is not None:
            there = (times_s >= track[0, 0]) & (times_s <= track[-1, 0])
            places_m[there, :2], headings_rad[there] = along(track, times_s[there])
        np.testing.assert_array_equal(poses.present[:, column], there)
        np.testing.assert_array_equal(poses.positions_m[:, column], places_m)
        np.testing.assert_array_equal(poses.headings_rad[:, column], headings_rad)
