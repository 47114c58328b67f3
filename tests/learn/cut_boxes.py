"""Boats near the edges of small images, found with errors that the edge cuts, and what is learned from them."""

from __future__ import annotations

from typing import Any

import numpy as np

from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule
from modsim3d.learn.learned import Learned
from tests.formats.labelled_sets import images, truth
from tests.learn import one_state
from tests.learn.one_state import detector_file, learned_in, observed_in, of_boats

SIZE = (640.0, 480.0)
_CORRELATION = np.array([[1, 0.2, 0.3, 0], [0.2, 1, 0, -0.2], [0.3, 0, 1, 0.4], [0, -0.2, 0.4, 1]])
PX = {"unit": "px", "mean": [2, -1, 3, -2], "std": [6, 5, 9, 8]}
RELATIVE = {"unit": "relative", "mean": [0.01, -0.02, 0.03, -0.01], "std": [0.12, 0.12, 0.14, 0.16]}
MIXED = {"unit": "mixed", "mean": [2, -1, 3, -2], "std": [2, 2, 3, 3], "growth": [0.04, 0.03, 0.06, 0.05]}
HEAVY = {**PX, "law": "student_t", "degrees_of_freedom": 4.0}


def detector(law: dict[str, Any]) -> dict[str, Any]:
    """A detector that finds everything, with box errors of a law."""
    covariance = _CORRELATION * np.outer(law["std"], law["std"])
    box_error = {key: value for key, value in law.items() if key != "std"} | {"covariance": covariance.tolist()}
    return detector_file(missed=0.0, false=0.0, box_error=box_error)


def boats(count: int, seed: int) -> LabelledSet:
    """One boat in each image, anywhere: many are cut by the edge or lie close to it."""
    rng = np.random.default_rng(seed)
    side = np.exp(rng.uniform(np.log(40), np.log(200), (count, 1))) * np.exp(rng.normal(0, 0.15, (count, 2)))
    centre = rng.uniform(-0.05, 1.05, (count, 2)) * SIZE
    boxes = np.clip(np.hstack([centre - side / 2, centre + side / 2]), 0, [*SIZE, *SIZE])
    middle = np.hstack([np.array(SIZE) / 2 - side / 2, np.array(SIZE) / 2 + side / 2])
    boxes = np.where(np.all(boxes[:, 2:] - boxes[:, :2] >= 4, axis=1)[:, None], boxes, middle)
    image = np.arange(count)
    return of_boats(images(count, SIZE), truth(image, image * 0, boxes))


def detected(law: dict[str, Any], count: int, seed: int) -> LabelledSet:
    """Boats with detections of a simulated detector, of which it is not told what they are of."""
    return one_state.detected(boats(count, seed), detector(law), seed)


def learn_from(labelled: LabelledSet, rule: Rule, replicates: int = 100, seed: int = 0) -> Learned:
    """What is learned from matches by a rule."""
    return learned_in(observed_in(labelled, rule), rule, replicates=replicates, seed=seed)


def asked_of(law: dict[str, Any]) -> dict[str, np.ndarray]:
    """The numbers of a law by the paths that learning gives them."""
    names = {"mean", "std", "growth", "degrees_of_freedom"} & law.keys()
    asked = {f"states.usual.box_error_{name}": np.array(law[name], dtype=float) for name in names}
    return asked | {"states.usual.box_error_correlation": np.array([_CORRELATION[pair] for pair in ERROR_PAIRS])}
