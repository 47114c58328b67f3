"""What `check scene` says of a scene, a campaign and a detector, and that doubts change no exit status."""

from pathlib import Path

import pytest

from modsim3d import load_detector
from modsim3d.io.input_files import data_folder
from tests.cli.conftest import Modsim3d
from tests.cli.test_json import parsed
from tests.scenes import write_scene

CAMERA = {"hfov_deg": 60, "image_size_px": [1920, 1080], "pose": {"position_m": [-90, 0, 12], "pitch_deg": 3}}


def test_a_scene_is_shown_doubted_and_drawn_with_exit_status_0(modsim3d: Modsim3d, tmp_path: Path) -> None:
    boats = {"ferry": ([14, 86, 20], [[0, 100, 0], [9, 150, 0]])}
    line = ("check", "scene", write_scene(tmp_path, boats, 9, cameras={"quay": CAMERA}), "--map", tmp_path / "map.png")
    said = modsim3d(*line)
    assert said.status == 0 and said.err.startswith("warning: vessel 'ferry' is 14 m long and 86 m wide")
    shown = " ".join(said.out.split())
    assert (
        "quay: 1920 × 1080, 60.0° × 36.0°, 12 m up, looks towards heading 0° and 3° down, horizon at row 453" in shown
    )
    assert "Vessel: 1, 14 × 86 × 20 m, 5.6 m/s" in shown and (tmp_path / "map.png").read_bytes()[1:4] == b"PNG"
    found = parsed(modsim3d(*line, "--overwrite", "--json"))
    (camera,), (boat,) = found["camera_facts"], found["vessel_types"]
    assert camera["field_of_view_deg"][0] == pytest.approx(60) and camera["horizon_row"] == pytest.approx(
        452.86, abs=0.01
    )
    assert (boat["length_m"], boat["count"], found["map"]) == ([14, 14], 1, str(tmp_path / "map.png"))
    assert len(found["warnings"]) == 1


def test_a_campaign_has_its_runs_and_a_detector_its_misses_and_false_alarms(modsim3d: Modsim3d) -> None:
    scenes = data_folder("scenes")
    found = parsed(modsim3d("check", "scene", scenes / "campaigns" / "example.yaml", "--json"))
    assert (found["runs"], found["trackers"], len(found["required"])) == (24, ["reference", "hasty"], 3)
    file = scenes / "detectors" / "coastal.yaml"
    detector, found = load_detector(file), parsed(modsim3d("check", "scene", file, "--json"))
    for state, facts in zip(detector.states, found["states"], strict=True):
        detected = state.confusion[:-1].sum(axis=0).mean()
        assert (
            facts["miss_rate"] == pytest.approx(1 - detected)
            and facts["false_alarms"] == state.false_positives_per_image
        )
    said = modsim3d("check", "scene", file).out
    assert (
        "missed        clear 4.0%, haze 13.3%, 7.1% in the long run\nfalse alarms  clear 0.1, haze 0.25 an image"
        in said
    )
    refused = modsim3d("check", "scene", file, "--map", "map.png")
    assert refused.status == 2 and "--map are for scenes" in refused.err
