"""A run directory opened again gives what the run had, and can be run again from its own copy."""

import json
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import ModsimError, RunDirectoryError, load_scene, open_run, run_scene, simulate_frames
from modsim3d.runs import pipeline, stored_run
from modsim3d.runs.files.stored_tables import truth_of
from modsim3d.truth.record import COLUMNS
from tests.run_folders import edited_run, interrupt
from tests.scenes import write_scene

BLOCK, STEPS = 100, 120  # two blocks


@pytest.fixture(scope="module")
def scene():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "MAX_BLOCK_STEPS", BLOCK)
        yield load_scene("simulation_3", mode=2, seed=5, steps=STEPS)


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory) -> Path:
    return run_scene(scene, tmp_path_factory.mktemp("stored") / "run").folder


def assert_same_frames(found, expected, atol=1e-9):
    for a, b in zip(found, expected, strict=True):
        for name in ("camera", "step", "timestamp", "state", "image_size_px", "scene_vessels"):
            assert getattr(a, name) == getattr(b, name)
        np.testing.assert_array_equal(a.sea_half_plane, b.sea_half_plane)
        for one, other in ((a.truth, b.truth), (a.detections, b.detections)):
            for field in fields(one):
                ours, theirs = getattr(one, field.name), getattr(other, field.name)
                if isinstance(theirs, np.ndarray):  # sides of a box that was stored as centre and size are rounded
                    np.testing.assert_allclose(ours, theirs, rtol=0, atol=atol)
                else:
                    assert ours == theirs


def test_frames_and_truth_read_back_are_those_of_the_simulation_and_of_the_steps_asked_for(scene, finished):
    run = open_run(finished)
    assert_same_frames(run.frames(), simulate_frames(scene))
    assert_same_frames(run.frames(90, 110), [frame for frame in run.frames() if 90 <= frame.step < 110])
    read = truth_of(run.finished_tables.truth(10, 120), run.scene)
    with pipeline.open_renderer(scene) as renderer:
        made = pipeline.truth_block(scene, 10, 120, renderer)
    for name in set(COLUMNS) - {"intersections"}:
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name), err_msg=name)


def test_a_step_in_two_row_groups_is_read_whole(finished, tmp_path, monkeypatch):
    folder = edited_run(finished, tmp_path / "run", files=None)
    expected = {name: open_run(finished).table(name) for name in ("frames", "truth", "detections")}
    for name, table in expected.items():
        (folder / f"{name}.parquet").unlink()
        pq.write_table(table, folder / f"{name}.parquet", row_group_size=51)  # cuts the rows of a frame apart
    run = open_run(folder)
    for name, table in expected.items():
        groups = list(run.finished_tables.by_name[name].groups())
        assert len(groups) > 3 and pa.concat_tables(groups).equals(table), name
    monkeypatch.setattr(stored_run, "ROW_GROUP_ROWS", 1000)  # about a hundred steps, no multiple of 70
    found: dict[str, list[pa.Table]] = {name: [] for name in expected}
    for first, tables in run.tables_of_steps(70):
        assert all(set(table["step"].to_pylist()) <= set(range(first, first + 70)) for table in tables.values())
        for name, table in tables.items():
            found[name].append(table)
    for name, table in expected.items():
        assert len(found[name]) == -(-STEPS // 70) and pa.concat_tables(found[name]).equals(table), name


def test_an_interrupted_run_gives_its_steps_a_replaced_one_no_mixture_an_empty_one_a_frame(scene, finished, tmp_path):
    run = open_run(interrupt(scene, tmp_path / "cut"))
    assert not run.finished and 0 < run.steps < STEPS
    assert_same_frames(run.frames(), [f for f in open_run(finished).frames() if f.step < run.steps])
    folder = shutil.copytree(finished, tmp_path / "replaced")
    frames = open_run(folder).frames()
    next(frames)
    run_scene(load_scene("simulation_3", mode=2, seed=6, steps=STEPS), folder, overwrite=True)
    with pytest.raises(RunDirectoryError, match="was replaced by another run while it was read: open it again"):
        list(frames)
    path = write_scene(tmp_path, {"boat": ([10, 4, 3], [[0, -50, 0], [10, -60, 0]])}, 1)
    run_scene(load_scene(path), tmp_path / "empty")
    (frame,) = open_run(tmp_path / "empty").frames()
    assert len(frame.truth) == len(frame.detections) == 0
    false_positives = {"model": "per_image", "rate": 2}
    detector = yaml.safe_load((tmp_path / "detector.yaml").read_text()) | {"false_positives": false_positives}
    (tmp_path / "detector.yaml").write_text(json.dumps(detector))
    with pytest.raises(ModsimError, match="as large as annotated vessels, but there are none"):
        run_scene(load_scene(path), tmp_path / "run")
    with pytest.raises(RunDirectoryError, match=r"holds an interrupted run: .* annotated vessels, but there are none"):
        open_run(tmp_path / "run").tables()


@pytest.mark.parametrize("content", [None, "", "{}", '{"scene": 3}', "[1]"])
def test_a_folder_that_is_no_run_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    with pytest.raises(RunDirectoryError, match=r"run\.json|copy of its scene"):
        open_run(tmp_path)
