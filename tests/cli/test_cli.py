"""What commands write, say and answer; that `--out` is a file or a folder; and what `check scene` shows and doubts."""

from pathlib import Path

import pytest
from PIL import Image

from modsim3d import load_detector
from modsim3d.cli import main
from modsim3d.io.input_files import data_folder
from tests import command_line
from tests.cli.bad_input.builders import answer, refusal
from tests.cli.conftest import Modsim3d
from tests.cli.test_json import parsed
from tests.scenes import write_scene


def test_run_says_what_happened_writes_the_same_contact_sheet_again_and_ctrl_c_ends_it(monkeypatch, tmp_path, capsys):
    for out in (tmp_path / "a", tmp_path / "b"):
        line = ("run", "simulation_1", "--mode", 2, "--steps", 160, "--out", out)
        assert command_line.call(monkeypatch, *line) == 0
        said = capsys.readouterr().out
        rows = ("frames", "vessels seen", "partly hidden", "detections", "missed", "false positives", "time per frame")
        assert all(word in said for word in (*rows, str(out)))
    with Image.open(tmp_path / "a/contact_sheet.png") as sheet:
        assert sheet.size[0] > 1000 and len(sheet.convert("RGB").getcolors(maxcolors=2**24)) > 20
    assert (tmp_path / "a/contact_sheet.png").read_bytes() == (tmp_path / "b/contact_sheet.png").read_bytes()

    def press_ctrl_c(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(main, "_app_for", press_ctrl_c)
    assert command_line.call(monkeypatch, "run", "simulation_1") == 130
    assert capsys.readouterr().err == "modsim3d: interrupted\n"


def test_a_run_without_json_can_be_read(monkeypatch, tmp_path):
    run = tmp_path / "run"
    arguments = ("--source", "analytic", "--steps", 20, "--no-sheet", "--no-json")
    assert command_line.call(monkeypatch, "run", "strait", *arguments, "--out", run) == 0
    assert [path.name for path in run.glob("*.json")] == ["run.json"]
    for command in (
        ("export", run, "--format", "coco", "--out", tmp_path / "coco"),
        ("detect", run, "--detector-seed", 7, "--out", tmp_path / "again"),
        ("track", run, "--out", tmp_path / "tracks"),
        ("score", run, tmp_path / "tracks"),
    ):
        assert command_line.call(monkeypatch, *command) in (0, 1), command


def test_commands_that_write_nothing_answer_and_check_knows_a_campaign_and_a_detector_by_their_keys(call):
    forced = ("--set", "detector.performance.schedule=[[10, bad]]")
    states = "in the long run excellent 17.8 %, good 32.2 %, bad 32.2 %, terrible 17.8 %\n"
    scenes = data_folder("scenes")
    for line, *parts in (
        (("check", "scene", "simulation_1"), "no problems found", states),
        (("check", "scene", "simulation_1", *forced), "terrible 17.8 %, while no schedule forces one\n"),
        (("check", "scene", "strait"), "strait"),
        (("check", "scene", scenes / "campaigns" / "example.yaml"), "trackers"),
        (("check", "scene", scenes / "detectors" / "coastal.yaml"), "no problems found"),
        (("scenes",), "simulation_1"),
        (("--version",), "modsim3d 0."),
        (("run", "--help"), "Example"),
    ):
        answer(call, line, *parts)
    refusal(call, ("check", "scene", scenes / "detectors" / "coastal.yaml", "--state", "haze"), "are for scenes, and")


FILES = {
    "report.html": ("report",),
    "map_000039.png": ("view map", "--width", "160"),
    "detections_000003.png": ("view frame", "3", "--width", "160"),
    "ids.gif": ("view film", "--kind", "ids", "--end", "1", "--width", "160", "--format", "gif"),
    "detections.mp4": ("view film", "--end", "0.5", "--width", "160"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_put_into_a_folder_under_its_usual_name(modsim3d, run, tmp_path, name):
    folder = tmp_path / ("pages" if name == "report.html" else "run.2")
    folder.mkdir()
    command, *options = FILES[name]
    line = (*command.split(), run, *options, "--out", folder)
    assert modsim3d(*line).status == 0
    assert [path.name for path in folder.iterdir()] == [name]
    said = modsim3d(*line)
    assert said.status == 2 and f"{folder / name} exists: use --overwrite" in said.err


def test_a_learned_detector_and_an_export_are_put_into_a_folder(modsim3d: Modsim3d, run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    assert modsim3d("learn", run, "--replicates", 20, "--no-check", "--out", tmp_path).status == 0
    assert {path.name for path in tmp_path.iterdir()} == {"detector.yaml", "detector.html", "detector.uncertainty.json"}
    assert modsim3d("export", run, "--format", "coco", "--out", folder).status == 0
    assert {path.name for path in folder.iterdir()} == {"gt.json", "dt.json"}
    for arguments, part in (
        (("--format", "voc", "--out", tmp_path), "coco"),
        (("--out", tmp_path), "--format"),
        (("--format", "coco"), "--out"),
    ):
        said = modsim3d("export", run, *arguments)
        assert said.status == 2 and part in said.err


CAMERA = {"hfov_deg": 60, "image_size_px": [1920, 1080], "pose": {"position_m": [-90, 0, 12], "pitch_deg": 3}}


def test_a_scene_is_shown_doubted_and_drawn_and_campaigns_and_detectors_have_their_facts(modsim3d, tmp_path):
    boats = {"ferry": ([14, 86, 20], [[0, 100, 0], [9, 150, 0]])}
    line = ("check", "scene", write_scene(tmp_path, boats, 9, cameras={"quay": CAMERA}), "--map", tmp_path / "map.png")
    said = modsim3d(*line)
    assert said.status == 0 and said.err.startswith("warning: vessel 'ferry' is 14 m long and 86 m wide")
    shown = " ".join(said.out.split())
    camera = "quay: 1920 × 1080, 60.0° × 36.0°, 12 m up, looks towards heading 0° and 3° down, horizon at row 453"
    assert camera in shown and "Vessel: 1, 14 × 86 × 20 m, 5.6 m/s" in shown
    assert (tmp_path / "map.png").read_bytes()[1:4] == b"PNG"
    found = parsed(modsim3d(*line, "--overwrite", "--json"))
    (camera,), (boat,) = found["camera_facts"], found["vessel_types"]
    assert camera["field_of_view_deg"][0] == pytest.approx(60)
    assert camera["horizon_row"] == pytest.approx(452.86, abs=0.01)
    assert (boat["length_m"], boat["count"], found["map"]) == ([14, 14], 1, str(tmp_path / "map.png"))
    assert len(found["warnings"]) == 1
    scenes = data_folder("scenes")
    found = parsed(modsim3d("check", "scene", scenes / "campaigns" / "example.yaml", "--json"))
    assert (found["runs"], found["trackers"], len(found["required"])) == (24, ["reference", "hasty"], 3)
    file = scenes / "detectors" / "coastal.yaml"
    detector, found = load_detector(file), parsed(modsim3d("check", "scene", file, "--json"))
    for state, facts in zip(detector.states, found["states"], strict=True):
        detected = state.confusion[:-1].sum(axis=0).mean()
        assert facts["miss_rate"] == pytest.approx(1 - detected)
        assert facts["false_alarms"] == state.false_positives_per_image
    missed = "missed           clear 4.0 %, haze 13.3 %, 7.1 % in the long run\n"
    assert f"{missed}false positives  clear 0.1, haze 0.25 an image" in modsim3d("check", "scene", file).out
    refused = modsim3d("check", "scene", file, "--map", "map.png")
    assert refused.status == 2 and "--map are for scenes" in refused.err
