"""Labelled sets with the confidences of a simulated detector."""

from __future__ import annotations

from typing import Any

import numpy as np

from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned import Learned, LearnSettings, learn
from modsim3d.learn.matches import Observed
from modsim3d.learn.states import Transitions
from tests.formats.labelled_sets import found, images, truth
from tests.learn.simulated_results import simulated

BOATS, RATE_HZ, SIDE_PX = 3, 5.0, 900.0


def truth_of(frames: int, seed: int, hidden: bool = True) -> LabelledSet:
    """Three boats in each frame, with sizes of 10 to 150 px; two in five are partly hidden."""
    rng = np.random.default_rng(seed)
    image, identity = np.repeat(np.arange(frames), BOATS), np.tile(np.arange(BOATS), frames)
    side = np.clip(45 * np.exp(rng.normal(0, 0.6, len(image))), 10, 150)
    corner = np.column_stack([120 + 250.0 * identity, np.full(len(image), 300.0)])
    visible = np.where(rng.random(len(image)) < 0.6, 1.0, rng.uniform(0.1, 1, len(image)))
    return LabelledSet(
        ("boat",),
        ("usual",),
        images(frames, (SIDE_PX, SIDE_PX), np.arange(frames) / RATE_HZ),
        truth(
            image,
            0 * image,
            np.column_stack([corner, corner + side[:, None]]),
            identity=identity,
            visible=visible if hidden else np.full(len(image), np.nan),
        ),
        found([], [], [], [], origin=np.empty(0, dtype=np.int64)),
    )


def detector(confidence: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A detector of one state with small box errors and these keys of confidence."""
    state = {
        "confusion": [[0.9], [0.1]],
        "false_positive_labels": [1.0],
        "false_discovery_rate": 0.2,
        "box_error": {"unit": "relative", "mean": [0.0] * 4, "covariance": (np.eye(4) * 4e-4).tolist()},
        "confidence": confidence,
    }
    size = {"model": "lognormal", "px": [40, 40], "log_std": 0.5}
    return {
        "labels": ["boat"],
        "confidence_threshold": 0.2,
        "initial_state": "usual",
        "transition_matrix": [[1.0]],
        "false_positives": {"model": "calibrated", "size": size},
        "states": {"usual": state},
        **sections,
    }


def learned_from(labelled: LabelledSet, without: tuple[str, ...] = (), method: str = "provenance") -> Learned:
    state = np.zeros(len(labelled.images), dtype=np.int64)
    matched = match(labelled, Rule(method), 0.2)
    observed = Observed(labelled, matched, labelled.conditions, state, 0.2, frozenset(without))
    return learn(observed, Transitions(np.zeros((1, 1))), LearnSettings(replicates=60))


def detected(labelled: LabelledSet, content: dict[str, Any], seed: int) -> LabelledSet:
    """The set with what the detector puts out for it."""
    return simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), parse_detector(content), seed)
