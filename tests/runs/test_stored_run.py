"""A run directory: the columns of its tables, and opened again it gives what the run had."""

import json
import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from modsim3d import ModsimError, RunDirectoryError, StoredRun, load_scene, open_run, run_scene, simulate_frames
from modsim3d.core.boxes import centre_form, corner_form
from modsim3d.runs import pipeline, stored_run
from modsim3d.runs.files.stored_tables import truth_of
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM, COLUMNS, schema_of
from modsim3d.truth import record
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
    for name in set(record.COLUMNS) - {"intersections"}:
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


PAGE = Path(__file__).parents[2] / "docs" / "tables.md"
UNITS = {"_px": "px", "_m": "m", "_rad": "rad", "_rad_s": "rad/s", "_m_s2": "m/s²", "_s": "s"}


@pytest.mark.parametrize("table", COLUMNS)
def test_the_page_documents_every_column_and_a_unit_in_the_name_is_the_unit(table: str) -> None:
    rows = [f"| `{each.name}` | `{each.type}` | {each.unit} | {each.meaning} |" for each in COLUMNS[table]]
    section = PAGE.read_text(encoding="utf-8").partition(f"\n## {table}.parquet\n")[2].partition("\n## ")[0]
    said = [line for line in section.splitlines() if line.startswith("| `")]
    assert said == [re.sub(" +", " ", row) for row in rows]
    for column in COLUMNS[table]:
        ending = max((end for end in UNITS if column.name.endswith(end)), key=len, default="")
        assert column.unit == UNITS.get(ending, "px" if column.name == "occluded_by" else ""), column.name
        assert column.meaning and "|" not in column.meaning


def test_the_page_and_a_run_have_every_table_whose_columns_have_unit_and_description(strait_run: StoredRun) -> None:
    assert re.findall(r"^## (\w+)\.parquet$", PAGE.read_text(encoding="utf-8"), re.MULTILINE) == list(COLUMNS)
    assert {path.stem for path in strait_run.folder.rglob("*.parquet")} == set(COLUMNS)
    for table, columns in COLUMNS.items():
        written = pq.read_schema(strait_run.folder / f"{table}.parquet")
        assert written.names == [column.name for column in columns], table
        for field, column in zip(written, columns, strict=True):
            said = {key: value.decode() for key, value in field.metadata.items() if not key.startswith(b"PARQUET:")}
            assert field.type == column.type, (table, column.name)
            assert said == {b"unit": column.unit, b"description": column.meaning}


def test_corners_and_centre_are_those_of_the_thesis_file_and_iou_that_with_the_annotated_box(strait_run):
    table = pq.read_table(strait_run.folder / "detections.parquet")
    corners, centred = (np.column_stack([table[name] for name in names]) for names in (BOX_SIDES, CENTRE_FORM))
    np.testing.assert_array_equal(centred, centre_form(corners))
    np.testing.assert_allclose(corner_form(centred), corners, atol=1e-9)
    assert (corners[:, :2] < corners[:, 2:]).all()
    found = json.loads((strait_run.folder / "detections_bow.json").read_text())
    boxes = [entry["bbox"] for frame in found.values() for entry in frame.values()]
    told = sorted((b["centre"]["x"], b["centre"]["y"], b["width"], b["height"]) for b in boxes)
    assert told == sorted(map(tuple, centred[np.array(table["camera"].to_pylist()) == "bow"].tolist()))
    frames = sorted(strait_run.frames(), key=lambda frame: frame.step)
    np.testing.assert_array_equal(corners, np.concatenate([frame.detections.boxes_px for frame in frames]))
    truth, found = (pq.read_table(strait_run.folder / f"{name}.parquet") for name in ("truth", "detections"))
    place = ("camera", "step", "vessel")
    boxes = {tuple(row[key] for key in place): row for row in truth.to_pylist()}
    for row in found.to_pylist():
        if row["kind"] != "true":
            assert row["iou"] is None
            continue
        box = [row[side] for side in BOX_SIDES]
        own = [boxes[tuple(row[key] for key in place)][f"visible_{side}"] for side in BOX_SIDES]
        sides = [min(box[i + 2], own[i + 2]) - max(box[i], own[i]) for i in (0, 1)]
        common = max(sides[0], 0) * max(sides[1], 0)
        both = sum((each[2] - each[0]) * (each[3] - each[1]) for each in (box, own)) - common
        assert abs(row["iou"] - common / both) < 1e-9
    values = [value for value in found["iou"].to_pylist() if value is not None]
    assert len(values) > 100 and np.mean(values) == pytest.approx(0.87, abs=0.03)


def rewritten(run: StoredRun, folder: Path, table: pa.Table, **changes: object) -> Path:
    """A copy of a run with another table of detections, other entries in `run.json` and no list of files."""
    edited_run(run.folder, folder, files=None, **changes)
    (folder / "detections.parquet").unlink()
    pq.write_table(table, folder / "detections.parquet")
    return folder


@pytest.mark.parametrize("form", [1, 2])
def test_detections_of_the_formats_before_are_read(strait_run: StoredRun, tmp_path: Path, form: int) -> None:
    now = pq.read_table(strait_run.folder / "detections.parquet")
    former = {"centre_x_px": "x_px", "centre_y_px": "y_px"} if form == 1 else {}
    kept = [name for name in now.column_names if name != "iou" and not (name in BOX_SIDES and form == 1)]
    old = now.select(kept).rename_columns([former.get(name, name) for name in kept])
    counts = {"camera_counts": None} if form == 1 else {}
    folder = rewritten(strait_run, tmp_path / "old", old, format=form, **counts)
    again = open_run(folder).tables()["detections"]
    assert again.schema.equals(schema_of("detections"), check_metadata=True)
    for name in now.column_names:
        if name == "iou":
            assert again[name].null_count == len(again)
        elif name in BOX_SIDES:
            np.testing.assert_allclose(again[name], now[name], atol=1e-9)
        else:
            assert again[name].equals(now[name]), name
    assert len(list(open_run(folder).frames(3, 9))) == len(list(strait_run.frames(3, 9)))
