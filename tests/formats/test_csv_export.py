"""The tables of `export --format csv`: read back as text, and nothing of the truth in what a tracker reads."""

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from modsim3d.cli.main import app
from modsim3d.detector.records import KINDS
from modsim3d.geometry.camera_poses import camera_R_parent
from modsim3d.runs.locating import locate
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import StoredRun, open_run
from tests.runs.test_locating import position_scene

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "positions.md").read_text(encoding="utf-8")
BOX = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
Table = dict[str, list[str]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return open_run(run_scene(position_scene(), tmp_path_factory.mktemp("csv") / "run").folder)


def export(run: StoredRun, folder: Path, *options: str) -> Any:
    arguments = ["export", str(run.folder), "--format", "csv", "--out", str(folder), *options]
    return CliRunner().invoke(app, arguments, catch_exceptions=False, env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def exported(run: StoredRun) -> Path:
    folder = run.folder.parent / "exported"
    assert export(run, folder).exit_code == 0
    return folder


def read(path: Path) -> Table:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    return {name: [row[name] for row in rows] for name in reader.fieldnames or ()}


def numbers(table: Table, *names: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    columns = [[float(text) if text else np.nan for text in table[name]] for name in names]
    return np.array(columns[0] if len(names) == 1 else columns).T


def documented(file: str) -> list[str]:
    section = PAGE.partition(f"\n### {file}\n")[2].partition("\n#")[0]
    return re.findall(r"`([a-z0-9_]+)`", "\n".join(re.findall(r"^\| (`[^|]+) \|", section, re.MULTILINE)))


SECTIONS = {"detections_bow": "detections_CAMERA.csv", "frames_shore": "frames_CAMERA.csv"}
SECTIONS |= {"truth_bow": "truth_CAMERA.csv", "cameras": "cameras.csv", "ownship": "ownship.csv"}


def test_the_page_lists_the_columns_of_every_file_and_worked_out_numbers_have_nine_digits(exported: Path) -> None:
    for name, section in SECTIONS.items():
        assert list(read(exported / f"{name}.csv")) == documented(section), name
    for path in sorted(exported.glob("*.csv")):
        for name, cells in read(path).items():
            if name not in ("step", "timestamp", "time_s") and all(re.fullmatch(r"[-+.e0-9]*", cell) for cell in cells):
                assert all(float(f"{float(cell):.9g}") == float(cell) for cell in cells if cell), (path.name, name)


@pytest.mark.parametrize("camera", ["bow", "shore"])
def test_frames_have_the_pose_of_their_camera_and_detections_lie_where_rounded_boxes_are(run, exported, camera) -> None:
    table = read(exported / f"frames_{camera}.csv")
    assert numbers(table, "step").tolist() == list(range(run.steps))
    assert table["timestamp"] == list(run.scene.timestamps(0, run.steps))
    places = numbers(table, "camera_w1_m", "camera_w2_m", "camera_w3_m")
    angles = numbers(table, "camera_roll_rad", "camera_pitch_rad", "camera_yaw_rad")
    index = [each.name for each in run.scene.cameras].index(camera)
    for step in (0, 11):
        true = run.scene.at(step).sights[index].camera_poses
        turned = camera_R_parent(*angles[step]) @ true.camera_R_world[0].T
        error = np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))
        assert error < 1e-6 if camera == "shore" else 1e-4 < error < 0.06
        np.testing.assert_allclose(places[step], true.positions_m[0], atol=1e-5 if camera == "shore" else 0.5)
    table = read(exported / f"detections_{camera}.csv")
    frames = [frame for frame in run.frames() if frame.camera == camera]
    boxes, steps = numbers(table, *BOX), numbers(table, "step").astype(int)
    assert len(boxes) == sum(len(frame.detections) for frame in frames) > 20
    for frame in frames:
        mine = np.flatnonzero(steps == frame.step)
        confidence = numbers(table, "confidence")[mine]
        assert (np.diff(confidence) <= 0).all()
        order = np.lexsort((*frame.detections.boxes_px.T[::-1], -frame.detections.confidence))
        np.testing.assert_allclose(boxes[mine], frame.detections.boxes_px[order], atol=5.01e-4)
        assert [table["label"][row] for row in mine] == [frame.detections.labels[row] for row in order]
    found = locate(run.scene, camera, steps, boxes)
    same = ("bearing_rad", "bearing_std_rad", "inverse_range_per_m", "inverse_range_std_per_m", "covariance_rad_per_m")
    expected = {name: getattr(found, name) for name in same}
    expected |= {"w1_m": found.positions_m[:, 0], "w2_m": found.positions_m[:, 1]}
    variances = {"w1_variance_m2": (0, 0), "w1_w2_covariance_m2": (0, 1), "w2_variance_m2": (1, 1)}
    expected |= {name: found.position_covariances_m2[:, i, j] for name, (i, j) in variances.items()}
    for name, values in expected.items():
        np.testing.assert_allclose(numbers(table, name), values, rtol=1e-8, err_msg=name)


def test_nothing_that_a_tracker_reads_names_a_vessel_and_true_attitudes_are_true(run, exported, tmp_path):
    scene = run.scene
    secrets = [name for name in scene.vessel_names if name != "flagship"]  # own ship is known to be there
    secrets += [state.name for state in scene.detector.states] + [kind for kind in KINDS if kind != "true"]
    for path in exported.glob("*.csv"):
        if path.name.startswith("truth_"):
            assert b"mermaid" in path.read_bytes()
            continue
        assert [name for name in secrets if name.encode() in path.read_bytes()] == [], path.name
    for camera in ("bow", "shore"):  # and the last bits of an edge do not tell a cut true box from a false one
        table = read(exported / f"detections_{camera}.csv")
        assert all(len(text.partition(".")[2]) <= 3 for name in BOX for text in table[name])
    table, rows = read(exported / "truth_shore.csv"), run.table("truth")
    mine = [row for row in rows.to_pylist() if row["camera"] == "shore"]
    assert table["vessel"] == [row["vessel"] for row in mine]
    assert table["annotated"] == [str(row["annotated"]).lower() for row in mine]
    for at, row in list(enumerate(mine))[::7]:
        place = run.scene.at(row["step"])
        column = run.scene.vessel_names.index(row["vessel"])
        centre = place.vessel_poses.poses.positions_m[0, column, :2]
        away = centre - [-50, 30]
        said = numbers(table, "w1_m", "w2_m", "bearing_rad", "inverse_range_per_m")[at]
        expected = [*centre, np.arctan2(away[1], away[0]), 1 / np.hypot(*away)]
        np.testing.assert_allclose(said, expected, rtol=1e-6, atol=1e-9)
        full = [row[f"full_{side}"] for side in BOX]
        np.testing.assert_allclose(numbers(table, *BOX)[at], full, atol=5.01e-4)
    assert export(run, tmp_path / "true", "--true-attitude").exit_code == 0
    frames = read(tmp_path / "true" / "frames_bow.csv")
    angles = numbers(frames, "camera_roll_rad", "camera_pitch_rad", "camera_yaw_rad")
    true = run.scene.at(7).sights[0].camera_poses.camera_R_world[0]
    np.testing.assert_allclose(camera_R_parent(*angles[7]), true, atol=1e-7)
    own = run.table("ownship")
    kinds = {tmp_path / "true": ("roll_rad", "pitch_rad"), exported: ("measured_roll_rad", "measured_pitch_rad")}
    for folder, names in kinds.items():
        said = numbers(read(folder / "ownship.csv"), "roll_rad", "pitch_rad")
        np.testing.assert_allclose(said, np.column_stack([own[name] for name in names]), rtol=1e-7, atol=1e-12)
    assert (tmp_path / "true" / "truth_bow.csv").read_bytes() == (exported / "truth_bow.csv").read_bytes()
    same = read(tmp_path / "true" / "detections_bow.csv"), read(exported / "detections_bow.csv")
    assert same[0]["x_min_px"] == same[1]["x_min_px"] and same[0]["bearing_rad"] != same[1]["bearing_rad"]
    stds = [numbers(table, "bearing_std_rad") for table in same]
    assert (stds[0] < stds[1])[np.isfinite(stds[0])].all()


def test_one_camera_alone_and_a_run_without_own_ship(run: StoredRun, exported: Path, tmp_path: Path) -> None:
    assert export(run, tmp_path / "shore", "--camera", "shore").exit_code == 0
    names = {"detections_shore.csv", "frames_shore.csv", "truth_shore.csv", "cameras.csv", "ownship.csv"}
    assert {path.name for path in (tmp_path / "shore").iterdir()} == names
    for name in names - {"cameras.csv"}:
        assert (tmp_path / "shore" / name).read_bytes() == (exported / name).read_bytes()
    assert read(tmp_path / "shore" / "cameras.csv")["camera"] == ["shore"]
    lens = run.scene.copy.document["cameras"]["shore"]
    cameras = {"shore": {**lens, "frame_rate_hz": 1, "start_offset_s": 1.5}}
    empty = position_scene(cameras=cameras, waves=None, imu=None, annotation={"source": "analytic", "min_box_px": 500})
    ashore = open_run(run_scene(empty, tmp_path / "ashore").folder)
    assert export(ashore, tmp_path / "out").exit_code == 0
    assert not (tmp_path / "out" / "ownship.csv").exists()
    assert numbers(read(tmp_path / "out" / "frames_shore.csv"), "step").tolist() == list(range(3, run.steps, 2))
    detections = read(tmp_path / "out" / "detections_shore.csv")
    assert list(detections) == documented("detections_CAMERA.csv") and detections["step"] == []
    assert set(read(tmp_path / "out" / "truth_shore.csv")["annotated"]) == {"false"}
