"""A detector of one state and one label, labelled sets with its detections, and what is learned from them."""

from collections.abc import Collection
from typing import Any

import numpy as np

from modsim3d.core.arrays import Indices
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned import Learned, LearnSettings, learn
from modsim3d.learn.matches import Observed
from modsim3d.learn.simulated_results import simulated
from modsim3d.learn.states import Transitions, each_its_own, transitions_of
from tests.formats.labelled_sets import found

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


def of_boats(pictures: Images, there: Annotations, seen: Results | None = None, name: str = "usual") -> LabelledSet:
    """Images of one condition and annotations of one label, with nothing detected unless it is given."""
    return LabelledSet(("boat",), (name,), pictures, there, found([], [], [], []) if seen is None else seen)


def detected(labelled: LabelledSet, content: dict[str, Any], seed: int) -> LabelledSet:
    """The set with what the detector puts out for it."""
    return simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), parse_detector(content), seed)


def observed_as(labelled: LabelledSet, states, state: Indices, rule: Rule = IOU, without=()) -> Observed:
    return Observed(labelled, match(labelled, rule, 0.2), states, state, 0.2, frozenset(without))


def observed_in(labelled: LabelledSet, rule: Rule = IOU, without: Collection[str] = (), name="usual") -> Observed:
    return observed_as(labelled, (name,), np.zeros(len(labelled.images), dtype=np.int64), rule, without)


def observed_by_condition(labelled: LabelledSet, rule: Rule = IOU, without: Collection[str] = ()) -> Observed:
    """With a state for each of the conditions `clear` and `haze`."""
    states = each_its_own(("clear", "haze"))
    return observed_as(labelled, states.names, states.of_images(labelled.images, labelled.conditions), rule, without)


def learned_in(observed: Observed, rule: Rule = IOU, chain: Transitions | None = None, **settings: Any) -> Learned:
    """What is learned, with few replicates unless others are asked for."""
    settings = {"replicates": 20, "without": observed.without, **settings}
    nothing = Transitions(np.zeros((len(observed.states), len(observed.states))))
    return learn(observed, chain or nothing, LearnSettings(rule, **settings))


def learned_by_condition(labelled: LabelledSet, rule: Rule = IOU, **settings: Any) -> Learned:
    observed = observed_by_condition(labelled, rule, settings.get("without", ()))
    return learned_in(observed, rule, transitions_of(labelled.images, observed.image_state, 2, 1.0), **settings)
