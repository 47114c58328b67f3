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


def test_vessel_is_at_each_waypoint_at_its_time():
    assert list(waypoint_tracks(CORNER, ["a"], 4, 0.1).timestamps) == ["0.0", "0.1", "0.2", "0.3"]  # exact decimals
    places_m = waypoint_tracks(CORNER, ["a"], 11, 1.0).poses(0, 11).positions_m[:, 0]
    np.testing.assert_array_equal(places_m[[2, 6, 8]], [[0, 0, 0], [8, 0, 0], [8, -6, 0]])


def test_speed_is_constant_between_two_waypoints():
    poses = waypoint_tracks(CORNER, ["a"], 17, 0.5).poses(0, 17)
    steps = np.linalg.norm(np.diff(poses.positions_m[4:17, 0], axis=0), axis=1)
    np.testing.assert_allclose(steps[:8], 1.0)  # 8 m in 4 s
    np.testing.assert_allclose(steps[8:], 1.5)  # 6 m in 2 s


def test_vessel_heads_along_its_leg_and_turns_at_the_waypoint():
    headings = waypoint_tracks(CORNER, ["a"], 11, 1.0).poses(0, 11).headings_rad[:, 0]
    np.testing.assert_allclose(headings[2:6], 0.0)
    np.testing.assert_allclose(headings[6:9], -np.pi / 2)  # at the last one it keeps its last leg's


@pytest.mark.parametrize(
    ("end", "heading"), [((1, 0), 0), ((1, 1), np.pi / 4), ((0, 1), np.pi / 2), ((-1, 0), np.pi), ((-1, -1), -2.356194)]
)
def test_heading_is_counter_clockwise_from_w1_in_every_quadrant(end, heading):
    poses = waypoint_tracks({"a": [(0.0, 5.0, 5.0), (1.0, 5.0 + end[0], 5.0 + end[1])]}, ["a"], 1, 1.0).poses(0, 1)
    assert poses.headings_rad[0, 0] == pytest.approx(heading, abs=1e-6)


def test_vessel_is_there_from_its_first_waypoint_to_its_last_and_at_no_other_time():
    poses = waypoint_tracks(CORNER, ["a", "trackless"], 11, 1.0).poses(0, 11)
    assert poses.present[:, 0].tolist() == [False] * 2 + [True] * 7 + [False] * 2
    assert not poses.present[:, 1].any()
    assert not poses.positions_m[~poses.present].any()
    assert not poses.headings_rad[~poses.present].any()


def test_tracks_stand_in_the_order_of_the_scenes_vessels():
    both = {"b": [(0.0, 1.0, 1.0), (1.0, 2.0, 2.0)], "a": [(0.0, -1.0, 0.0), (1.0, -2.0, 0.0)]}
    poses = waypoint_tracks(both, ["a", "b"], 1, 1.0).poses(0, 1)
    np.testing.assert_array_equal(poses.positions_m[0], [[-1, 0, 0], [1, 1, 0]])


def load_with(folder, tracks):
    path = write_scene(folder, {"a": ([5, 2, 2], [[0, 100, 0], [9, 100, 9]])}, 5)
    data = json.loads(path.read_text())
    data["poses"]["tracks"] = tracks
    path.write_text(json.dumps(data))
    load_scene(path)


@pytest.mark.parametrize(
    ("tracks", "problem"),
    [
        ({"a": [[0, 100, 0]]}, "poses.tracks.a: at least two waypoints"),
        ({"a": [[0, 100, 0], [0, 101, 0]]}, "poses.tracks.a[1]: times must increase, but 0 s follows 0 s"),
        ({"a": [[0, 100, 0], [5, 101, 0], [4, 102, 0]]}, "poses.tracks.a[2]: times must increase, but 4 s follows 5 s"),
        ({"a": [[0, 100, 0], [5, 100, 0]]}, "poses.tracks.a[1]: same place as the waypoint before"),
        ({"b": [[0, 100, 0], [5, 101, 0]]}, "poses.tracks.b: no vessel 'b'"),
        ({"a": [[0, 100], [5, 101]]}, "poses.tracks.a"),
        ({"a": [[0, 100, "x"], [5, 101, 0]]}, "poses.tracks.a[0][2]"),
        ({"a": [[0, 100, float("nan")], [5, 101, 0]]}, "poses.tracks.a[0][2]"),
    ],
)
def test_what_is_wrong_with_a_track_is_told_with_its_path(tmp_path, tracks, problem):
    with pytest.raises(InputError) as caught:
        load_with(tmp_path, tracks)
    assert any(told.startswith(problem) for told in caught.value.problems), caught.value.problems
    with pytest.raises(InputError) as caught:
        load_with(tmp_path, {"a": [[3, 100, 0], [2, 100, 0]], "c": [[0, 0, 0]]})
    assert len(caught.value.problems) == 4  # all at once


def test_scene_of_tracks_loads_and_says_when_a_vessel_appears_and_leaves(tmp_path):
    path = write_scene(tmp_path, {"a": ([5, 2, 2], [[1, 100, 0], [3, 100, 9]]), "idle": ([5, 2, 2], [])}, 5)
    scene = load_scene(path)
    poses = scene.poses.poses(0, scene.steps)
    assert poses.present.tolist() == [[False, False], [True, False], [True, False], [True, False], [False, False]]


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
