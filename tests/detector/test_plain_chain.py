"""The plain chain, without any of the models that a detector file may add: its output stays what it was."""

import hashlib
from pathlib import Path

import numpy as np

import modsim3d
from modsim3d.detector.file.reading import load_detector
from modsim3d.detector.records import Targets
from tests.detector.detector_builders import make_frames, make_targets, run

THREE_LABELS = Path(__file__).resolve().parents[2] / "scenes" / "detectors" / "three_labels.yaml"
STEPS = 400
# Digests of these tests, from the chain as it was when false positives got sides of their own parts of a pixel.
SIMULATION_1_SHA256 = "72ded7f86c419a7370ebae5b39baf0daf7f273d8715fb55415d2c26dfcce6d23"
THREE_LABELS_SHA256 = "e6fbb59940cd836b958449d76a2eacb6aaa9d673d775172c697ba6be32e63c7c"


def three_label_targets() -> Targets:
    random = np.random.default_rng(7)
    corners = np.sort(random.uniform(0, 1, (STEPS, 6, 2, 2)) * [3600, 2400], axis=2)
    boxes = np.concatenate([corners[:, :, 0], corners[:, :, 1]], axis=-1)
    boxes[random.random((STEPS, 6)) < 1 / 4] = np.nan
    return make_targets(boxes, np.arange(6) % 3)


def digest(*columns: np.ndarray) -> str:
    """Of seven digits of each number: more would hash the rounding of the machine's sine."""
    text = "\n".join(f"{value:.6e}" for column in columns for value in np.asarray(column, dtype=float).ravel())
    return hashlib.sha256(text.encode()).hexdigest()


def test_simulation_1_is_detected_as_it_was() -> None:
    scene = modsim3d.load_scene("simulation_1", steps=300, source="analytic")
    columns = []
    for frame in modsim3d.simulate_frames(scene):
        found = frame.detections
        columns += [found.boxes_px, found.confidence, found.errors_px]
    assert sum(len(column) for column in columns) > 3000
    assert digest(*columns) == SIMULATION_1_SHA256


def test_three_labels_are_detected_as_they_were() -> None:
    found = run(load_detector(THREE_LABELS), make_frames(STEPS), three_label_targets(), seed=11)
    columns = (found.states, found.frame, found.target, found.kind, found.label)
    columns += (found.boxes_px, found.confidence, found.errors_px, found.redrawn)
    assert digest(*columns) == THREE_LABELS_SHA256
