"""Labelled sets with the confidences of a simulated detector."""

from typing import Any

import numpy as np

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule
from modsim3d.learn.learned import Learned
from tests.formats.labelled_sets import found, images, truth
from tests.learn.one_state import detector_file, learned_in, observed_in, of_boats

BOATS, RATE_HZ, SIDE_PX = 3, 5.0, 900.0


def truth_of(frames: int, seed: int, hidden: bool = True) -> LabelledSet:
    """Three boats in each frame, with sizes of 10 to 150 px; two in five are partly hidden."""
    rng = np.random.default_rng(seed)
    image, identity = np.repeat(np.arange(frames), BOATS), np.tile(np.arange(BOATS), frames)
    side = np.clip(45 * np.exp(rng.normal(0, 0.6, len(image))), 10, 150)
    corner = np.column_stack([120 + 250.0 * identity, np.full(len(image), 300.0)])
    visible = np.where(rng.random(len(image)) < 0.6, 1.0, rng.uniform(0.1, 1, len(image)))
    unknown = np.full(len(image), np.nan)
    boxes = np.column_stack([corner, corner + side[:, None]])
    pictures = images(frames, (SIDE_PX, SIDE_PX), np.arange(frames) / RATE_HZ)
    annotations = truth(image, 0 * image, boxes, identity=identity, visible=visible if hidden else unknown)
    return of_boats(pictures, annotations, found([], [], [], [], origin=np.empty(0, dtype=np.int64)))


def detector(confidence: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A detector of one state with small box errors and these keys of confidence."""
    size = {"model": "lognormal", "px": [40, 40], "log_std": 0.5}
    file = detector_file(confidence=confidence)
    return {**file, "false_positives": {"model": "calibrated", "size": size}, **sections}


def learned_from(labelled: LabelledSet, without: tuple[str, ...] = (), method: str = "provenance") -> Learned:
    return learned_in(observed_in(labelled, Rule(method), without), replicates=60)
