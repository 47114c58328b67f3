"""The outcome of each detection: what it means, and that rows, frames and counts agree on it, also by camera."""

import json
from collections import Counter, defaultdict
from dataclasses import asdict, replace

import numpy as np
import pytest

from modsim3d import RunDirectoryError, RunRows, load_scene, open_run, run_scene, simulate_frames
from modsim3d.core.boxes import iou
from modsim3d.runs.counts import Outcome, frame_outcomes, having, outcomes
from modsim3d.runs.frames import detected_rows
from tests.run_folders import edited_run
from tests.scenes import mistaken_strait

VESSEL = [100.0, 100.0, 120.0, 110.0]
BAD, OFF = Outcome.BELOW_HALF_IOU, Outcome.BELOW_HALF_IOU | Outcome.OFF_VESSEL


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    far_off = {f"detector.states.{state}.box_error.covariance": np.diag([4000.0] * 4) for state in ("clear", "haze")}
    return load_scene(mistaken_strait(tmp_path_factory.mktemp("scene")), settings=far_off)


@pytest.fixture(scope="module")
def result(scene, tmp_path_factory):
    return run_scene(scene, tmp_path_factory.mktemp("outcomes") / "run")


@pytest.fixture(scope="module")
def run(result):
    return open_run(result.folder)


def test_a_box_is_right_bad_or_off_its_vessel_by_iou_and_of_a_false_positive_nothing_else_is_said():
    for box, expected in (
        (VESSEL, 0),
        ([100, 100, 110, 110], 0),  # IoU is 0.5: not below it
        ([100, 100, 109.9, 110], BAD),
        ([119.9, 109.9, 140, 120], BAD),
        ([120, 100, 140, 110], OFF),  # the boxes share an edge only
        ([300, 100, 320, 110], OFF),
    ):
        for mislabelled, flag in ((False, 0), (True, Outcome.MISLABELLED)):
            (found,) = outcomes(np.array([False]), np.array([mislabelled]), np.array([box]), np.array([VESSEL]))
            assert found == expected | flag, box
    yes, nothing = np.array([True]), np.full((1, 4), np.nan)
    assert outcomes(yes, yes, np.array([VESSEL]), nothing).tolist() == [Outcome.FALSE_POSITIVE]


def test_rows_and_frames_agree_and_outcomes_of_every_kind_sum_to_the_counts_of_the_run(run):
    rows = RunRows.of(run)
    assert [outcome for frame in run.frames() for outcome in frame_outcomes(frame)] == rows.outcomes.tolist()
    vessels = rows.truth_vessel[rows.detected_row[rows.detected_row >= 0]]
    of_frames = [frame.truth.vessels[row] for frame in run.frames() for row in detected_rows(frame) if row is not None]
    assert [run.scene.vessel_names[vessel] for vessel in vessels] == of_frames
    kinds = set(run.tables()["detections"]["kind"].to_pylist())
    assert kinds >= {"duplicate", "merged", "split", "fragment", "false_positive"}
    names = ("false_positives", "mislabelled", "below_half_iou", "off_vessel")
    sums = [having(rows.outcomes, flag).sum() for flag in Outcome]
    assert sums == [run.settings["counts"][name] for name in names] and min(sums) > 5


def test_a_second_box_of_a_vessel_is_a_false_positive_and_so_is_all_in_a_frame_without_vessels(run):
    seconds = 0
    for frame in run.frames():
        of_frame = zip(frame.detections.kinds, frame.detections.vessels, frame_outcomes(frame), strict=True)
        for kind, vessel, outcome in of_frame:
            if kind in ("duplicate", "fragment"):
                assert vessel is not None and outcome == Outcome.FALSE_POSITIVE
                seconds += 1
    assert seconds
    frame = next(frame for frame in run.frames() if "false_positive" in frame.detections.kinds)
    truth = replace(frame.truth, vessels=(), labels=())
    detections = replace(frame.detections, vessels=(None,) * len(frame.detections))
    assert set(frame_outcomes(replace(frame, truth=truth, detections=detections))) == {Outcome.FALSE_POSITIVE}


def counted(frame):
    truth, found = frame.truth, frame.detections
    of_vessel = dict(zip(truth.vessels, range(len(truth)), strict=True))
    mine = [i for i in range(len(found)) if found.kinds[i] in ("true", "merged", "split")]
    rows = [of_vessel[found.vessels[i]] for i in mine]
    overlaps = [float(iou(found.boxes_px[i], truth.boxes_px[row])) for i, row in zip(mine, rows, strict=True)]
    return {
        "frames": 1,
        "annotated": int(truth.annotated.sum()),
        "detected": int(truth.detected.sum()),
        "false_positives": len(found) - len(mine),
        "mislabelled": sum(found.labels[i] != truth.labels[row] for i, row in zip(mine, rows, strict=True)),
        "below_half_iou": sum(overlap < 0.5 for overlap in overlaps),
        "off_vessel": sum(overlap == 0 for overlap in overlaps),
    }


def test_counts_of_each_camera_are_those_of_its_frames_and_run_json_has_them_and_those_of_all(scene, result):
    by_camera = defaultdict(Counter)
    for frame in simulate_frames(scene):
        by_camera[frame.camera].update(counted(frame))
    assert list(result.camera_counts) == list(by_camera) == ["bow", "quay"]
    for camera, slow in by_camera.items():
        fast = asdict(result.camera_counts[camera])
        assert {name: fast[name] for name in slow} == slow
        assert slow["detected"] > slow["below_half_iou"] > slow["off_vessel"] > 20
    data = json.loads((result.folder / "run.json").read_text())
    assert data["counts"] == asdict(result.counts)
    assert data["camera_counts"] == {name: asdict(counts) for name, counts in result.camera_counts.items()}
    for name in data["counts"].keys() - {"largest_curvature_px"}:
        assert data["counts"][name] == sum(counts[name] for counts in data["camera_counts"].values()), name


def test_a_camera_without_counts_is_refused_unless_the_run_is_of_the_format_before(result, tmp_path):
    for name, wrong in {"one": {"bow": asdict(result.camera_counts["bow"])}, "none": None}.items():
        with pytest.raises(RunDirectoryError, match="must have every count of every camera"):
            open_run(edited_run(result.folder, tmp_path / name, camera_counts=wrong))
    counts = {name: count for name, count in asdict(result.counts).items() if name != "off_vessel"}
    old = edited_run(result.folder, tmp_path / "old", format=1, counts=counts, camera_counts=None)
    assert open_run(old).tables()["truth"].equals(open_run(result.folder).tables()["truth"])
