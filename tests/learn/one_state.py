"""A detector of one state and one label, and what is learned in one state from a labelled set."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned import Learned, LearnSettings, learn
from modsim3d.learn.matches import Observed
from modsim3d.learn.states import Transitions

IOU = Rule()
SMALL_ERRORS = {"unit": "relative", "mean": [0.0] * 4, "covariance": (4e-4 * np.eye(4)).tolist()}


def detector_file(name: str = "usual", missed: float = 0.1, false: float = 0.2, **state: Any) -> dict[str, Any]:
    """The content of a detector file; `state` has keys of the state that are not the usual ones."""
    usual = {
        "confusion": [[1 - missed], [missed]],
        "false_positive_labels": [1.0],
        "false_discovery_rate": false,
        "box_error": SMALL_ERRORS,
        "confidence": {"mean": 0.6, "std": 0.1},
    }
    return {
        "labels": ["boat"],
        "confidence_threshold": 0.2,
        "initial_state": name,
        "transition_matrix": [[1.0]],
        "states": {name: usual | state},
    }


def observed_in(
    labelled: LabelledSet, rule: Rule = IOU, without: Collection[str] = (), name: str = "usual"
) -> Observed:
    state = np.zeros(len(labelled.images), dtype=np.int64)
    return Observed(labelled, match(labelled, rule, 0.2), (name,), state, 0.2, frozenset(without))


def learned_in(observed: Observed, rule: Rule = IOU, **settings: Any) -> Learned:
    """What is learned, with few replicates unless others are asked for."""
    settings = {"replicates": 20, **settings}
    return learn(observed, Transitions(np.zeros((1, 1))), LearnSettings(rule, **settings))
