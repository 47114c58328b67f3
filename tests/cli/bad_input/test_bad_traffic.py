"""Drawn traffic that cannot be: one error that names the key in the traffic section, and nothing is written."""

import json
from pathlib import Path
from typing import Any

import pytest

from modsim3d.cli.run_summary import run_warnings
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import ASHORE, GOOD, Refused, lens
from tests.command_line import call

LANE = {"waypoints_m": [[-400, 0], [400, 0]], "width_m": 120, "per_hour": 60, "kinds": ["motorboat"]}
OWN = {"own": {"waypoints_m": [[0, -300], [0, 300]], "speed_m_s": 4}}
SCENE: dict[str, Any] = {
    "steps": 3,
    "time_step_s": 1.0,
    "vessels": {"own": {"length_m": 10, "beam_m": 4, "air_draft_m": 3, "label": "Vessel"}},
    "poses": {"traffic": {"own": OWN, "lanes": {"west": LANE}, "labels": "Vessel"}},
    "cameras": {"shore": lens(pose=ASHORE)},
    "annotation": {"mode": 2, "source": "analytic"},
    "detector": "detector.yaml",
}
ISLAND = {"polygon_m": [[50, -20], [90, -20], [90, 20]], "height_m": 5}
CROWDED = {"polygon_m": [[0, 0], [1e5, 0], [0, 1e5]], "per_km2": 9e3, "kinds": ["kayak"]}
NAMES = ["own", *(f"west_{i}" for i in range(1, 60))]
ON_BOARD = lens(mount={"vessel": "west_1", "position_m": [2.0, 0.0, 2.0]})


def _traffic(**sections: Any) -> dict[str, Any]:
    return {"poses": {"traffic": sections}}


def written(folder: Path, **changes: Any) -> Path:
    scene = folder / "scene.json"
    scene.write_text(json.dumps(SCENE | changes), encoding="utf-8")
    (folder / "detector.yaml").write_text(json.dumps(GOOD["detector"]), encoding="utf-8")
    return scene


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "labels": (_traffic(lanes={"west": LANE}), "poses.traffic: draws vessels with the label 'boat' ("),
    "how to label": (_traffic(lanes={"west": LANE}), "set poses.traffic.labels"),
    "name": ({"vessels": dict.fromkeys(NAMES, SCENE["vessels"]["own"])}, "poses.traffic: draws a vessel 'west_"),
    "kind": (_traffic(lanes={"west": LANE | {"kinds": ["motorbaot"]}}), "did you mean 'motorboat'?"),
    "key": (_traffic(lane={}), "poses.traffic.lane: unknown key (did you mean 'lanes'?)"),
    "land": ({"obstacles": {"island": ISLAND}}, "poses.traffic.lanes.west.waypoints_m: leads over an obstacle"),
    "no own ship": ({"vessels": {}}, "poses.traffic.own.own: no vessel 'own'"),
    "no times": ({"steps": None}, "poses: traffic has no times of its own: give steps beside it"),
    "mount": ({"cameras": {"bow": ON_BOARD}}, "cameras.bow.mount.vessel: no vessel 'west_1'"),
    "too many": (_traffic(leisure={"sea": CROWDED}), "poses.traffic.leisure.sea.per_km2: means"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_traffic_is_one_error_that_names_its_key(tmp_path: Path, refused: Refused, case: str) -> None:
    changes, message = WRONG[case]
    refused(written(tmp_path, **changes), message)


def test_a_wrong_setting_of_the_section_names_the_option(tmp_path: Path, refused: Refused) -> None:
    missing = "poses.traffic.lanes has no 'est' (did you mean 'west'?)"
    for lane, value, said in (("west", -1, "Input should be"), ("est", 1, missing)):
        key = f"poses.traffic.lanes.{lane}.per_hour"
        refused(written(tmp_path), f"--set {key}: {said}", options=("--set", f"{key}={value}"))


def test_vessels_without_room_are_warned_of(tmp_path, monkeypatch, capsys):
    pond = {"polygon_m": [[-30, 30], [30, 30], [30, 90], [-30, 90]], "per_km2": 5000, "kinds": "kayak"}
    scene = written(tmp_path, **_traffic(own=OWN, leisure={"pond": pond}, labels="Vessel"))
    loaded = load_scene(scene)
    left_out = loaded.poses.left_out["leisure.pond"]  # type: ignore[attr-defined]
    said = f"poses.traffic: {left_out} of the vessels that were drawn found no room and are left out: {left_out} of"
    assert left_out > 0
    result = run_scene(loaded, tmp_path / "run")
    assert any(warning.startswith(said) for warning in run_warnings(loaded, result))
    assert call(monkeypatch, "check", "scene", scene, "--json") == 0
    assert any(warning.startswith(said) for warning in json.loads(capsys.readouterr().out)["warnings"])
