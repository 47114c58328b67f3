"""`workers`: a number of processes, or `auto` for the CPUs that this process may use."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d import ModsimError, detect_run, load_scene, open_run, run_scene
from modsim3d.io.processes import MAX_WORKERS, open_workers, parse_workers, worker_count
from tests.cli.bad_input.builders import refusal
from tests.scenes import crossing


def test_auto_is_the_cpus_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    if hasattr(os, "process_cpu_count"):
        monkeypatch.setattr(os, "process_cpu_count", lambda: 3)
    else:
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 4, 5})
    assert worker_count("auto") == 3


def test_numbers_are_taken_as_they_are_and_anything_else_is_one_clear_error() -> None:
    assert [worker_count(n) for n in (1, 7, np.int64(2))] == [1, 7, 2]  # type: ignore[list-item]
    assert [parse_workers(text) for text in ("1", "16", "auto")] == [1, 16, "auto"]
    wrong: tuple[Any, ...] = (0, -1, 2.0, True, None, "2", "AUTO", "", MAX_WORKERS + 1)
    for workers in wrong:
        with pytest.raises(ModsimError, match="needs a number of processes from 1 to 1024, or 'auto'"):
            worker_count(workers)
        with pytest.raises(ModsimError, match="workers: needs a number"):
            open_workers(workers, "", open)


@pytest.mark.parametrize("command", ["run", "detect", "check repeat", "view film"])
def test_a_wrong_option_is_one_line_before_anything_is_read_or_written(call, tmp_path: Path, command: str) -> None:
    out = () if command == "check repeat" else ("--out", tmp_path / "out")
    for wrong in ("0", "-2", "1.5", "all", "Auto", "1_0", "٣", "9" * 5000, "", "1025"):
        said = refusal(call, (*command.split(), tmp_path / "any", f"--workers={wrong}", *out), wrong[:50])
        assert said.startswith("modsim3d: --workers: needs a number of processes from 1 to 1024, or 'auto' (got ")
        assert said.count("\n") == 1 and len(said) < 200
    assert not list(tmp_path.iterdir())


def test_the_option_takes_auto(call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr("modsim3d.io.processes._usable_cpus", lambda: asked.append(1) or 1)
    options = ("--workers", "auto", "--no-sheet", "--out", tmp_path / "run")
    assert call("run", crossing(tmp_path, 4), *options)[0] == 0 and asked
    asked.clear()
    assert call("check", "repeat", tmp_path / "run", "--workers", "auto")[0] == 0 and asked


def test_functions_take_auto_and_write_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("modsim3d.io.processes._usable_cpus", lambda: 2)
    scene, written = load_scene(crossing(tmp_path, 6), source="analytic"), []
    for workers in (1, "auto"):
        folders = [tmp_path / f"{workers}", tmp_path / f"{workers}_again"]
        run_scene(scene, folders[0], workers=workers)  # type: ignore[arg-type]
        detect_run(open_run(folders[0]), folders[1], seed=2, workers=workers)  # type: ignore[arg-type]
        tables = [folder / table for folder in folders for table in ("truth.parquet", "detections.parquet")]
        written.append([path.read_bytes() for path in tables])
    assert written[0] == written[1]
    with pytest.raises(ModsimError, match="workers: needs a number"):
        run_scene(scene, tmp_path / "none", workers=0)
    assert not (tmp_path / "none").exists()
