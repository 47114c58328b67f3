"""Pose sources by name; timestamps, circles, replayed poses and vessels along waypoints."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.core.errors import InputError
from modsim3d.geometry.camera_poses import heading_of
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.world.poses.agents import AgentsKeys, drive_agents
from modsim3d.world.poses.base import LongTimes, WaypointTracks, generated_timestamps, waypoint_tracks
from modsim3d.world.poses.circular import circular_motion, swept_ring
from modsim3d.world.poses.registry import SOURCES
from modsim3d.world.poses.replay import parse_poses
from modsim3d.world.vessels import Vessel
from tests.scenes import camera_keys, write_scene

SHIPS = tuple(Vessel(f"vessel{i}", "Vessel", *size) for i, size in enumerate([(14, 4, 20)] * 2 + [(7, 3, 4)] * 3))


def motion(seed=0, ships=SHIPS, radius=(5.0, 500.0), steps=50):
    return circular_motion(ships, steps, 0.2, (1000.0, 1000.0), radius, (0.005, 0.03), seed)


def test_timestamps_are_exact_and_a_vessel_is_at_each_waypoint_at_its_time():
    assert generated_timestamps(6, 0.2) == ("0.0", "0.2", "0.4", "0.6", "0.8", "1.0")
    last = {(4, 0.1): "0.3", (3, 1.0): "2.0", (2, 1e-7): "0.0000001", (2, 1e22): "10000000000000000000000.0"}
    assert {case: generated_timestamps(*case)[-1] for case in last} == last
    here = {"center_position_m": [1, 2, 0], "heading_rad": 0.5}
    data = {"0": {"a": here}, "0.50": {"a": here, "b": {"center_position_m": [0, 0, 0.5], "heading_rad": -1}}}
    recorded = parse_poses(data, "poses", ["a", "b"])
    poses = recorded.poses(0, 2)
    assert (recorded.timestamps, poses.present.tolist()) == (("0", "0.50"), [[True, False], [True, True]])
    assert poses.positions_m[1].tolist() == [[1, 2, 0], [0, 0, 0.5]] and poses.headings_rad[1].tolist() == [0.5, -1]
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
    # Tracks stand in the order of the scene's vessels.
    both = {"b": [(0.0, 1.0, 1.0), (1.0, 2.0, 2.0)], "a": [(0.0, -1.0, 0.0), (1.0, -2.0, 0.0)]}
    places_m = waypoint_tracks(both, ["a", "b"], 1, 1.0).poses(0, 1).positions_m[0]
    np.testing.assert_array_equal(places_m, [[-1, 0, 0], [1, 1, 0]])


INDEX = st.integers(-5000, 5000)


@given(steps=st.integers(1, 5000), first=INDEX, stop=INDEX, stride=st.integers(-3, 3).filter(bool))
@settings(max_examples=25, deadline=None)
def test_times_of_a_long_scene_are_the_generated_ones(steps, first, stop, stride):
    plain, long = generated_timestamps(steps, 0.1), LongTimes(steps, 0.1)
    assert len(long) == steps
    assert long[first:stop:stride] == plain[first:stop:stride]
    assert (long[0], long[-1]) == (plain[0], plain[-1])
    with pytest.raises(IndexError):
        long[steps]


def test_circular_motion_follows_the_source_by_the_seed_on_rings_that_hold_their_hulls():
    """Jessen & Mohr (2023), eq. 7.5 and 7.7: on the circle, heading along it."""
    circle = motion()
    poses = circle.poses(10, 20)
    offset = poses.positions_m[..., :2] - 1000.0
    np.testing.assert_allclose(np.hypot(*np.moveaxis(offset, -1, 0)), np.tile(circle.radii_m, (10, 1)))
    tangent = np.stack([np.cos(poses.headings_rad), np.sin(poses.headings_rad)], axis=-1)
    np.testing.assert_allclose((tangent * offset).sum(axis=-1), 0, atol=1e-9)
    assert (np.sum(np.diff(poses.positions_m[..., :2], axis=0) * tangent[:-1], axis=-1) > 0).all()
    # A hull of 14 m on a circle of 5 m reaches much farther out.
    along, across = np.meshgrid(np.linspace(-7, 7, 57), np.linspace(-2, 2, 17))
    distance, (inner, outer) = np.hypot(5.0 + across, along), swept_ring(5.0, 14.0, 4.0)
    assert (inner, outer) == pytest.approx((distance.min(), distance.max())) and outer > 9.8
    np.testing.assert_array_equal(motion(3).radii_m, motion(3).radii_m)
    assert (motion(3).radii_m != motion(4).radii_m).all()
    with pytest.raises(InputError, match=r"no free ring for vessel 'vessel\d'.*between radii 5.0 and 8.0"):
        motion(radius=(5.0, 8.0))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_rings_swept_by_the_hulls_are_disjoint(seed):
    circle = motion(seed, radius=(5.0, 60.0))
    rings = sorted(swept_ring(r, s.length_m, s.beam_m) for r, s in zip(circle.radii_m, SHIPS, strict=True))
    assert all(outer < inner for (_, outer), (inner, _) in pairwise(rings))
    assert ((circle.radii_m >= 5) & (circle.radii_m <= 60)).all()
    assert ((circle.rates_rad_s >= 0.005) & (circle.rates_rad_s <= 0.03)).all()


CORNER = {"a": [(2.0, 0.0, 0.0), (6.0, 8.0, 0.0), (8.0, 8.0, -6.0)]}


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


def scene_of(folder, poses: dict[str, Any], **keys: Any):
    cameras = {"C0": camera_keys(pose={"position_m": [-20, 0, 10]})}
    keys = {"steps": 20, "time_step_s": 0.1, "seed": 3, "cameras": cameras, **keys}
    return write_scene(folder, {name: ([8, 4, 1], []) for name in ("a", "b")}, poses=poses, **keys)


def test_agents_of_a_scene_are_those_of_python_and_what_is_wrong_with_them_is_told_with_its_path(tmp_path):
    scene = load_scene(scene_of(tmp_path, {"agents": {"size_m": [80, 50], "speed_m_s": [1, 2]}}))
    driven = drive_agents(scene.vessels, 20, 0.1, AgentsKeys(size_m=(80, 50), speed_m_s=(1, 2)), 3)
    assert tuple(scene.poses.timestamps) == driven.timestamps
    np.testing.assert_array_equal(scene.poses.poses(0, 20).positions_m, driven.recorded.positions_m)
    np.testing.assert_array_equal(scene.poses.poses(0, 20).headings_rad, driven.recorded.headings_rad)
    with pytest.raises(InputError, match=r"poses\.agents: no free place for vessel 'a' \(8\.0 m × 4\.0 m\) in a basin"):
        load_scene(scene_of(tmp_path, {"agents": {"size_m": [5, 5]}}))
    with pytest.raises(InputError) as caught:  # keys of a source are looked at beside other mistakes
        load_scene(scene_of(tmp_path, {"agents": {"size_m": [80, 50], "sped": 1}}, sead=4))
    assert [problem.partition(":")[0] for problem in caught.value.problems] == ["sead", "poses.agents.sped"]


@pytest.mark.parametrize("name", sorted(name for name, keys in SOURCES.items() if keys.generated))
def test_sources_without_times_of_their_own_need_the_scenes(tmp_path, name):
    good = {
        "circular": {"radius_m": [20, 90], "rotation_rate_rad_s": [0.1, 0.2]},
        "tracks": {"a": [[0, 100, 0], [9, 100, 9]]},
        "agents": {"size_m": [80, 50]},
        "traffic": {"own": {"a": {"waypoints_m": [[0, 0], [900, 0]], "speed_m_s": 3}}},
    }
    assert load_scene(scene_of(tmp_path, {name: good[name]})).steps == 20
    for missing in (["time_step_s"], ["steps", "time_step_s"]):
        said = f"poses: {name} has no times of its own: give {' and '.join(missing)} beside it"
        with pytest.raises(InputError, match=said):
            load_scene(scene_of(tmp_path, {name: good[name]}, **dict.fromkeys(missing)))


def test_vessels_appear_and_leave_and_the_document_lists_every_source_and_its_keys(tmp_path):
    """A vessel that is away has no row of truth at that step, and is there again when it has a pose again."""
    here = {name: {"center_position_m": [100, w2, 0], "heading_rad": 0} for name, w2 in (("a", 0), ("b", 20))}
    steps = [["a"], ["a", "b"], [], ["b"], ["a", "b"]]
    poses = {f"{t}.0": {name: here[name] for name in names} for t, names in enumerate(steps)}
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    tracks = {"a": [[0.2, 100, 0], [0.4, 101, 0]], "b": [[0.4, 100, 20], [0.6, 101, 20]]}
    on_tracks = [[], [], ["a"], ["a"], ["a", "b"], ["b"], ["b"], []]
    for source, there in (({"file": "poses.json"}, steps), ({"tracks": tracks}, on_tracks)):
        scene = load_scene(scene_of(tmp_path, source, annotation={"source": "analytic"}), steps=len(there))
        assert [list(frame.truth.vessels) for frame in simulate_frames(scene)] == there
    document = (Path(__file__).resolve().parents[2] / "docs" / "poses.md").read_text(encoding="utf-8")
    for name, keys in SOURCES.items():
        assert f"| `{name}: " in document
        section = document.partition(f"\n## `{name}`")[2].partition("\n## ")[0]
        assert section
        for key in keys.model_fields if name in ("circular", "agents", "stream") else ():
            assert f"| `{key}` | " in section, (name, key)
