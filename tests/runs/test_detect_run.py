"""The detector alone over a finished run's truth gives the bytes of a whole run with that detector and seed."""

import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import InputError, RunDirectoryError, detect_run, load_scene, open_run, run_scene
from modsim3d.io.input_files import data_folder
from modsim3d.runs import run as detecting
from tests.cli.bad_input.builders import answer, refusal
from tests.run_folders import interrupt, run_files

DETECTORS = data_folder("scenes") / "detectors"
ORIGINAL, EXPERIMENT = DETECTORS / "thesis_original.yaml", DETECTORS / "experiment_1.yaml"
STEPS = 260


def harbour(folder: Path, labels: tuple[str, ...] = ("Vessel",)) -> Path:
    """The shipped harbour, its vessels labelled in turn."""
    scene = yaml.safe_load((data_folder("scenes") / "harbour.yaml").read_text())
    for i, vessel in enumerate(scene["vessels"].values()):
        vessel["label"] = labels[i % len(labels)]
    scene["detector"] = str(DETECTORS / ("three_labels.yaml" if len(labels) == 3 else "thesis.yaml"))
    path = folder / "harbour.yaml"
    path.write_text(yaml.safe_dump(scene, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> Path:
    scene = load_scene("simulation_3", steps=STEPS, seed=5, source="analytic")
    return run_scene(scene, tmp_path_factory.mktemp("detect") / "first").folder


def test_bytes_are_those_of_a_whole_run_where_the_truth_has_no_seed(tmp_path):
    scene, keys = harbour(tmp_path), {"mode": 2, "steps": 20, "source": "analytic"}
    run_scene(load_scene(scene, **keys), tmp_path / "first")
    run_scene(load_scene(scene, **keys, seed=7, detector=EXPERIMENT), tmp_path / "whole")
    for workers in (1, 2):
        detect_run(tmp_path / "first", tmp_path / f"{workers}", detector=EXPERIMENT, seed=7, workers=workers)
        assert run_files(tmp_path / f"{workers}") == run_files(tmp_path / "whole")


def test_short_blocks_give_the_same_bytes_and_read_the_truth_once(first, tmp_path, monkeypatch):
    read, groups = pq.ParquetFile.read_row_groups, []

    def counted(file, *given, **how):
        groups.append(given)
        return read(file, *given, **how)

    monkeypatch.setattr(pq.ParquetFile, "read_row_groups", counted)
    detect_run(first, tmp_path / "whole", seed=7)
    monkeypatch.setattr(detecting, "BLOCK_VESSELS", 250)
    detect_run(first, tmp_path / "in blocks", seed=7)
    assert groups.count((range(1),)) == 2
    assert run_files(tmp_path / "in blocks") == run_files(tmp_path / "whole")


def test_bytes_are_those_of_a_whole_run_with_the_labels_of_a_confusion_matrix(tmp_path):
    scene = harbour(tmp_path, ("sailboat", "motorboat", "ferry"))
    run_scene(load_scene(scene, steps=20, seed=3, mode=1), tmp_path / "first")
    detect_run(open_run(tmp_path / "first"), tmp_path / "new", seed=11)
    run_scene(load_scene(scene, steps=20, seed=11, mode=1), tmp_path / "whole")
    assert run_files(tmp_path / "new") == run_files(tmp_path / "whole")


def test_with_drawn_poses_the_truth_stays_and_the_detector_has_a_seed_of_its_own(tmp_path):
    run_scene(load_scene("simulation_1", mode=2, seed=2, steps=STEPS), tmp_path / "first")
    detect_run(open_run(tmp_path / "first"), tmp_path / "new", detector=ORIGINAL, seed=9)
    whole = load_scene("simulation_1", mode=2, seed=2, steps=STEPS, detector=ORIGINAL, detector_seed=9)
    run_scene(whole, tmp_path / "whole")
    new = run_files(tmp_path / "new")
    assert new == run_files(tmp_path / "whole")
    assert new["annotations_C0.json"] == run_files(tmp_path / "first")["annotations_C0.json"]
    assert new["detections.parquet"] != run_files(tmp_path / "first")["detections.parquet"]


def test_with_waves_and_two_cameras_the_bytes_are_those_of_a_whole_run_or_of_the_same_without_a_seed(first, tmp_path):
    detect_run(open_run(first), tmp_path / "new", seed=9, workers=2)
    run_scene(load_scene("simulation_3", steps=STEPS, seed=5, source="analytic", detector_seed=9), tmp_path / "whole")
    assert run_files(tmp_path / "new") == run_files(tmp_path / "whole")
    assert open_run(first).scene.sha256 == open_run(first).settings["scene_sha256"]
    detect_run(open_run(first), tmp_path / "again")
    assert run_files(tmp_path / "again") == run_files(first)


def test_a_detector_that_does_not_know_the_labels_and_the_folder_of_the_run_itself_are_refused(first, tmp_path):
    with pytest.raises(InputError, match="'Vessel' is not one of the detector's labels"):
        detect_run(open_run(first), tmp_path / "new", detector=DETECTORS / "three_labels.yaml")
    assert not (tmp_path / "new").exists()
    with pytest.raises(RunDirectoryError, match="choose another folder"):
        detect_run(open_run(first), first, overwrite=True)


def test_truth_that_other_versions_made_is_named(first, tmp_path):
    (run := open_run(first)).settings["versions"] |= {"numpy": "1.0"}
    detect_run(run, tmp_path / "new")
    assert open_run(tmp_path / "new").settings["truth_versions"]["numpy"] == "1.0"


def test_the_command_writes_a_run_and_says_what_is_in_it_and_refuses_an_interrupted_one(call, first, tmp_path):
    interrupt(load_scene("simulation_1", steps=STEPS, source="analytic"), tmp_path / "cut")
    refusal(call, ("detect", tmp_path / "cut", "--out", tmp_path / "new"), "interrupted run")
    detector = tmp_path / "mine.yml"
    shutil.copy(ORIGINAL, detector)
    line = ("detect", first, "--detector", detector, "--detector-seed", 3, "--out", tmp_path / "new")
    answer(call, line, "detections")
    assert (tmp_path / "new/scene/detector.yml").read_bytes() == detector.read_bytes()
