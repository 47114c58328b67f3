"""Run directories: complete, repeatable, in the formats promised, also where a detector must know its whole scene."""

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import modsim3d
from modsim3d import RunDirectoryError, Scene, load_scene, open_run, run_scene, simulate_frames
from modsim3d.detector.records import KINDS
from modsim3d.runs import pipeline
from tests.cli.bad_input.builders import GOOD, Call, Inputs, at, lens
from tests.run_folders import interrupt, run_files

STEPS = 300
THESIS_JSON = {"annotations_C0.json", "detections_C0.json"}
TABLES = {"frames.parquet", "truth.parquet", "detections.parquet"}
FILES = {"run.json", "run.log", "tracker_input_C0.jsonl", "scene"} | THESIS_JSON | TABLES


@pytest.fixture(scope="module")
def scene():
    return load_scene("simulation_1", mode=2, steps=STEPS)


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory) -> Path:
    return run_scene(scene, tmp_path_factory.mktemp("runs") / "first").folder


def test_the_same_seed_gives_the_same_bytes_also_without_the_thesis_json_and_another_others(scene, finished, tmp_path):
    run_scene(scene, tmp_path / "run", thesis_json=False)
    with_json, without = run_files(finished), run_files(tmp_path / "run")
    assert with_json.keys() - without.keys() == THESIS_JSON
    run, expected = json.loads(without.pop("run.json")), json.loads(with_json["run.json"])
    assert run == {**expected, "files": {key: expected["files"][key] for key in expected["files"].keys() - THESIS_JSON}}
    assert without.items() <= with_json.items()
    run_scene(scene, tmp_path / "again")
    assert run_files(tmp_path / "again") == run_files(finished)
    run_scene(load_scene("simulation_1", mode=2, steps=STEPS, seed=1), tmp_path / "other")
    other = run_files(tmp_path / "other")
    assert all(other[name] != data for name, data in run_files(finished).items() if name != "scene/detector.yaml")


def test_an_interrupted_run_goes_on_and_a_run_is_replaced_with_and_without_the_thesis_json(tmp_path):
    scene = load_scene("simulation_1", mode=2, steps=300, source="analytic")
    for first, then in ((True, False), (False, True)):
        folder = interrupt(scene, tmp_path / f"{first}", thesis_json=first)
        assert run_scene(scene, folder, resume=True, thesis_json=then).resumed_steps
        assert {path.name for path in folder.iterdir()} == (FILES if then else FILES - THESIS_JSON)
        run_scene(replace(scene, steps=2), folder, overwrite=True, thesis_json=first)
        assert {path.name for path in folder.iterdir()} == (FILES if first else FILES - THESIS_JSON)


def test_run_json_lists_the_promised_files_and_thesis_json_tells_the_same_as_the_tables(finished):
    data = json.loads((finished / "run.json").read_text())
    assert (data["seed"], data["counts"]["frames"], len(data["scene_sha256"])) == (0, STEPS, 64)
    assert data["versions"]["modsim3d"] == modsim3d.__version__
    assert {"format", "backend", "annotation", "steps"} <= set(data)
    assert not {"time", "date", "host", "seconds"} & {key.lower() for key in data}
    assert {path.name for path in finished.iterdir()} == FILES
    written = {path for path in finished.rglob("*") if path.is_file() and path.name not in ("run.json", "run.log")}
    assert list(data["files"]) == sorted(str(path.relative_to(finished)) for path in written)
    for name, entry in data["files"].items():
        content = (finished / name).read_bytes()
        assert entry == {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    counts = data["counts"]
    assert counts["detected"] + counts["missed"] == counts["annotated"]
    # The source's errors have a standard deviation of 40–85 px on boxes of 10–80 px.
    assert counts["below_half_iou"] > 0.9 * counts["detected"] and 0 < counts["redrawn"] < counts["detected"]
    annotations = json.loads((finished / "annotations_C0.json").read_text())
    detections = json.loads((finished / "detections_C0.json").read_text())
    assert list(annotations) == list(detections) == list(load_scene("simulation_1").timestamps(0, STEPS))
    for entry in annotations["0.2"].values():
        assert set(entry) == {"label", "bbox"} and set(entry["bbox"]["centre"]) == {"x", "y"}
        assert set(entry["bbox"]) == {"centre", "height", "width", "depth"}
    found = [entry for step in detections.values() for entry in step.values()]
    assert found
    for entry in found:
        assert set(entry) == {"label", "confidenceScore", "bbox"} and 0.2 <= entry["confidenceScore"] <= 1
        assert set(entry["bbox"]) == {"centre", "height", "width"}
    truth = pq.read_table(finished / "truth.parquet").to_pylist()
    assert sum(row["annotated"] for row in truth) == sum(map(len, annotations.values()))
    for row in truth:
        if row["annotated"]:
            box = annotations[row["timestamp"]][row["vessel"]]["bbox"]
            assert box["centre"]["x"] == (row["visible_x_min_px"] + row["visible_x_max_px"]) / 2
            assert box["height"] == row["visible_y_max_px"] - row["visible_y_min_px"] and box["depth"] == row["depth_m"]
    drawn = pq.read_table(finished / "detections.parquet").to_pylist()
    assert len(drawn) == len(found)
    for row in drawn:
        entries = [(entry["bbox"], entry["confidenceScore"]) for entry in detections[row["timestamp"]].values()]
        told = [(box["centre"]["x"], box["width"], confidence) for box, confidence in entries]
        assert (row["centre_x_px"], row["width_px"], row["confidence"]) in told


def test_frames_and_truth_obey_their_own_arithmetic_and_python_gives_the_same_as_the_files(finished, scene):
    frames = pq.read_table(finished / "frames.parquet").to_pylist()
    truth, detections = (pq.read_table(finished / f"{name}.parquet") for name in ("truth", "detections"))
    assert [row["step"] for row in frames] == list(range(STEPS))
    steps, annotated, detected = (truth[name].to_numpy() for name in ("step", "annotated", "detected"))
    kinds = np.array(detections["kind"].to_pylist())
    for row in frames[::17]:
        here, drawn = steps == row["step"], detections["step"].to_numpy() == row["step"]
        assert row["n_annotated"] == (here & annotated).sum()
        assert row["n_detected"] == (here & detected).sum() == (drawn & (kinds == "true")).sum()
        assert row["n_false"] == (drawn & (kinds == "false_positive")).sum()
    rows = truth.to_pylist()
    assert any(row["occluded_by"] for row in rows)
    for row in rows:
        assert row["visible_px"] + sum(entry["px"] for entry in row["occluded_by"]) == row["silhouette_px"]
        assert math.isclose(row["visible_fraction"], row["visible_px"] / row["silhouette_px"])
        assert (row["visible_x_min_px"] is None) == (row["visible_px"] == 0)
        assert (row["annotated"] == (row["visible_px"] > 0) and row["annotated"]) or not row["detected"]
    frames = list(simulate_frames(scene))
    assert len(frames) == STEPS
    boxes = np.concatenate([frame.detections.boxes_px for frame in frames])
    assert boxes[:, 0].tolist() == pq.read_table(finished / "detections.parquet")["x_min_px"].to_pylist()
    frame = frames[151]
    assert (frame.timestamp, frame.truth.boxes_px.shape) == ("30.2", (5, 4))
    assert frame.truth.vessels == tuple(f"vessel{i}" for i in range(1, 6))
    assert frame.truth.occluded_by[4].keys() == {"vessel2"}
    sources = [vessel for vessel in frame.detections.vessels if vessel is not None]
    assert sorted(sources) == [v for v, found in zip(frame.truth.vessels, frame.truth.detected, strict=True) if found]


def test_interrupted_run_goes_on_to_the_same_bytes_with_the_same_settings_only(scene, finished, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 120)
    folder = interrupt(scene, tmp_path / "killed", blocks=2)
    assert not (folder / "run.json").exists()
    lines = (folder / "unfinished" / "detections_C0.jsonl").read_text().splitlines()
    assert len(lines) == 240 and all(json.loads(line) for line in lines)
    with pytest.raises(RunDirectoryError, match="resume=True or overwrite=True"):
        run_scene(scene, folder)
    with pytest.raises(RunDirectoryError, match="another scene, seed, settings or version"):
        run_scene(load_scene("simulation_1", mode=2, steps=STEPS, seed=5), folder, resume=True)
    assert run_scene(scene, folder, resume=True).resumed_steps == 240
    assert run_files(folder) == run_files(finished)


def test_own_files_run(tmp_path):
    """A user's vessels and poses as in the source's Figures 7.2 and 7.3, with a camera on one of the vessels."""
    bow = lens(mount={"vessel": "vehicle1", "position_m": [4, 0, 3], "pitch_rad": 0.02}, pixel_size_m=[1e-5, 0.83e-5])
    times = [f"{1700000000 + t}.50" for t in range(5)]
    poses = {t: {"vehicle1": at(2.0 * i, 0), "vehicle2": at(80, 2.0 * i - 3, np.pi / 2)} for i, t in enumerate(times)}
    scene = Inputs(tmp_path, {**GOOD, "scene": {**GOOD["scene"], "cameras": {"bow": bow}}, "poses": poses}).write()
    counts = run_scene(load_scene(scene), tmp_path / "out").counts
    assert counts.frames == counts.annotated == 5
    annotations = json.loads((tmp_path / "out" / "annotations_bow.json").read_text())
    assert list(annotations) == times
    # At step t the other's near side is 74 − 2t m ahead of the camera at most; it moves to port: columns fall.
    columns = [places["vehicle2"]["bbox"]["centre"]["x"] for places in annotations.values()]
    assert columns == sorted(columns, reverse=True)


SCENE = """
steps: 600
time_step_s: 0.2
seed: 3
vessels:
  a: {length_m: 14, beam_m: 4, air_draft_m: 2, label: sailboat}
  b: {length_m: 30, beam_m: 5, air_draft_m: 3, label: motorboat}
  c: {length_m: 60, beam_m: 9, air_draft_m: 6, label: ferry}
  d: {length_m: 9, beam_m: 3, air_draft_m: 2, label: sailboat}
poses: {circular: {centre_m: [300, 0], radius_m: [5, 150], rotation_rate_rad_s: [0.02, 0.06]}}
cameras:
  C0: &camera
    {focal_length_m: 0.02, pixel_size_m: [1.0e-5, 1.0e-5], principal_point_px: [1000, 500], image_size_px: [2000, 1000],
     pose: {position_m: [0, 0, 12], pitch_rad: 0.04}}
  C1: {<<: *camera, pose: {position_m: [0, 50, 12], pitch_rad: 0.04, roll_rad: 0.1}}
annotation: {mode: 0, source: analytic}
detector: rich
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rich")
    (folder / "scene.yaml").write_text(SCENE)
    return folder


@pytest.fixture(scope="module")
def model_scene(folder: Path) -> Scene:
    return modsim3d.load_scene(folder / "scene.yaml")


@pytest.fixture(scope="module")
def run(folder: Path, model_scene: Scene) -> Path:
    return modsim3d.run_scene(model_scene, folder / "run").folder


def test_two_workers_write_the_bytes_of_one(call: Call, folder: Path, run: Path) -> None:
    status, said = call("run", folder / "scene.yaml", "--no-sheet", "--workers", 2, "--out", folder / "two")
    assert status == 0 and "gated" in said and "resumed" not in said, said
    assert run_files(folder / "two") == run_files(run)


def test_an_interrupted_run_has_a_page_and_goes_on_to_the_same_bytes(call, folder, run, model_scene, monkeypatch):
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 250)
    interrupt(model_scene, folder / "cut")
    assert call("report", folder / "cut")[0] == 0
    cut = open_run(folder / "cut")
    assert 0 < cut.steps < model_scene.steps
    confidence = np.concatenate([frame.detections.confidence for frame in cut.frames()])
    assert np.array_equal(confidence, cut.tables()["detections"]["confidence"].to_numpy())
    (folder / "cut" / "report.html").unlink()
    assert modsim3d.run_scene(model_scene, folder / "cut", resume=True).resumed_steps == 250
    assert run_files(folder / "cut") == run_files(run)


def test_frames_in_memory_are_those_of_the_run_and_names_kinds_and_counts_fit_also_of_merged_boxes(run, model_scene):
    table = pq.read_table(run / "detections.parquet").to_pylist()
    assert {row["kind"] for row in table} == {*KINDS} - {"on_vessel"}
    confidence = np.concatenate([frame.detections.confidence for frame in modsim3d.simulate_frames(model_scene)])
    assert confidence.tolist() == [row["confidence"] for row in table]
    content = json.loads((run / "detections_C0.json").read_bytes())
    for kinds, ending in ((("duplicate", "fragment"), "#2"), (("true", "split", "merged"), "")):
        rows = [row for row in table if row["camera"] == "C0" and row["kind"] in kinds]
        entries = [content[row["timestamp"]][f"{row['vessel']}{ending}"] for row in rows]
        assert [entry["confidenceScore"] for entry in entries] == [row["confidence"] for row in rows] != []
    counts = json.loads((run / "run.json").read_bytes())["counts"]  # of a merged box both vessels are detected
    kinds = [row["kind"] for row in table]
    own = sum(kind in ("true", "split", "merged") for kind in kinds)
    assert counts["merged"] == kinds.count("merged") > 0 and counts["detected"] == own + counts["merged"]
    assert counts["detected"] == sum(pq.read_table(run / "truth.parquet")["detected"].to_pylist())
    assert counts["false_positives"] == len(kinds) - own and 0 < counts["missed_by_gate"] <= counts["missed"]


def test_the_bias_of_truncation_is_in_the_run_file(tmp_path: Path) -> None:
    result = modsim3d.run_scene(modsim3d.load_scene("simulation_1", source="analytic", steps=400), tmp_path / "run")
    assert json.loads((tmp_path / "run" / "run.json").read_bytes())["truncation"] == result.truncation
    excellent = result.truncation["excellent"]
    rows = pq.read_table(tmp_path / "run" / "detections.parquet").to_pylist()
    errors = np.array([row["e_w_px"] for row in rows if row["state"] == "excellent" and row["kind"] == "true"])
    integration = 0.03 * errors.std()
    sampling = 4 * errors.std() / np.sqrt(len(errors)) + 3 * excellent["mean_standard_error"][2]  # of errors and boxes
    assert abs(errors.mean() - excellent["mean"][2]) < sampling + integration
    assert excellent["mean_shift"][2] > 30 and excellent["detections"] == len(errors)
