"""The file for a tracker: every detection of every frame, in time order, and nothing of the truth."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d import StoredRun, load_scene, run_scene
from modsim3d.core.arrays import Indices
from modsim3d.detector.records import KINDS, Detections
from modsim3d.runs.pipeline import Simulation, scene_statistics, truth_block
from modsim3d.runs.tracker_view import anonymised, tracker_lines


def told_to_a_tracker(path: Path) -> tuple[list[float], dict[int, list[dict[str, Any]]]]:
    """Times in seconds, and step → detections, from one line after another, as a tracker would take them."""
    frames = [json.loads(line) for line in path.read_bytes().splitlines()]
    assert all(list(frame) == ["time_s", "step", "detections"] for frame in frames)
    times_s = [frame["time_s"] for frame in frames]
    assert (np.diff(times_s) > 0).all()
    return times_s, {frame["step"]: frame["detections"] for frame in frames}


@pytest.mark.parametrize("camera", ["bow", "quay"])
def test_a_tracker_gets_every_detection_of_every_frame_and_nothing_of_the_truth(strait_run, camera):
    path = strait_run.folder / f"tracker_input_{camera}.jsonl"
    times_s, seen = told_to_a_tracker(path)
    frames = [frame for frame in strait_run.frames() if frame.camera == camera]
    assert list(seen) == [frame.step for frame in frames]
    np.testing.assert_allclose(times_s, [float(frame.timestamp) for frame in frames])
    assert sum(map(len, seen.values())) > 50
    for frame in frames:
        found, given = frame.detections, seen[frame.step]
        boxes, confidence = np.round(found.boxes_px, 3).tolist(), np.round(found.confidence, 6).tolist()
        expected = [repr(entry) for entry in zip(boxes, found.labels, confidence, strict=True)]
        told = [repr((entry["box_px"], entry["label"], entry["confidence"])) for entry in given]
        assert Counter(told) == Counter(expected)
    text, names = path.read_text(), set(strait_run.scene.vessel_names) - set(strait_run.scene.detector.labels)
    assert not [word for word in (*names, *KINDS[1:], "vessel", "kind") if f'"{word}' in text]
    for entries in seen.values():
        assert all(list(entry) == ["box_px", "label", "confidence"] for entry in entries)
        keys = [(-entry["confidence"], entry["box_px"], entry["label"]) for entry in entries]
        assert keys == sorted(keys)
        assert all(edge == round(edge, 3) for entry in entries for edge in entry["box_px"])  # no last bits


def test_frames_without_detections_are_there(tmp_path: Path) -> None:
    run_scene(load_scene("simulation_3", steps=20, source="analytic"), tmp_path / "run")
    assert told_to_a_tracker(tmp_path / "run" / "tracker_input_C1.jsonl")[1] == {step: [] for step in range(20)}


def permuted(detections: Detections, order: Indices) -> Detections:
    columns = ("frame", "target", "partner", "kind", "label", "confidence", "boxes_px", "errors_px", "redrawn")
    return replace(detections, **{name: getattr(detections, name)[order] for name in columns})


def test_the_lines_do_not_depend_on_where_detections_came_from_or_in_which_order(strait_run: StoredRun) -> None:
    scene, steps = strait_run.scene, strait_run.steps
    truth = truth_block(scene, 0, steps, None)
    block = Simulation(scene, scene_statistics(scene, [(truth, 0, steps)])).detect(truth, 0, steps)
    for part in block.cameras:
        found = part.detections
        by_origin = permuted(found, np.lexsort((found.target, found.kind, found.frame)))
        by_size = permuted(found, np.lexsort((found.boxes_px[:, 0], found.frame)))
        nobody = np.full(len(found), -1)
        unknown = replace(found, target=nobody, partner=nobody, kind=np.ones_like(found.kind))
        expected = tracker_lines(block, part, scene)
        for other in (by_origin, by_size, unknown):
            assert tracker_lines(block, replace(part, detections=other), scene) == expected


@pytest.mark.parametrize("count", [0, 1, 300])
def test_detections_are_told_by_frame_confidence_box_and_label(count: int) -> None:
    rng = np.random.default_rng(count)
    frame, label = np.sort(rng.integers(0, 9, count)), rng.integers(0, 3, count)
    boxes, confidence = rng.integers(0, 2, (count, 4)) / 1.0, rng.integers(0, 3, count) / 2
    found = anonymised(frame, label, boxes, confidence)
    given = frame, -confidence, boxes, label
    told = found.frame, -found.confidence, found.boxes_px, found.label
    rows, expected = (list(zip(*map(np.ndarray.tolist, columns), strict=True)) for columns in (told, given))
    assert rows == sorted(expected)
