"""Pose sources by name: what a scene file says is what is built."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.world.poses.agents import AgentsKeys, drive_agents
from modsim3d.world.poses.registry import SOURCES
from tests.scenes import camera_keys, write_scene


def scene_of(folder, poses: dict[str, Any], **keys: Any):
    cameras = {"C0": camera_keys(pose={"position_m": [-20, 0, 10]})}
    keys = {"time_step_s": 0.1, "seed": 3, "cameras": cameras, **keys}
    return write_scene(folder, {name: ([8, 4, 1], []) for name in ("a", "b")}, 20, poses=poses, **keys)


def test_agents_of_a_scene_are_those_of_python(tmp_path):
    scene = load_scene(scene_of(tmp_path, {"agents": {"size_m": [80, 50], "speed_m_s": [1, 2]}}))
    driven = drive_agents(scene.vessels, 20, 0.1, AgentsKeys(size_m=(80, 50), speed_m_s=(1, 2)), 3)
    assert tuple(scene.poses.timestamps) == driven.timestamps
    np.testing.assert_array_equal(scene.poses.poses(0, 20).positions_m, driven.recorded.positions_m)
    np.testing.assert_array_equal(scene.poses.poses(0, 20).headings_rad, driven.recorded.headings_rad)


def test_what_is_wrong_with_agents_is_told_with_its_path(tmp_path):
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
    with pytest.raises(InputError, match=f"poses: {name} has no times of its own: give time_step_s beside it"):
        load_scene(scene_of(tmp_path, {name: good[name]}, time_step_s=None))


def test_vessels_appear_and_leave_in_a_pose_file_and_on_tracks(tmp_path):
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


def test_the_document_lists_every_source_and_its_keys():
    document = (Path(__file__).resolve().parents[2] / "docs" / "poses.md").read_text(encoding="utf-8")
    for name, keys in SOURCES.items():
        assert f"| `{name}: " in document
        section = document.partition(f"\n## `{name}`")[2].partition("\n## ")[0]
        assert section
        for key in keys.model_fields if name in ("circular", "agents", "stream") else ():
            assert f"| `{key}` | " in section, (name, key)
