"""The outcome of each detection: what it means, and that rows, frames and counts agree on it."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d import RunRows, StoredRun, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, detected_rows, frame_outcomes, having, outcomes
from tests.scenes import mistaken_strait

VESSEL = [100.0, 100.0, 120.0, 110.0]
BAD, OFF = Outcome.BELOW_HALF_IOU, Outcome.BELOW_HALF_IOU | Outcome.OFF_VESSEL


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    folder = tmp_path_factory.mktemp("outcomes")
    return open_run(run_scene(load_scene(mistaken_strait(folder)), folder / "run").folder)


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


def test_rows_and_frames_agree(run):
    rows = RunRows.of(run)
    by_frame = [outcome for frame in run.frames() for outcome in frame_outcomes(frame)]
    assert by_frame == rows.outcomes.tolist()
    vessels = rows.truth_vessel[rows.detected_row[rows.detected_row >= 0]]
    of_frames = [frame.truth.vessels[row] for frame in run.frames() for row in detected_rows(frame) if row is not None]
    assert [run.scene.vessel_names[vessel] for vessel in vessels] == of_frames


def test_outcomes_of_every_kind_sum_to_the_counts_of_the_run(run):
    kinds = set(run.tables()["detections"]["kind"].to_pylist())
    assert kinds >= {"duplicate", "merged", "split", "fragment", "false_positive"}
    names = ("false_positives", "mislabelled", "below_half_iou", "off_vessel")
    sums = [having(RunRows.of(run).outcomes, flag).sum() for flag in Outcome]
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
