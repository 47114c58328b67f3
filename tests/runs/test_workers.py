"""The same bytes with several processes, in blocks of any size and on an older processor; a dead process is told."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.campaigns.platforms import Platform, campaign, markdown, platforms
from modsim3d import load_scene, run_scene
from modsim3d.cli.shared import Stopped, interrupt_again, stoppable
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.camera_poses import camera_R_parent
from modsim3d.runs import pipeline, workers
from modsim3d.runs.pipeline import Simulation, block_ranges, truth_block
from modsim3d.truth.record import COLUMNS, concatenate
from tests.run_folders import run_files, wait_for
from tests.scenes import outlines_of, vessel


def test_two_workers_write_the_bytes_of_one(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", BLOCK_STEPS)
    for count in (1, 2):
        run_scene(load_scene("harbour", steps=35), tmp_path / str(count), workers=count)
    assert run_files(tmp_path / "1") == run_files(tmp_path / "2")


BLOCK_STEPS = 10
SHORT_BLOCKS = f"import modsim3d.runs.pipeline as pipeline; pipeline.MAX_BLOCK_STEPS = {BLOCK_STEPS}"
STALLING_WORKER = f"""
import os, time
import modsim3d.runs.workers as workers
from modsim3d.cli import main as cli
{SHORT_BLOCKS}
main, make = os.getpid(), workers.truth_block

def in_the_main_process(*arguments):
    if os.getpid() != main:
        time.sleep(600)
    return make(*arguments)

workers.truth_block = in_the_main_process  # also in the worker, which is a copy of the process
cli.main()
"""


def started(command, **environment):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **pipes, env={**os.environ, **environment})


def test_worker_that_dies_fails_the_run_with_one_error_and_loses_no_finished_block(tmp_path, monkeypatch):
    command = [sys.executable, "-c", STALLING_WORKER, "run", "simulation_2", "--no-sheet", "--steps", "55"]
    single = {"OPENBLAS_NUM_THREADS": "1", "JE_ARROW_MALLOC_CONF": "background_thread:false"}
    running = started([*command, "--workers", "2", "--out", tmp_path / "run"], **single)
    parts = tmp_path / "run" / "unfinished"
    wait_for(lambda: list(parts.glob("truth_*.npz")) or running.poll() is not None)
    (worker,) = Path(f"/proc/{running.pid}/task/{running.pid}/children").read_text().split()
    os.kill(int(worker), signal.SIGKILL)
    _, said = running.communicate(timeout=90)
    assert running.returncode == 2 and said.count("a worker process died") == 1 and "Traceback" not in said
    kept = {path.name: path.read_bytes() for path in parts.glob("truth_*.npz")}
    assert kept
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", BLOCK_STEPS)
    scene = load_scene("simulation_2", steps=55)
    resumed = run_scene(scene, tmp_path / "run", resume=True)
    ranges = [name.removesuffix(".npz").split("_")[1:] for name in kept]
    assert resumed.resumed_steps == sum(int(stop) - int(first) for first, stop in ranges)
    run_scene(scene, tmp_path / "whole")
    assert run_files(tmp_path / "run") == run_files(tmp_path / "whole")


def test_workers_without_a_renderer_say_what_one_process_says_and_an_interrupted_one_how_to_go_on(prepared, tmp_path):
    said = []
    how = {"capture_output": True, "text": True, "timeout": 60, "env": {**os.environ, "MODSIM3D_GL": "nonsense"}}
    for count in ("1", "2"):
        command = [prepared, "run", "harbour", "--no-sheet", "--steps", "5", "--workers", count]
        done = subprocess.run([*command, "--out", tmp_path / count], check=False, **how)
        assert done.returncode == 2
        said.append([line for line in done.stderr.splitlines() if line.startswith("modsim3d:")])
    assert said[0] == said[1] and len(said[0]) == 1
    # A scene of many blocks, so that it cannot be done before this process has seen the first of them.
    command = [prepared, "run", "simulation_2", "--no-sheet", "--set", "annotation.render=full"]
    (tmp_path / "first.py").write_text(SHORT_BLOCKS)
    running = started([*command, "--out", tmp_path / "run"], FIRST=str(tmp_path / "first.py"))
    wait_for(lambda: list((tmp_path / "run" / "unfinished").glob("truth_*.npz")) or running.poll() is not None)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130 and "go on with --resume" in said and "Traceback" not in said


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), Stopped(signal.SIGTERM)])
def test_an_interrupt_that_python_drops_while_an_object_is_finalised_comes_again(stop, monkeypatch):
    monkeypatch.setattr(sys, "unraisablehook", interrupt_again)
    finalised = type("Finalised", (), {"__del__": lambda _: (_ for _ in ()).throw(stop)})()
    with pytest.raises(type(stop)), stoppable():
        del finalised
        time.sleep(9)


def test_script_without_a_main_guard_runs_once(tmp_path):
    script = tmp_path / "script.py"
    # The scene takes more bytes than a pipe holds: what nobody reads would be waited for.
    script.write_text(
        "from modsim3d import load_scene, run_scene\nprint('begins')\n"
        f"run_scene(load_scene('fairway', steps=5), {str(tmp_path / 'run')!r}, workers=2)\n"
    )
    # As a user has it: with the threads of the libraries, so that workers cannot be copies of the process.
    single = ("OPENBLAS_NUM_THREADS", "JE_ARROW_MALLOC_CONF")
    environment = {name: value for name, value in os.environ.items() if name not in single}
    how = {"capture_output": True, "text": True, "timeout": 60, "env": environment}
    done = subprocess.run([sys.executable, script], check=False, **how)
    assert (done.returncode, done.stdout) == (0, "begins\n"), done.stderr
    assert (tmp_path / "run" / "run.json").exists()


@pytest.mark.parametrize("count", [0, 1, 400])
@pytest.mark.parametrize("distinct_keys", [3, 10_000])
def test_the_sample_keeps_the_boxes_with_the_least_keys_of_each_state(count, distinct_keys):
    rng = np.random.default_rng(count)
    rows = np.column_stack([rng.integers(0, distinct_keys, count), *rng.integers(0, 3, (6, count))]) / 1.0
    ordered = sorted(rows.tolist(), key=lambda row: (row[1], row[0], row[2:]))
    plain = [row for state in range(3) for row in [r for r in ordered if r[1] == state][: workers.BOXES_A_STATE]]
    assert workers._least(rows).tolist() == plain


OLDEST = next(platform for platform in platforms([]) if platform.name == "all of a processor without AVX")


def page(row: dict[str, Any]) -> str:
    return markdown({"platforms": [row], "scenes": [], "steps": 1, "reference": "", "files": 1})


def test_an_older_processor_gives_the_same_files_in_waves_the_same_detections_and_another_seed_is_noticed(tmp_path):
    compared = [Platform("here"), OLDEST, Platform("another seed", options=("--detector-seed", "8"))]
    older, other = campaign(compared, ["simulation_1", "strait"], 12, tmp_path)
    assert (older["platform"], older["variables"]) == (OLDEST.name, OLDEST.variables)
    assert "simulation_1" not in older["differs"] and "simulation_1" not in page(older)
    assert not [name for name in older["differs"].get("strait", {}) if name.startswith(("detections", "frames"))]
    assert set(other["differs"]["simulation_1"]) >= {"detections.parquet", "detections_C0.json"}
    assert "detections.parquet" in page(other)


STEPS = 14
SCENES = {"harbour": {}, "simulation_1": {"sea": "curved"}, "simulation_3": {}, "strait": {}}
"""Shipped scenes, with settings; the strait has obstacles, and cameras of rates of their own."""


@pytest.mark.parametrize("source", ["rendered", "analytic", "rectangles"])
@pytest.mark.parametrize("name", SCENES)
def test_truth_and_detections_are_the_same_bits_in_blocks_of_one_step_and_of_many(name, source, renderer):
    scene = load_scene(name, mode=2, source=source, steps=STEPS, settings=SCENES[name])
    truths, boxes = [], []
    for size in (1, 7, STEPS):
        simulation, parts, found = Simulation(scene, TargetStatistics()), [], []
        for first, stop in block_ranges(STEPS, size):
            truth = truth_block(scene, first, stop, renderer)
            parts += [truth.take(truth.step == step) for step in range(first, stop)]
            block = simulation.detect(truth, first, stop)
            found.append([(part.detections.boxes_px, part.detections.confidence) for part in block.cameras])
        truths.append(concatenate(parts))
        boxes.append([np.concatenate([part[camera][i] for part in found]) for camera in range(len(scene.cameras))
                      for i in range(2)])  # fmt: skip
    for other in (1, 2):
        for column in COLUMNS:
            np.testing.assert_array_equal(getattr(truths[0], column), getattr(truths[other], column), column)
        np.testing.assert_equal(boxes[0], boxes[other])


def test_one_horizon_and_one_silhouette_are_the_same_bits_as_among_many():
    rng = np.random.default_rng(3)
    rotations = camera_R_parent(*rng.normal(0, 0.2, (3, 200)))
    lens = Intrinsics((2855.4, 2855.4), (1232.0, 1028.0), (2464, 2056), skew=3.0)
    alone = [lens.sea_half_plane(rotations[step]) for step in range(200)]
    np.testing.assert_array_equal(lens.sea_half_plane(rotations), alone)
    places = [((rng.uniform(50, 500), rng.uniform(-20, 20)), rng.uniform(-np.pi, np.pi)) for _ in range(15)]
    boats = [(vessel(f"v{i}"), *place) for i, place in enumerate(places)]
    together, alone = outlines_of(boats), [outlines_of([boat]) for boat in boats]
    assert len(together) == 15
    (part,) = together.parts
    np.testing.assert_array_equal(part.vertices_px, np.concatenate([one.parts[0].vertices_px for one in alone]))
    for name in ("areas_px", "boxes_px", "depth_m", "in_frame_fraction"):
        np.testing.assert_array_equal(getattr(together, name), np.concatenate([getattr(one, name) for one in alone]))
