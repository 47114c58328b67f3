"""The outcome of each detection: what it means, and that rows, frames and counts agree on it."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modsim3d.runs.counts import Outcome, detected_rows, frame_outcomes, having, outcomes
from modsim3d.runs.run import run_scene
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.scene.reading import load_scene
from tests.scenes import mistaken_strait

VESSEL = [100.0, 100.0, 120.0, 110.0]
BAD, OFF = Outcome.BELOW_HALF_IOU, Outcome.BELOW_HALF_IOU | Outcome.OFF_VESSEL


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("outcomes")
    run_scene(load_scene(mistaken_strait(folder)), folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def run(folder: Path) -> StoredRun:
    return open_run(folder)


@pytest.mark.parametrize(
    "box, expected",
    [
        (VESSEL, 0),
        ([100, 100, 110, 110], 0),  # IoU is 0.5: not below it
        ([100, 100, 109.9, 110], BAD),
        ([119.9, 109.9, 140, 120], BAD),
        ([120, 100, 140, 110], OFF),  # the boxes share an edge only
        ([300, 100, 320, 110], OFF),
    ],
)
def test_a_box_is_right_bad_or_off_its_vessel_by_iou(box, expected):
    for mislabelled, flag in ((False, 0), (True, Outcome.MISLABELLED)):
        (found,) = outcomes(np.array([False]), np.array([mislabelled]), np.array([box]), np.array([VESSEL]))
        assert found == expected | flag


def test_of_a_false_positive_nothing_else_is_said():
    nothing = np.full((1, 4), np.nan)
    (found,) = outcomes(np.array([True]), np.array([True]), np.array([VESSEL]), nothing)
    assert found == Outcome.FALSE_POSITIVE


def test_the_run_has_every_kind_of_mistake(run):
    kinds = Counter(run.tables()["detections"]["kind"].to_pylist())
    assert min(kinds[kind] for kind in ("duplicate", "merged", "split", "fragment", "false_positive")) > 0
    assert all(having(RunRows.of(run).outcomes, flag).sum() > 5 for flag in Outcome)


def test_rows_and_frames_agree(run):
    rows = RunRows.of(run)
    by_frame = [outcome for frame in run.frames() for outcome in frame_outcomes(frame)]
    assert by_frame == rows.outcomes.tolist()
    vessels = [
        run.scene.vessel_names[vessel] for vessel in rows.truth_vessel[rows.detected_row[rows.detected_row >= 0]]
    ]
    of_frames = [frame.truth.vessels[row] for frame in run.frames() for row in detected_rows(frame) if row is not None]
    assert vessels == of_frames


def test_outcomes_sum_to_the_counts_of_the_run(run, folder):
    counts = json.loads((folder / "run.json").read_text())["counts"]
    found = RunRows.of(run).outcomes
    assert {
        "false_positives": int(having(found, Outcome.FALSE_POSITIVE).sum()),
        "mislabelled": int(having(found, Outcome.MISLABELLED).sum()),
        "below_half_iou": int(having(found, Outcome.BELOW_HALF_IOU).sum()),
        "off_vessel": int(having(found, Outcome.OFF_VESSEL).sum()),
    }.items() <= counts.items()


def test_a_second_box_of_a_vessel_is_a_false_positive(run):
    second = [
        (frame, i)
        for frame in run.frames()
        for i, kind in enumerate(frame.detections.kinds)
        if kind in ("duplicate", "fragment")
    ]
    assert second
    for frame, i in second:
        assert frame.detections.vessels[i] is not None
        assert frame_outcomes(frame)[i] == Outcome.FALSE_POSITIVE


def test_a_frame_without_vessels_has_only_false_positives(run):
    frame = next(frame for frame in run.frames() if "false_positive" in frame.detections.kinds)
    nobody = (None,) * len(frame.detections)
    bare = replace(
        frame, truth=replace(frame.truth, vessels=(), labels=()), detections=replace(frame.detections, vessels=nobody)
    )
    assert set(frame_outcomes(bare)) == {Outcome.FALSE_POSITIVE}
