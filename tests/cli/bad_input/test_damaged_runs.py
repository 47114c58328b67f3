"""A run directory that was damaged is refused by every command that reads runs: one error, and nothing is written."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from modsim3d.core.errors import RunDirectoryError
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import ASHORE, Call, lens, refusal
from tests.cli.bad_input.writers import scene_file
from tests.run_folders import interrupt
from tests.scenes import write_scene

STEPS = 24
TABLES = ("frames", "truth", "detections", "ownship")


def write_run(folder: Path, seed: int) -> Path:
    boats = {f"boat{i}": [[0, 50 + 20 * i, -9 + 3 * i], [12, 60 + 15 * i, 9 - 3 * i]] for i in range(4)}
    size = {"length_m": 14.0, "beam_m": 4.0, "air_draft_m": 3.0, "label": "motorboat"}
    bow = lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 1.0]})
    cameras = {"bow": bow, "shore": lens(pose=ASHORE, frame_rate_hz=1)}
    traffic = {"vessels": dict.fromkeys((*boats, "own"), size)}
    traffic["poses"] = {"tracks": {"own": [[0, 0, 0], [12, 12, 0]], **boats}}
    keys = {"time_step_s": 0.5, "annotation": {"mode": 2, "source": "analytic"}, "detector": "rich", "seed": seed}
    folder.mkdir()
    run_scene(load_scene(write_scene(folder, {}, STEPS, **traffic, cameras=cameras, **keys)), folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A good run, and one of the same scene with another seed."""
    folder = tmp_path_factory.mktemp("runs")
    return write_run(folder / "good", 0), write_run(folder / "other", 1)


@pytest.fixture
def run(runs: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of the good run."""
    return Path(shutil.copytree(runs[0], tmp_path / "run"))


def read(run: Path, name: str) -> pa.Table:
    return pq.read_table(run / f"{name}.parquet")


def relist(run: Path) -> None:
    """Let `run.json` list the files as they are now, so that only their content can be wrong."""
    files = json.loads((run / "run.json").read_text())["files"]
    data = {name: (run / name).read_bytes() for name in files if (run / name).is_file()}
    listed = {name: {"bytes": len(each), "sha256": hashlib.sha256(each).hexdigest()} for name, each in data.items()}
    change_settings(run, files=files | listed)


def replace_table(run: Path, name: str, table: pa.Table) -> None:
    pq.write_table(table, run / f"{name}.parquet")
    relist(run)


def commands(run: Path, out: Path) -> dict[str, tuple[object, ...]]:
    return {
        "picture": ("view", "frame", run, 0, "--out", out / "picture.png"),
        "film": ("view", "film", run, "--kind", "detections", "--end", 2, "--out", out / "film.gif"),
        "sheet": ("view", "sheet", run, "--overwrite"),
        "report": ("report", run, "--out", out / "report.html"),
        "verify": ("check", "run", run, "--out", out / "verified"),
        "learn": ("learn", run, "--out", out / "detector.yaml", "--replicates", 20, "--no-check"),
        "export": ("export", run, "--format", "coco", "--out", out / "coco"),
        "detect": ("detect", run, "--out", out / "run"),
        "rerun": ("export", run, "--format", "rerun", "--out", out),
    }


READERS = tuple(commands(Path(), Path()))
WHOLE_READERS = ("report", "verify", "learn", "export", "rerun")
"""Those that read all rows of all tables."""


def assert_refused(call: Call, run: Path, command: str, out: Path) -> str:
    out.mkdir(exist_ok=True)
    said = refusal(call, commands(run, out)[command], kept=run)
    assert said.count("modsim3d: ") == 1 and not any(out.rglob("*"))
    return said


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("name", TABLES)
def test_a_missing_table_is_one_clear_line(call, run, tmp_path, command, name):
    (run / f"{name}.parquet").unlink()
    assert f"{name}.parquet is missing: " in assert_refused(call, run, command, tmp_path / "out")


WRONG = {  # table, column, row, value, part of the message
    "a camera that is unknown": ("truth", "camera", 3, "stern", "row 3, column 'camera': must be one of bow, shore"),
    "a camera that is null": ("detections", "camera", 3, None, "row 3, column 'camera': must be one of bow, shore"),
    "a step beyond the last": ("truth", "step", -1, 10**9, f"column 'step' has 1000000000.* steps 0 to {STEPS - 1}"),
    "a step below 0": ("detections", "step", 0, -1, "column 'step' has -1"),
    "a step that is null": ("truth", "step", 3, None, "row 3, column 'step': must be there"),
    "a step out of order": ("truth", "step", 3, 9, "column 'step': must be in ascending order"),
    "another time": ("frames", "timestamp", 0, "7.0", "row 0, column 'timestamp': must be '0.0'"),
    "an unknown state": ("frames", "state", 1, "hail", "row 1, column 'state': must be one of "),
    "another state": ("frames", "state", 0, "haze", "column 'state': must be that of the frame in frames.parquet"),
    "an unknown vessel": ("truth", "vessel", 2, "kayak", "row 2, column 'vessel': must be one of boat0, boat1"),
    "another label": ("truth", "label", 2, "ferry", "row 2, column 'label'"),
    "no full box": ("truth", "full_x_min_px", 2, None, "row 2, column 'full_x_min_px': must be a number"),
    "a box in NaN": ("truth", "full_x_min_px", 2, float("nan"), "column 'full_x_min_px': must be a number"),
    "a swapped box": ("truth", "full_x_max_px", 2, 0.0, "column 'full_x_max_px': must be at least full_x_min_px"),
    "a box outside": ("truth", "full_y_max_px", 2, 1e300, "column 'full_y_max_px': must be from 0 to 480"),
    "half a box": ("truth", "visible_x_min_px", 0, None, "like the other sides of the box, or null"),
    "more seen than there is": ("truth", "visible_px", 0, 1e9, "row 0, column 'visible_px': must be from 0 to "),
    "a fraction above 1": ("truth", "visible_fraction", 0, 2.0, "row 0, column 'visible_fraction'"),
    "an infinite depth": ("truth", "depth_m", 0, float("inf"), "row 0, column 'depth_m'"),
    "a null list": ("truth", "occluded_by", 0, None, "row 0, column 'occluded_by': must be there"),
    "an unknown occluder": ("truth", "occluded_by", 0, [{"id": "kayak", "px": 1.0}], "row 0, column 'occluded_by'"),
    "an occluder's null": ("truth", "occluded_by", 0, [None], "row 0, column 'occluded_by'"),
    "an occluder's pixels": ("truth", "occluded_by", 0, [{"id": "own", "px": None}], "with numbers of pixels"),
    "no flag": ("truth", "annotated", 0, None, "row 0, column 'annotated': must be there"),
    "a detection's number": ("detections", "detection", 0, 7, "row 0, column 'detection': must be the number"),
    "an unknown label": ("detections", "label", 0, "kayak", "row 0, column 'label': must be one of sailboat"),
    "an unknown kind": ("detections", "kind", 0, "phantom", "row 0, column 'kind': must be one of true"),
    "a confidence above 1": ("detections", "confidence", 0, 1.5, "row 0, column 'confidence': must be from 0 to 1"),
    "a negative width": ("detections", "width_px", 0, -3.0, "row 0, column 'width_px': must be from 0 to 640"),
    "a corner outside": ("detections", "x_max_px", 0, 1e300, "row 0, column 'x_max_px': must be from 0 to 640"),
    "no corner": ("detections", "y_min_px", 1, None, "row 1, column 'y_min_px': must be a number"),
    "the centre of another box": ("detections", "centre_x_px", 0, 0.5, "column 'centre_x_px': must be that of the box"),
    "the height of another box": ("detections", "height_px", 0, 1.0, "column 'height_px': must be that of the box"),
    "half an error": ("detections", "e_x_px", 0, float("inf"), "row 0, column 'e_x_px'"),
    "a wrong count": ("frames", "n_false", 0, 99, "row 0, column 'n_false': must be the number in "),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_value_is_named_with_its_file_row_and_column(run, wrong):
    name, column, row, value, message = WRONG[wrong]
    table = read(run, name)
    values, place = table[column].to_pylist(), table.column_names.index(column)
    values[row] = values[row] + value if wrong.endswith("another box") else value
    replace_table(run, name, table.set_column(place, column, pa.array(values, table[column].type)))
    with pytest.raises(RunDirectoryError, match=rf"{name}\.parquet|frames\.parquet") as refused:
        open_run(run).tables()
    refused.match(message)
    with pytest.raises(RunDirectoryError):
        list(open_run(run).frames())


def test_the_good_run_is_read_by_every_command_and_one_with_a_changed_table_by_none(call, run, tmp_path, runs):
    (tmp_path / "good").mkdir()
    for command in commands(run, tmp_path / "good").values():
        assert call(*command)[0] in (0, 1), command  # 1: so few steps need not obey
    table, files = read(run, "truth"), json.loads((run / "run.json").read_text())["files"]
    depth = pa.array([value + 1 for value in table["depth_m"].to_pylist()])
    replace_table(run, "truth", table.set_column(table.column_names.index("depth_m"), "depth_m", depth))
    files["truth.parquet"]["bytes"] = (run / "truth.parquet").stat().st_size
    change_settings(run, files=files)
    for command in ("verify", "detect", "export", "report"):
        said = assert_refused(call, run, command, tmp_path / "out")
        assert "truth.parquet was changed after the run" in said
    shutil.copy(runs[1] / "detections.parquet", run)  # a table of another run
    with pytest.raises(RunDirectoryError, match=r"detections\.parquet has \d+ bytes, and had \d+"):
        open_run(run)
    relist(run)
    with pytest.raises(RunDirectoryError, match=r"by the counts of run\.json"):
        open_run(run)


@pytest.mark.parametrize("name", TABLES[:3])
def test_a_damaged_table_is_one_error(call, run, tmp_path, name):
    table = read(run, name)
    backwards = table.take(pa.array(range(len(table))[::-1]))
    damages = {"backwards": backwards, "twice": pa.concat_tables([table, table]), "without a row": table.slice(1)}
    for place, column in enumerate(table.column_names):
        if column != "iou":  # which runs before it lack
            damages[f"without {column}"] = table.remove_column(place)
        for kind in {pa.int32(), pa.string(), pa.null()} - {table[column].type}:
            damages[f"{column} as {kind}"] = table.set_column(place, column, pa.nulls(len(table), kind))
    for what, damaged in damages.items():
        replace_table(run, name, damaged)
        with pytest.raises(RunDirectoryError, match=r"is not what a run has written|by the counts of run\.json"):
            open_run(run).tables()
            pytest.fail(what)
    (run / f"{name}.parquet").write_bytes((run / f"{name}.parquet").read_bytes()[:-9])
    relist(run)
    for command in WHOLE_READERS:
        assert "is not what a run has written" in assert_refused(call, run, command, tmp_path / "out")


def change_settings(run: Path, **entries: Any) -> None:
    settings = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(settings | entries))


def test_a_run_file_that_no_run_has_written_is_refused(call, run, tmp_path):
    files = json.loads((run / "run.json").read_text())["files"]
    for name in ("9" * 5000, "é" * 200, "truth/" * 50):  # no file can have it
        change_settings(run, files=files | {name: {"bytes": 1, "sha256": "0" * 64}})
        said = assert_refused(call, run, "verify", tmp_path / "out")
        assert ("no path in a run directory" in said or "is missing" in said) and len(said) < 2000, name
    for text in ("", "{", "[1]", '{"scene": "scene", "scene": 2}', "\x00", '{"scene": "../run"}'):
        (run / "run.json").write_text(text)
        said = assert_refused(call, run, "verify", tmp_path / "out")
        assert "run.json is not what a run has written" in said, text


def test_settings_of_another_type_or_scene_are_refused(run):
    settings = json.loads((run / "run.json").read_text())
    wrong = {name: [float("nan")] for name in settings.keys() - {"truth_versions", "files"}}
    told = [(name, value, "is not what a run has written") for name, value in wrong.items()]
    wrong = {"seed": 7, "steps": 7, "cameras": ["bow"], "annotation": {"mode": 1}, "detector_seed": 7}
    other = r"run\.json: {}.* is .* in the run's copy of its scene"
    for name, value, said in told + [(name, value, other.format(name)) for name, value in wrong.items()]:
        (run / "run.json").write_text(json.dumps(settings | {name: value}))
        with pytest.raises(RunDirectoryError, match=said):
            open_run(run).tables()
            pytest.fail(name)


def test_a_changed_copy_of_the_scene_is_refused(call, run, tmp_path):
    scene = scene_file(run)
    scene.write_text(scene.read_text().replace('"time_step_s": 0.5', '"time_step_s": 0.25'))
    relist(run)
    assert "scene is not the scene that the run was made of" in assert_refused(call, run, "export", tmp_path / "out")
    scene.unlink()
    assert f"{scene.name} is missing" in assert_refused(call, run, "film", tmp_path / "out")


def test_an_interrupted_run_whose_settings_are_damaged_is_refused(call, tmp_path, runs):
    interrupt(load_scene(runs[0].parent / "scene.yaml"), tmp_path / "run")
    work = tmp_path / "run" / "unfinished"
    assert open_run(tmp_path / "run").steps == STEPS
    (work / "scene" / "more.txt").write_text("")
    assert "is not the scene" in assert_refused(call, tmp_path / "run", "report", tmp_path / "out")
    (work / "settings.json").write_text('{"scene": "scene"}')
    assert "settings.json is not what" in assert_refused(call, tmp_path / "run", "report", tmp_path / "out")
