import subprocess
import sys

from PIL import Image

from modsim3d.cli import main
from modsim3d.io.input_files import data_folder
from tests import command_line
from tests.cli.bad_input.builders import refusal


def test_run_writes_a_contact_sheet_and_says_what_happened(monkeypatch, tmp_path, capsys):
    out = tmp_path / "run"
    assert command_line.call(monkeypatch, "run", "simulation_1", "--mode", 2, "--steps", 300, "--out", out) == 0
    said = capsys.readouterr().out
    rows = ("frames", "vessels seen", "partly hidden", "detections", "missed", "false alarms", "time per frame")
    for word in (*rows, str(out)):
        assert word in said
    with Image.open(out / "contact_sheet.png") as sheet:
        assert sheet.size[0] > 1000 and len(sheet.convert("RGB").getcolors(maxcolors=2**24)) > 20


def test_contact_sheet_is_the_same_bytes_again(monkeypatch, tmp_path):
    for name in ("a", "b"):
        command_line.call(monkeypatch, "run", "simulation_1", "--mode", 2, "--steps", 160, "--out", tmp_path / name)
    assert (tmp_path / "a/contact_sheet.png").read_bytes() == (tmp_path / "b/contact_sheet.png").read_bytes()


def test_run_in_mode_zero_needs_no_renderer_with_the_analytic_source(tmp_path):
    line = ["modsim3d", "run", "simulation_1", "--steps", "20", "--source", "analytic", "--out", str(tmp_path / "run")]
    start = f"import sys; sys.modules['OpenGL'] = None; sys.argv = {line!r}"
    script = f"{start}\nfrom modsim3d.cli.main import main\nmain()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "truth.parquet").exists()


def test_check_and_scenes(monkeypatch, capsys):
    assert command_line.call(monkeypatch, "check", "scene", "simulation_1") == 0
    said = capsys.readouterr().out
    assert "no problems found" in said
    assert "in the long run excellent 17.8%, good 32.2%, bad 32.2%, terrible 17.8%\n" in said
    forced = ("--set", "detector.performance.schedule=[[10, bad]]")
    assert command_line.call(monkeypatch, "check", "scene", "simulation_1", *forced) == 0
    assert "terrible 17.8%, while no schedule forces one\n" in capsys.readouterr().out
    assert command_line.call(monkeypatch, "scenes") == 0
    assert "simulation_1" in capsys.readouterr().out


def test_version_and_help(monkeypatch, capsys):
    assert command_line.call(monkeypatch, "--version") == 0
    assert capsys.readouterr().out.startswith("modsim3d 0.")
    assert command_line.call(monkeypatch, "run", "--help") == 0
    assert "Example" in capsys.readouterr().out


def test_run_is_not_overwritten_unasked(monkeypatch, tmp_path, capsys):
    arguments = ("run", "simulation_1", "--steps", 5, "--no-sheet", "--out", tmp_path / "run")
    assert command_line.call(monkeypatch, *arguments) == 0
    assert command_line.call(monkeypatch, *arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert command_line.call(monkeypatch, *arguments, "--overwrite") == 0


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


def test_ctrl_c_before_a_command_begins_is_one_message(monkeypatch, capsys):
    def press_ctrl_c(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(main, "_asked", press_ctrl_c)
    assert command_line.call(monkeypatch, "run", "simulation_1") == 130
    assert capsys.readouterr().err == "modsim3d: interrupted\n"


def test_check_knows_a_campaign_and_a_detector_by_their_keys(call):
    scenes = data_folder("scenes")
    status, said = call("check", "scene", scenes / "campaigns" / "example.yaml")
    assert status == 0 and "trackers" in said
    status, said = call("check", "scene", scenes / "detectors" / "coastal.yaml")
    assert status == 0 and "no problems found" in said
    refusal(call, ("check", "scene", scenes / "detectors" / "coastal.yaml", "--state", "haze"), "are for scenes, and")
    status, said = call("check", "scene", "strait")
    assert status == 0 and "strait" in said
