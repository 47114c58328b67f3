"""The lines of a stream are those of a run's files, and name the camera."""

import gc
import json
import re
from collections import defaultdict
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import Scene, load_scene, run_scene
from modsim3d.detector.records import KINDS
from modsim3d.runs.streaming.lines import Pace, StepLines, header_line, short_collections, step_lines
from tests.cli.test_json import documented

STEPS, ANGLES = 12, ("roll", "pitch", "heading")
ROOT = Path(__file__).resolve().parents[3]
PREFIX = re.compile(rb'\{"camera":("[^"]*"),"frames_in_step":([0-9]+),(?:"attitude_rad":[^]]*],)?')


@pytest.fixture(scope="module")
def scene() -> Scene:
    unit = {"imu": {"attitude_noise_rad": 0.01, "heading_bias_rad": 0.1}}
    return load_scene("strait", steps=STEPS, source="analytic", settings=unit)


@pytest.fixture(scope="module")
def streamed(scene: Scene) -> list[StepLines]:
    return list(step_lines(scene, one_by_one=False))


def by_camera(streamed: list[StepLines]) -> dict[str, bytes]:
    """The streamed lines of each camera without what a run's file does not have."""
    files: dict[str, bytes] = defaultdict(bytes)
    for line in (line for step in streamed for line in step.lines):
        found = PREFIX.match(line)
        assert found is not None
        files[json.loads(found[1])] += b"{" + line[found.end() :]
    return files


@pytest.fixture(scope="module")
def run(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_scene(scene, tmp_path_factory.mktemp("lines") / "run").folder


def test_they_are_the_lines_of_a_runs_files_byte_for_byte(scene: Scene, streamed: list[StepLines], run: Path) -> None:
    files = {camera.name: (run / f"tracker_input_{camera.name}.jsonl") for camera in scene.cameras}
    assert by_camera(streamed) == {name: file.read_bytes() for name, file in files.items()}
    assert list(step_lines(scene, one_by_one=True)) == streamed


def test_steps_come_in_order_with_their_numbers_of_lines_and_the_attitude_of_own_ship_on_board(streamed, run):
    columns = pq.read_table(run / "ownship.parquet", columns=[f"measured_{angle}_rad" for angle in ANGLES])
    measured = [list(row.values()) for row in columns.to_pylist()]
    entries = [json.loads(line) for step in streamed for line in step.lines]
    assert [entry["attitude_rad"] for entry in entries if entry["camera"] == "bow"] == measured
    assert all("attitude_rad" not in entry for entry in entries if entry["camera"] == "quay")
    assert [step.step for step in streamed] == list(range(STEPS))
    for step in streamed:
        entries = [json.loads(line) for line in step.lines]
        assert {(entry["step"], entry["time_s"]) for entry in entries} == {(step.step, step.time_s)}
        assert {entry["frames_in_step"] for entry in entries} == {len(entries)}
    assert {len(step.lines) for step in streamed} == {1, 2}, "the quay's camera is slower"


def test_a_step_without_a_frame_has_a_line_that_says_so(tmp_path: Path) -> None:
    scene = load_scene("strait", steps=3, source="analytic", settings={"cameras.bow.start_offset_s": 0.4})
    (first, *_) = step_lines(scene, one_by_one=False)
    assert [json.loads(line) for line in first.lines] == [{"frames_in_step": 0, "time_s": 0.0, "step": 0}]


def test_a_detector_that_needs_all_targets_gives_the_lines_of_its_run(tmp_path: Path) -> None:
    scene = load_scene("strait", steps=4, source="analytic", settings={"detector.dropout.anchor": "state_rate"})
    assert scene.detector.needs_target_statistics
    run_scene(scene, tmp_path / "run")
    lines = by_camera(list(step_lines(scene, one_by_one=True)))
    assert lines["bow"] == (tmp_path / "run" / "tracker_input_bow.jsonl").read_bytes()


def test_the_header_has_the_scene_files_numbers_keys_are_documented_and_nothing_is_of_the_truth(scene, streamed):
    text = b"".join(line for step in streamed for line in step.lines).decode()
    own = {scene.vessel_names[index] for index in scene.own_ships}
    targets = set(scene.vessel_names) - set(scene.detector.labels)
    assert not [word for word in (*targets, *KINDS[1:], "vessel", "kind") if f'"{word}' in text]
    assert not [word for word in targets - own if f'"{word}"' in header_line(scene).decode()]
    header = json.loads(header_line(scene))
    assert (header["scene"], header["steps"], header["labels"]) == ("strait", STEPS, list(scene.detector.labels))
    file = yaml.safe_load((ROOT / "scenes" / "strait.yaml").read_text())["cameras"]
    assert list(header["cameras"]) == list(file)
    for name, given in file.items():
        told, place = header["cameras"][name], "mount" if "mount" in given else "pose"
        assert told[place].items() >= given[place].items()
        assert (told["image_size_px"], told["frame_rate_hz"]) == (given["image_size_px"], given.get("frame_rate_hz"))
        assert told["focal_px"] == pytest.approx([given["focal_length_m"] / size for size in given["pixel_size_m"]])
    keys = {*header, *(key for camera in header["cameras"].values() for key in camera)}
    assert documented("stream") == keys | {key for step in streamed for line in step.lines for key in json.loads(line)}


def test_no_step_leaves_before_its_time_and_errors_do_not_add_up() -> None:
    slept = [1000.0]  # the time, in parts
    pace = Pace(lambda: sum(slept), lambda seconds: slept.append(seconds * 0.75))  # a sleep may end early
    left = []
    for step in range(5):
        slept.append(7.0 if step == 2 else 0.01)
        pace.wait(step, 3.0 + step)
        left.append(sum(slept) - 1000.01)
    assert left == pytest.approx([0, 1, 8.0, 8.01, 8.02], abs=1e-6)
    assert (pace.latest, pace.late_s) == (2, pytest.approx(6.0))


def test_collections_leave_out_what_was_there_before_and_only_inside() -> None:
    before = gc.get_threshold()
    with pytest.raises(ZeroDivisionError), short_collections():
        assert len(gc.get_objects()) < 100 < gc.get_freeze_count() and gc.get_threshold()[0] == 700
        raise ZeroDivisionError
    assert (gc.get_threshold(), gc.get_freeze_count()) == (before, 0)
