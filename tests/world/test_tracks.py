"""Vessels along waypoints."""

import json

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.geometry.camera_poses import heading_of
from modsim3d.scene.reading import load_scene
from modsim3d.world.poses.base import WaypointTracks, waypoint_tracks
from tests.scenes import write_scene

CORNER = {"a": [(2.0, 0.0, 0.0), (6.0, 8.0, 0.0), (8.0, 8.0, -6.0)]}


def test_vessel_is_at_each_waypoint_at_its_time_and_between_goes_ahead_at_constant_speed():
    assert list(waypoint_tracks(CORNER, ["a"], 4, 0.1).timestamps) == ["0.0", "0.1", "0.2", "0.3"]  # exact decimals
    poses = waypoint_tracks(CORNER, ["a", "trackless"], 11, 1.0).poses(0, 11)
    places_m, headings_rad = poses.positions_m[2:9, 0], poses.headings_rad[2:9, 0]
    np.testing.assert_array_equal(places_m[[0, 4, 6]], [[0, 0, 0], [8, 0, 0], [8, -6, 0]])
    # 8 m in 4 s, 6 m in 2 s; at the last one it keeps its last leg's heading.
    np.testing.assert_allclose(np.linalg.norm(np.diff(places_m, axis=0), axis=1), [2] * 4 + [3] * 2)
    np.testing.assert_allclose(headings_rad, [0.0] * 4 + [-np.pi / 2] * 3)
    # It is there from its first waypoint to its last and at no other time.
    assert poses.present.tolist() == [[2 <= step <= 8, False] for step in range(11)]
    assert not poses.positions_m[~poses.present].any() and not poses.headings_rad[~poses.present].any()


def test_tracks_stand_in_the_order_of_the_scenes_vessels():
    both = {"b": [(0.0, 1.0, 1.0), (1.0, 2.0, 2.0)], "a": [(0.0, -1.0, 0.0), (1.0, -2.0, 0.0)]}
    poses = waypoint_tracks(both, ["a", "b"], 1, 1.0).poses(0, 1)
    np.testing.assert_array_equal(poses.positions_m[0], [[-1, 0, 0], [1, 1, 0]])


WRONG = [
    ({"a": [[0, 100, 0]]}, "poses.tracks.a: at least two waypoints"),
    ({"a": [[0, 100, 0], [0, 101, 0]]}, "poses.tracks.a[1]: times must increase, but 0 s follows 0 s"),
    ({"a": [[0, 100, 0], [5, 101, 0], [4, 102, 0]]}, "poses.tracks.a[2]: times must increase, but 4 s follows 5 s"),
    ({"a": [[0, 100, 0], [5, 100, 0]]}, "poses.tracks.a[1]: same place as the waypoint before"),
    ({"b": [[0, 100, 0], [5, 101, 0]]}, "poses.tracks.b: no vessel 'b'"),
    ({"a": [[0, 100], [5, 101]]}, "poses.tracks.a"),
    ({"a": [[0, 100, "x"], [5, 101, 0]]}, "poses.tracks.a[0][2]"),
    ({"a": [[0, 100, float("nan")], [5, 101, 0]]}, "poses.tracks.a[0][2]"),
]


def test_what_is_wrong_with_tracks_is_told_at_once_with_its_path(tmp_path):
    path = write_scene(tmp_path, {"a": ([5, 2, 2], [[0, 100, 0], [9, 100, 9]])}, 5)
    for tracks, problem in (*WRONG, ({"a": [[3, 100, 0], [2, 100, 0]], "c": [[0, 0, 0]]}, "poses.tracks")):
        path.write_text(json.dumps({**json.loads(path.read_text()), "poses": {"tracks": tracks}}))
        with pytest.raises(InputError) as caught:
            load_scene(path)
        assert any(told.startswith(problem) for told in caught.value.problems), caught.value.problems
    assert len(caught.value.problems) == 4  # of the last, all at once


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
        for name, expected in (("present", there), ("positions_m", places_m), ("headings_rad", headings_rad)):
            np.testing.assert_array_equal(getattr(poses, name)[:, column], expected)
