"""Run directories: complete, repeatable, in the formats that were promised."""

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import modsim3d
from modsim3d import RunDirectoryError, load_scene, run_scene, simulate_frames
from modsim3d.runs import pipeline
from tests.cli.bad_input.builders import GOOD, Inputs, at, lens
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


def test_without_the_thesis_json_all_other_files_are_the_same_bytes(scene, finished, tmp_path):
    run_scene(scene, tmp_path / "run", thesis_json=False)
    with_json, without = run_files(finished), run_files(tmp_path / "run")
    assert with_json.keys() - without.keys() == THESIS_JSON
    run, expected = json.loads(without.pop("run.json")), json.loads(with_json["run.json"])
    assert run == {**expected, "files": {key: expected["files"][key] for key in expected["files"].keys() - THESIS_JSON}}
    assert without.items() <= with_json.items()


def test_an_interrupted_run_goes_on_and_a_run_is_replaced_with_and_without_the_thesis_json(tmp_path):
    scene = load_scene("simulation_1", mode=2, steps=300, source="analytic")
    for first, then in ((True, False), (False, True)):
        folder = interrupt(scene, tmp_path / f"{first}", thesis_json=first)
        assert run_scene(scene, folder, resume=True, thesis_json=then).resumed_steps
        assert {path.name for path in folder.iterdir()} == (FILES if then else FILES - THESIS_JSON)
        run_scene(replace(scene, steps=2), folder, overwrite=True, thesis_json=first)
        assert {path.name for path in folder.iterdir()} == (FILES if first else FILES - THESIS_JSON)


def test_same_seed_gives_the_same_bytes_and_another_seed_others(scene, finished, tmp_path):
    run_scene(scene, tmp_path / "again")
    assert run_files(tmp_path / "again") == run_files(finished)
    run_scene(load_scene("simulation_1", mode=2, steps=STEPS, seed=1), tmp_path / "other")
    other = run_files(tmp_path / "other")
    assert all(other[name] != data for name, data in run_files(finished).items() if name != "scene/detector.yaml")


def test_run_json_lists_the_promised_files_with_size_and_checksum_and_holds_counts_but_no_time_and_no_host(finished):
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


def test_thesis_json_has_a_key_for_every_step_and_the_figures_fields_and_tells_the_same_as_the_tables(finished):
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


def test_frames_table_counts_what_the_others_hold_and_truth_obeys_its_own_arithmetic(finished):
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


def test_interrupted_run_goes_on_to_the_same_bytes_with_the_same_settings_only(scene, finished, tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 120)
    folder = interrupt(scene, tmp_path / "killed", blocks=2)
    assert not (folder / "run.json").exists()
    lines = (folder / "unfinished" / "detections_C0.jsonl").read_text().splitlines()
    assert len(lines) == 240 and all(json.loads(line) for line in lines)
    with pytest.raises(RunDirectoryError, match="--resume or --overwrite"):
        run_scene(scene, folder)
    with pytest.raises(RunDirectoryError, match="another scene, seed, settings or version"):
        run_scene(load_scene("simulation_1", mode=2, steps=STEPS, seed=5), folder, resume=True)
    assert run_scene(scene, folder, resume=True).resumed_steps == 240
    assert run_files(folder) == run_files(finished)


def test_python_way_gives_the_same_as_the_files(scene, finished):
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
