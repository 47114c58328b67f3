"""A stored run comes out the same again, and so does the detector alone over its truth; what does not is named."""

import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import InputError, RunDirectoryError, detect_run, load_scene, run_scene
from modsim3d.io.input_files import data_folder
from modsim3d.runs import run as detecting
from modsim3d.runs.repeat_run import difference, repeat_run
from modsim3d.runs.stored_run import open_run, read_finished
from tests.cli.bad_input.builders import Call, answer, refusal
from tests.run_folders import interrupt, run_files
from tests.runs.test_stream import lines, live_scene


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = load_scene("simulation_1", steps=40, seed=3, mode=1, source="analytic")
    return run_scene(scene, tmp_path_factory.mktemp("repeat") / "stored").folder


@pytest.fixture
def run(stored: Path, tmp_path: Path) -> Path:
    """A copy of the run, to be damaged."""
    return Path(shutil.copytree(stored, tmp_path / "run"))


def edited(run: Path, **changes: object) -> None:
    (run / "run.json").write_text(json.dumps({**json.loads((run / "run.json").read_text()), **changes}))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_repeats(call: Call, run: Path, workers: int) -> None:
    (run / "contact_sheet.png").write_bytes(b"not a file of the run")
    said = answer(call, ("check", "repeat", run, "--workers", workers))
    files = len(json.loads((run / "run.json").read_text())["files"]) + 1
    assert f"all {files} files are the same" in said and "made with other versions" not in said


def test_runs_of_the_detector_alone_without_the_thesis_json_and_live_ones_repeat(stored, tmp_path, monkeypatch):
    detect_run(open_run(stored), tmp_path / "other", seed=9)
    assert repeat_run(read_finished(tmp_path / "other"), tmp_path / "again").same
    run_scene(load_scene("simulation_1", steps=5, source="analytic"), tmp_path / "run", thesis_json=False)
    assert repeat_run(read_finished(tmp_path / "run"), tmp_path / "without").same
    assert [path.name for path in (tmp_path / "without").glob("*.json")] == ["run.json"]
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO("".join(lines()).encode())))
    run_scene(live_scene(tmp_path), tmp_path / "live")
    found = repeat_run(read_finished(tmp_path / "live"), tmp_path / "from_poses")
    assert found.same, found
    assert "poses.jsonl" in {file.name for file in found.files if file.is_input}


@pytest.mark.parametrize("name", ["truth.parquet", "annotations_C0.json"])
def test_one_changed_bit_is_noticed_and_named(call: Call, run: Path, name: str) -> None:
    content = bytearray((run / name).read_bytes())
    content[len(content) // 2] ^= 1
    (run / name).write_bytes(content)
    said = answer(call, ("check", "repeat", run), status=1)
    assert [line.split()[0] for line in said.splitlines() if "stored:" in line] == [name]


def test_an_older_version_is_no_error_and_runs_interrupted_incomplete_or_of_another_scene_are_told(call, run):
    edited(run, versions={"numpy": "0.1", "abacus": "3"}, backend="a plotter")
    parts = ("made with other versions", "then 0.1", "abacus", "now none", "then a plotter")
    answer(call, ("check", "repeat", run), *parts)
    (run / "frames.parquet").unlink()
    answer(call, ("check", "repeat", run), "is missing", status=1)
    (run / "scene/detector.yaml").write_text((run / "scene/detector.yaml").read_text() + "\n")
    refusal(call, ("check", "repeat", run), "is not the scene that the run was made of")
    shutil.move(run / "scene", run / "unfinished" / "scene")
    (run / "run.json").rename(run / "unfinished" / "settings.json")
    refusal(call, ("check", "repeat", run), "interrupted", kept=run)


def test_a_run_that_comes_out_otherwise_says_which_rows_and_by_how_much(call: Call, run: Path) -> None:
    table = pq.read_table(run / "detections.parquet")
    x = table["centre_x_px"].to_numpy().copy()
    x[17] += 0.5
    moved = table.set_column(table.column_names.index("centre_x_px"), "centre_x_px", pa.array(x))
    pq.write_table(moved, run / "detections.parquet", compression="zstd")
    counts = json.loads((run / "run.json").read_text())["counts"]
    edited(run, files={}, versions={"numpy": "0.1"}, counts={**counts, "missed": 12345})
    said = answer(call, ("check", "repeat", run), status=1)
    parts = "counts.missed 12345 against", "2 of ", "an older version wrote", "numpy then 0.1 now"
    for part in (f"1 of {len(table)} rows differ: centre_x_px in 1 by 0.5 at most", *parts):
        assert part in " ".join(said.split())


def test_differences_of_tables_are_told_by_column(tmp_path: Path) -> None:
    def written(file: str, **columns: object) -> Path:
        pq.write_table(pa.table(columns), tmp_path / f"{file}.parquet")
        return tmp_path / f"{file}.parquet"

    one = written("one", x=[1.0, np.nan, 3.0, None], name=["a", "b", None, "d"], n=[1, 2, 3, 4])
    other = written("other", x=[1.0, np.nan, 3.5, 7.0], name=["a", "c", None, "d"], n=[1, 2, 3, 4])
    assert difference(one, other) == "3 of 4 rows differ: x in 2 by 0.5 at most; name in 1"
    assert difference(one, written("fewer", x=[1.0], name=["a"], n=[1])) == "4 rows against 1"
    assert difference(one, written("columns", y=[1.0])) == "the columns are others"
    pq.write_table(pq.read_table(one), tmp_path / "packed.parquet", compression="zstd")
    assert difference(one, tmp_path / "packed.parquet") == "the same rows, stored in other bytes"


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


def test_a_detector_that_does_not_know_the_labels_is_refused_and_truth_of_other_versions_named(first, tmp_path):
    with pytest.raises(InputError, match="'Vessel' is not one of the detector's labels"):
        detect_run(open_run(first), tmp_path / "new", detector=DETECTORS / "three_labels.yaml")
    assert not (tmp_path / "new").exists()
    with pytest.raises(RunDirectoryError, match="choose another folder"):
        detect_run(open_run(first), first, overwrite=True)
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
