"""Each camera at its own frame rate: which steps give a frame, and that everything made of frames follows."""

import json
import math
from fractions import Fraction
from itertools import count, takewhile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from modsim3d import InputError, load_scene, open_id_renderer, open_run, run_scene, simulate_frames
from modsim3d.io.input_files import data_folder
from modsim3d.runs import pipeline
from modsim3d.runs.selection import select
from modsim3d.scene.scene import takes_frame
from modsim3d.view.films.plan import FilmPlan
from modsim3d.view.films.renderer import FilmRenderer
from modsim3d.view.report.report import write_report
from tests.run_folders import run_files
from tests.runs.test_stored_run import assert_same_frames
from tests.scenes import CAMERA_HEIGHT_M, camera_keys, write_scene
from tests.view.report.unpacking import read

STEP_S, STEPS = 0.1, 60
LENS = camera_keys(pose={"position_m": [0, 0, CAMERA_HEIGHT_M]})
BOATS = {
    "boat": ([10, 4, 3], [[0, 150, 10], [400, 150, 12]]),
    "sail": ([12, 4, 16], [[0, 120, -10], [400, 122, -10]]),
    "ship": ([60, 10, 12], [[0, 75, 60], [6, 90, -60]]),
}


def rig(folder: Path, *, detector: str = "thesis", **timing: dict[str, float]) -> Path:
    """A scene of 6 s in steps of 0.1 s, with a camera for each keyword."""
    cameras = {name: {**LENS, **keys} for name, keys in timing.items()}
    keys = {"annotation": {"mode": 2, "source": "analytic"}, "cameras": cameras}
    folder.mkdir(parents=True, exist_ok=True)
    path = write_scene(folder, BOATS, STEPS, time_step_s=STEP_S, **keys)
    if detector == "rich":
        data = yaml.safe_load((data_folder("scenes") / "detectors" / "rich.yaml").read_text())
        data["labels"], data["dropout"]["anchor"] = ["Vessel", "motorboat", "ferry"], "none"
        (folder / "detector.yaml").write_text(json.dumps(data))
    return path


def due_by_hand(step: str, steps: int, rate: str, offset: str) -> list[int]:
    """The first step at or after each due time, in exact decimals."""
    due = (Fraction(offset) + k / Fraction(rate) for k in count())
    return sorted(set(takewhile(lambda index: index < steps, (math.ceil(time / Fraction(step)) for time in due))))


@given(
    st.sampled_from(["0.1", "0.2", "0.04", "0.033", "1"]),
    st.sampled_from(["10", "5", "4", "3", "2.5", "1", "0.7", "0.1"]),
    st.sampled_from(["0", "0.3", "0.05", "0.7", "2"]),
)
def test_each_frame_is_taken_at_the_first_step_that_is_not_too_early(step, rate, offset):
    times = np.array([float(Fraction(step) * k) for k in range(400)])
    found = np.flatnonzero(takes_frame(times, float(rate), float(offset)))
    assert found.tolist() == due_by_hand(step, 400, rate, offset)


def test_no_frame_is_late_by_rounding_and_no_step_gives_two():
    # (0.3 − 0.1) · 10 is 1.9999999999999998 in binary; two frames have passed all the same.
    assert takes_frame(np.array([0.0, 0.1, 0.2, 0.3, 0.1 * 3]), 10.0, 0.1).tolist() == [False, *[True] * 3, False]
    assert takes_frame(np.arange(5) * 0.1, None, 0.2).tolist() == [False, False, True, True, True]


@pytest.mark.parametrize(("rate_hz", "offset_s"), [(None, 0), (3, 0), (0.4, 0.75), (None, 2.2)])
def test_frames_are_the_same_however_the_steps_are_asked_for(tmp_path, rate_hz, offset_s):
    scene = load_scene(rig(tmp_path, C0={"frame_rate_hz": rate_hz, "start_offset_s": offset_s}))
    (camera,) = scene.cameras
    whole = scene.frame_steps(camera, 0, STEPS)
    for size in (1, 7):
        parts = [scene.frame_steps(camera, first, min(first + size, STEPS)) for first in range(0, STEPS, size)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    for stop in range(STEPS + 1):
        before = whole[whole < stop]
        assert scene.last_frame(camera, stop) == (before[-1] if len(before) else None)


SLOW = due_by_hand("0.1", STEPS, "4", "0.75")


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    scene = rig(folder, fast={}, slow={"frame_rate_hz": 4, "start_offset_s": 0.75})
    return run_scene(load_scene(scene), folder / "run").folder


@pytest.mark.parametrize("detector", ["thesis", "rich"])
def test_a_slow_cameras_frames_are_those_of_a_fast_one_and_blocks_change_nothing(tmp_path, detector, monkeypatch):
    slow = load_scene(rig(tmp_path / "slow", detector=detector, C0={"frame_rate_hz": 2.5}, C1={}))
    fast = load_scene(rig(tmp_path / "fast", detector=detector, C0={}, C1={}))
    taken = set(slow.frame_steps(slow.cameras[0], 0, STEPS).tolist())
    expected = [frame for frame in simulate_frames(fast) if frame.camera == "C1" or frame.step in taken]
    assert_same_frames(simulate_frames(slow), expected, atol=0)
    cameras = {"C0": {"frame_rate_hz": 2.5, "start_offset_s": 1.0}, "C1": {"frame_rate_hz": 4, "start_offset_s": 0.7}}
    scene = load_scene(rig(tmp_path, detector=detector, **cameras))
    run_scene(scene, tmp_path / "whole")
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 1)  # the first have no frame of any camera
    run_scene(scene, tmp_path / "single")
    assert run_files(tmp_path / "single") == run_files(tmp_path / "whole")


def test_a_cameras_files_hold_its_own_frames_and_films_and_reports_show_the_last_one_once(finished, tmp_path):
    run = open_run(finished)
    assert_same_frames(run.frames(), simulate_frames(run.scene))
    scene = open_run(finished).scene
    for first, stop, steps, previous_s in ((12, 20, [13, 15, 18], 1.0), (0, 8, [], -math.inf)):
        _, slow = pipeline.detector_inputs(scene, pipeline.truth_block(scene, first, stop, None), first, stop)
        assert slow.frames.steps.tolist() == steps and slow.frames.previous_s == pytest.approx(previous_s)
    assert SLOW[:4] == [8, 10, 13, 15]
    frames, truth = (pq.read_table(finished / f"{name}.parquet").to_pylist() for name in ("frames", "truth"))
    steps = {camera: [row["step"] for row in frames if row["camera"] == camera] for camera in ("slow", "fast")}
    assert steps == {"slow": SLOW, "fast": list(range(STEPS))}
    assert {row["step"] for row in truth if row["camera"] == "slow"} <= set(SLOW)
    for kind in ("annotations", "detections"):
        slow, fast = (json.loads((finished / f"{kind}_{camera}.json").read_text()) for camera in ("slow", "fast"))
        assert (list(slow), len(fast)) == ([f"{step / 10}" for step in SLOW], STEPS)
    counts = json.loads((finished / "run.json").read_text())["counts"]
    assert counts["frames"] == STEPS + len(SLOW)
    assert counts["detected"] == sum(row["n_detected"] for row in frames)
    run = open_run(finished)
    for first in (0, 7, 9, 20):
        for shown in select(run, (0, 1), from_s=first / 10).step_frames():
            fast, slow = shown.frames
            assert fast.step == shown.step
            before = [step for step in SLOW if step <= shown.step]
            assert (slow and slow.step) == (before[-1] if before else None)
    right = {}  # the slow camera's picture, below its title
    with open_id_renderer(run.scene) as id_renderer:
        film = FilmRenderer(run.scene, FilmPlan(("detections",), (0, 1), 640), id_renderer)
        for shown in select(run, (0, 1), to_s=1.0).step_frames():
            right[shown.step] = np.array(film.draw(shown))[60:200, 330:]
    np.testing.assert_array_equal(right[8], right[9])
    assert np.any(right[9] != right[10])
    assert np.ptp(right[7].reshape(-1, 3), axis=0).max() == 0  # nothing yet
    whole, thinned = (read(write_report(run, tmp_path / f"{every}.html", every)) for every in (1, 3))
    assert whole.taken[:, 0].tolist() == list(range(STEPS)) and whole.taken[:11, 1].tolist() == [-1] * 8 + [8, 8, 10]
    assert whole.stored == STEPS + len(SLOW) + 1  # and one for no frame yet
    assert whole.shown.max() == STEPS + len(SLOW) - 1
    shown, rows = whole.shown[:, 1], np.diff(whole.columns["truthStart"])
    assert shown[7] == -1 and shown[9] == shown[8] != shown[10]
    truth = pq.read_table(finished / "truth.parquet").to_pylist()
    for step, camera in ((9, 8), (30, 30)):
        assert rows[shown[step]] == sum(row["camera"] == "slow" and row["step"] == camera for row in truth)
    assert thinned.taken[3:5].tolist() == [[9, 8], [12, 10]]
    assert f'<td>Frames</td><td class="number">{STEPS + len(SLOW)}</td>' in (tmp_path / "3.html").read_text()


def test_a_rate_or_offset_that_the_scene_cannot_give_is_refused(tmp_path):
    for keys, says in (
        ({"frame_rate_hz": 25}, r"cameras\.C0\.frame_rate_hz: 25 frames a second .* steps of 0\.1 s give: at most 10"),
        ({"start_offset_s": 6.0}, r"cameras\.C0\.start_offset_s: the scene ends 5\.9 s .* no frame would be taken"),
        ({"frame_rate_hz": 0}, r"cameras\.C0\.frame_rate_hz"),
        ({"start_offset_s": -1}, r"cameras\.C0\.start_offset_s"),
    ):
        with pytest.raises(InputError, match=says):
            load_scene(rig(tmp_path, C0=keys))


def test_box_errors_have_the_correlation_time_asked_for_at_any_frame_rate(tmp_path):
    """e^(−Δt/τ) from frame to frame, with the camera's own Δt, through the whole pipeline (docs/detector.md)."""
    tau, steps, boats = 0.9, 1500, 16
    lying = {f"v{i}": ([10, 6, 5], [[0, 200, 5.0 * i - 40], [1e4, 201, 5.0 * i - 40]]) for i in range(boats)}
    cameras = {"fast": LENS, "slow": {**LENS, "frame_rate_hz": 2}}
    keys = {"annotation": {"mode": 0, "source": "analytic"}, "cameras": cameras}
    path = write_scene(tmp_path, lying, steps, time_step_s=STEP_S, **keys)
    state = {
        "confusion": [[1.0], [0.0]],
        "false_positive_labels": [1.0],
        "false_discovery_rate": 0.0,
        "box_error": {"unit": "px", "mean": [0] * 4, "covariance": (4 * np.eye(4)).tolist()},
        "confidence": {"mean": 0.67, "std": 0.1},
    }
    detector = {
        "labels": ["Vessel"], "confidence_threshold": 0.2, "initial_state": "one", "transition_matrix": [[1.0]],
        "false_positives": {"model": "calibrated"}, "persistence": {"box_s": tau}, "states": {"one": state},
    }  # fmt: skip
    (tmp_path / "detector.yaml").write_text(json.dumps(detector))
    run_scene(load_scene(path), tmp_path / "run")
    order = [("vessel", "ascending"), ("step", "ascending")]
    table = pq.read_table(tmp_path / "run/detections.parquet").sort_by(order)
    for camera, interval in (("fast", 0.1), ("slow", 0.5)):
        ours = table["camera"].to_numpy(zero_copy_only=False) == camera
        errors = table["e_x_px"].to_numpy()[ours].reshape(boats, -1)
        assert errors.shape[1] == round(steps * STEP_S / interval)
        kept = math.exp(-interval / tau)
        standard_error = math.sqrt((1 - kept**2) / errors.size)  # of a first-order process, known variance aside
        correlation = np.mean(errors[:, 1:] * errors[:, :-1]) / np.mean(errors**2)
        assert abs(correlation - kept) < 4 * standard_error
