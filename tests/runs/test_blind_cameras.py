"""A camera that sees no vessel is warned of by name, with the way it looks and where the vessels are."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from modsim3d import Scene, run_scene
from modsim3d.cli.run_summary import run_warnings
from modsim3d.runs.camera_sequences import blind_at_first
from modsim3d.scene.reading import load_scene, shipped_scenes
from tests.cli.bad_input.builders import at, lens

SIZE = {"length_m": 12.0, "beam_m": 4.0, "air_draft_m": 3.0, "label": "Vessel"}
BOATS = {"one": (100.0, 5.0), "two": (150.0, -8.0)}
Keys, Boats = dict[str, Any], dict[str, tuple[float, float]]


def scene_of(folder: Path, mount: Keys, boats: Boats | None = None, **more: Any) -> Scene:
    """A vessel that carries a camera 4 m above the sea and looks along w1, and boats that lie still."""
    boats = BOATS if boats is None else boats
    tracks = {name: [[0, w1, w2], [6, w1, w2 + 1]] for name, (w1, w2) in boats.items()}
    content = {
        "steps": 12, "time_step_s": 0.5, "vessels": dict.fromkeys(("own", *boats), SIZE),
        "poses": {"tracks": {"own": [[0, 0, 0], [6, 6, 0]], **tracks}},
        "cameras": {"bow": lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 4.0], **mount})},
        "annotation": {"mode": 2, "source": "analytic"}, "detector": "thesis", **more,
    }  # fmt: skip
    (folder / "scene.yaml").write_text(yaml.dump({key: value for key, value in content.items() if value is not None}))
    return load_scene(folder / "scene.yaml")


BLIND: dict[str, tuple[Keys, Boats | None, str]] = {
    "the sign of the pitch": (
        {"pitch_rad": -0.6}, None, r"looks 34\.4° above the horizon, towards heading 0\.0° .* positive pitch_rad looks "
        "down.*vessels: 2 ahead of it but below the picture",
    ),
    "down": ({"pitch_rad": 0.9}, None, r"51\.6° below the horizon.* 2 ahead of it but above the picture"),
    "to port": ({"yaw_rad": 1.0}, None, r"along the horizon, towards heading 57\.3°.* 2 ahead of it but right of"),
    "to starboard": ({"yaw_rad": -1.0}, None, r"towards heading -57\.3°.* 2 ahead of it but left of the picture"),
    "astern": ({"yaw_rad": np.pi}, None, r"towards heading (-)?180\.0°.* 2 behind it"),
    "far away": ({}, {"far": (30_000.0, 0.0)}, "1 in the picture but smaller than a pixel"),
    "nobody there": ({}, {}, "there is no vessel but the one that carries it"),
}  # fmt: skip


@pytest.mark.parametrize("why", BLIND)
def test_a_blind_camera_is_warned_of_with_the_reason(tmp_path: Path, why: str) -> None:
    mount, boats, said = BLIND[why]
    scene = scene_of(tmp_path, mount, boats)
    (at_first,) = blind_at_first(scene)
    assert at_first.startswith("camera 'bow' sees no vessel in the 12 frames looked at: it looks ")
    assert re.search(said, at_first), at_first
    result = run_scene(scene, tmp_path / "run")
    if why == "far away":  # exact geometry sees it: less than a pixel of it
        assert result.counts.seen == 12
    else:
        assert run_warnings(scene, result)[0] == at_first.replace("the 12 frames looked at", "its 12 frames")


WALLS = {
    "analytic": {"polygon_m": [[50, -100], [52, -100], [52, 100], [50, 100]], "height_m": 80},
    "rendered": {"mesh": "ferry", "size_m": [200, 2, 80], "position_m": [50, 0, 0], "heading_rad": 1.5708},
}


@pytest.mark.parametrize("source", WALLS)
def test_a_camera_behind_a_wall_is_told_that_vessels_are_hidden(tmp_path: Path, source: str) -> None:
    scene = scene_of(tmp_path, {}, obstacles={"wall": WALLS[source]}, annotation={"mode": 2, "source": source})
    for (warning,) in (blind_at_first(scene), run_warnings(scene, run_scene(scene, tmp_path / "run"))):
        assert warning.endswith("vessels: 2 in the picture but hidden")


def test_of_a_run_in_which_nobody_is_seen_that_is_said_first(tmp_path: Path) -> None:
    away = lens(pose={"position_m": [-60.0, 0.0, 4.0], "yaw_rad": 3.0})
    up = lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 4.0], "pitch_rad": -0.6})
    scene = scene_of(tmp_path, {}, cameras={"bow": up, "shore": away})
    said = run_warnings(scene, run_scene(scene, tmp_path / "run"))
    blind = [f"camera '{name}' sees no vessel in its 12 frames" for name in ("bow", "shore")]
    assert [line.split(":")[0] for line in said] == ["no camera sees a vessel in this run", *blind]
    assert said[2].endswith("vessels: 3 behind it")


def test_a_vessel_that_comes_into_view_late_is_no_reason_to_warn(tmp_path: Path) -> None:
    late = [[0, -50, 5], [200, -51, 5], [290, 100, 5], [300, 101, 5]]
    poses = {"tracks": {"own": [[0, 0, 0], [300, 1, 0]], "late": late}}
    scene = scene_of(tmp_path, {}, {"late": (0.0, 0.0)}, poses=poses, steps=600)
    assert blind_at_first(scene) == []
    assert "sees no vessel" not in " ".join(run_warnings(scene, run_scene(scene, tmp_path / "run")))


def test_of_a_live_scene_it_is_said_after_the_run(tmp_path: Path) -> None:
    with (tmp_path / "live.jsonl").open("w") as file:
        for step in range(4):
            places = {name: at(*place) for name, place in {"own": (step, 0.0), **BOATS}.items()}
            file.write(json.dumps({f"{step}.0": places}) + "\n")
    poses = {"stream": {"file": "live.jsonl", "timeout_s": 0}}
    scene = scene_of(tmp_path, {"pitch_rad": -0.6}, poses=poses, steps=9, time_step_s=None)
    assert blind_at_first(scene) == []
    (warning,) = run_warnings(scene, run_scene(scene, tmp_path / "run"))
    assert warning.startswith("camera 'bow' sees no vessel in its 4 frames: it looks 34.4° above the horizon")
    assert warning.endswith("vessels: 2 ahead of it but below the picture")


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_camera_of_the_shipped_scenes_sees_vessels(name: str) -> None:
    assert blind_at_first(load_scene(name)) == []
