"""A stored run comes out the same again; what does not is named."""

import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from modsim3d import detect_run, load_scene, run_scene
from modsim3d.runs.repeat_run import difference, repeat_run
from modsim3d.runs.stored_run import open_run, read_finished
from tests.cli.bad_input.builders import Call, answer, refusal
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


def test_a_changed_scene_cannot_be_repeated_and_a_missing_file_is_named(call: Call, run: Path) -> None:
    (run / "frames.parquet").unlink()
    answer(call, ("check", "repeat", run), "is missing", status=1)
    (run / "scene/detector.yaml").write_text((run / "scene/detector.yaml").read_text() + "\n")
    refusal(call, ("check", "repeat", run), "is not the scene that the run was made of")


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


def test_an_older_version_alone_is_named_and_no_error(call: Call, run: Path) -> None:
    edited(run, versions={"numpy": "0.1", "abacus": "3"}, backend="a plotter")
    parts = ("made with other versions", "then 0.1", "abacus", "now none", "then a plotter")
    answer(call, ("check", "repeat", run), *parts)


def test_an_interrupted_run_is_refused(call: Call, run: Path) -> None:
    shutil.move(run / "scene", run / "unfinished" / "scene")
    (run / "run.json").rename(run / "unfinished" / "settings.json")
    refusal(call, ("check", "repeat", run), "interrupted", kept=run)


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
