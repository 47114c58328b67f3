"""Runs with a detector that must know its whole scene before it begins."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import modsim3d
from modsim3d import Scene, open_run
from modsim3d.detector.records import KINDS
from modsim3d.runs import pipeline as simulate
from tests.cli.bad_input.builders import Call
from tests.run_folders import interrupt, run_files

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
def scene(folder: Path) -> Scene:
    return modsim3d.load_scene(folder / "scene.yaml")


@pytest.fixture(scope="module")
def run(folder: Path, scene: Scene) -> Path:
    return modsim3d.run_scene(scene, folder / "run").folder


def test_two_workers_write_the_bytes_of_one(call: Call, folder: Path, run: Path) -> None:
    status, said = call("run", folder / "scene.yaml", "--no-sheet", "--workers", 2, "--out", folder / "two")
    assert status == 0 and "gated" in said and "resumed" not in said, said
    assert run_files(folder / "two") == run_files(run)


def test_an_interrupted_run_has_a_page_and_goes_on_to_the_same_bytes(call, folder, run, scene, monkeypatch):
    monkeypatch.setattr(simulate, "MAX_BLOCK_STEPS", 250)
    interrupt(scene, folder / "cut")
    assert call("report", folder / "cut")[0] == 0
    cut = open_run(folder / "cut")
    assert 0 < cut.steps < scene.steps
    confidence = np.concatenate([frame.detections.confidence for frame in cut.frames()])
    assert np.array_equal(confidence, cut.tables()["detections"]["confidence"].to_numpy())
    (folder / "cut" / "report.html").unlink()
    assert modsim3d.run_scene(scene, folder / "cut", resume=True).resumed_steps == 250
    assert run_files(folder / "cut") == run_files(run)


def test_frames_in_memory_are_those_of_the_run_and_names_kinds_and_counts_fit_also_of_merged_boxes(run, scene):
    table = pq.read_table(run / "detections.parquet").to_pylist()
    assert {row["kind"] for row in table} == {*KINDS} - {"on_vessel"}
    confidence = np.concatenate([frame.detections.confidence for frame in modsim3d.simulate_frames(scene)])
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
