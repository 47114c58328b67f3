"""The file for a tracker: every detection of every frame, in time order, and nothing of the truth."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.core.arrays import Indices
from modsim3d.detector.records import KINDS, Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.pipeline import Simulation, scene_statistics, truth_block
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import StoredRun
from modsim3d.runs.tracker_view import anonymised, tracker_lines
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene


@pytest.fixture(scope="module")
def run(strait_run: StoredRun) -> StoredRun:
    return strait_run


class Tracker:
    """Takes one line after another, as a tracker would, and knows no other file."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.seen: dict[int, list[dict[str, Any]]] = {}

    def take(self, line: bytes) -> None:
        frame = json.loads(line)
        assert list(frame) == ["time_s", "step", "detections"]
        assert not self.times_s or frame["time_s"] > self.times_s[-1]
        self.times_s.append(frame["time_s"])
        self.seen[frame["step"]] = frame["detections"]


def fed(path: Path) -> Tracker:
    tracker = Tracker()
    with path.open("rb") as lines:
        for line in lines:
            tracker.take(line)
    return tracker


@pytest.mark.parametrize("camera", ["bow", "quay"])
def test_a_tracker_gets_every_detection_of_every_frame(run: StoredRun, camera: str) -> None:
    tracker = fed(run.folder / f"tracker_input_{camera}.jsonl")
    frames = [frame for frame in run.frames() if frame.camera == camera]
    assert list(tracker.seen) == [frame.step for frame in frames]
    np.testing.assert_allclose(tracker.times_s, [float(frame.timestamp) for frame in frames])
    assert sum(map(len, tracker.seen.values())) > 50
    for frame in frames:
        found, given = frame.detections, tracker.seen[frame.step]
        boxes, confidence = np.round(found.boxes_px, 3).tolist(), np.round(found.confidence, 6).tolist()
        expected = [repr(entry) for entry in zip(boxes, found.labels, confidence, strict=True)]
        told = [repr((entry["box_px"], entry["label"], entry["confidence"])) for entry in given]
        assert Counter(told) == Counter(expected)


def test_frames_without_detections_are_there(tmp_path: Path) -> None:
    run_scene(load_scene("simulation_3", steps=20, source="analytic"), tmp_path / "run")
    tracker = fed(tmp_path / "run" / "tracker_input_C1.jsonl")
    assert tracker.seen == {step: [] for step in range(20)}


@pytest.mark.parametrize("camera", ["bow", "quay"])
def test_nothing_in_it_is_of_the_truth(run: StoredRun, camera: str) -> None:
    text = (run.folder / f"tracker_input_{camera}.jsonl").read_text()
    names = set(run.scene.vessel_names) - set(run.scene.detector.labels)
    for word in (*names, *KINDS[1:], "vessel", "kind"):
        assert f'"{word}' not in text
    for entries in fed(run.folder / f"tracker_input_{camera}.jsonl").seen.values():
        assert all(list(entry) == ["box_px", "label", "confidence"] for entry in entries)
        keys = [(-entry["confidence"], entry["box_px"], entry["label"]) for entry in entries]
        assert keys == sorted(keys)
        assert all(edge == round(edge, 3) for entry in entries for edge in entry["box_px"])  # no last bits


def lines_with(scene: Scene, block: Block, part: CameraBlock, detections: Detections) -> list[bytes]:
    return tracker_lines(block, replace(part, detections=detections), scene).splitlines(keepends=True)


def permuted(detections: Detections, order: Indices) -> Detections:
    columns = ("frame", "target", "partner", "kind", "label", "confidence", "boxes_px", "errors_px", "redrawn")
    return replace(detections, **{name: getattr(detections, name)[order] for name in columns})


def test_the_lines_do_not_depend_on_where_detections_came_from_or_in_which_order(run: StoredRun) -> None:
    scene, steps = run.scene, run.steps
    truth = truth_block(scene, 0, steps, None)
    block = Simulation(scene, scene_statistics(scene, [(truth, 0, steps)])).detect(truth, 0, steps)
    for part in block.cameras:
        found = part.detections
        lines = partial(lines_with, scene, block, part)
        by_origin = permuted(found, np.lexsort((found.target, found.kind, found.frame)))
        by_size = permuted(found, np.lexsort((found.boxes_px[:, 0], found.frame)))
        nobody = np.full(len(found), -1)
        unknown = replace(found, target=nobody, partner=nobody, kind=np.ones_like(found.kind))
        assert lines(found) == lines(by_origin) == lines(by_size) == lines(unknown)


@pytest.mark.parametrize("count", [0, 1, 300])
def test_detections_are_told_by_frame_confidence_box_and_label(count: int) -> None:
    rng = np.random.default_rng(count)
    frame, label = np.sort(rng.integers(0, 9, count)), rng.integers(0, 3, count)
    boxes, confidence = rng.integers(0, 2, (count, 4)) / 1.0, rng.integers(0, 3, count) / 2
    found = anonymised(frame, label, boxes, confidence)
    keys = zip(frame.tolist(), (-confidence).tolist(), boxes.tolist(), label.tolist(), strict=True)
    told_keys = zip(
        found.frame.tolist(), (-found.confidence).tolist(), found.boxes_px.tolist(), found.label.tolist(), strict=True
    )
    assert list(told_keys) == sorted(keys)
