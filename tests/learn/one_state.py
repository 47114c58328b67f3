"""A detector of one state and one label, labelled sets with its detections, and what is learned from them."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.core.arrays import Array, Indices
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.learned_detector import Estimates, LearnSettings, learn, uncertainty_text
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.self_check import simulated
from modsim3d.learn.states import Transitions, each_its_own, transitions_of
from modsim3d.scene.settings import choose_detector
from tests.formats.labelled_files import found, images, truth

IOU, PROVENANCE = Rule(), Rule("provenance")
BOATS, RATE_HZ, SIDE_PX = 3, 5.0, 900.0
SMALL_ERRORS = {"unit": "relative", "mean": [0.0] * 4, "covariance": (4e-4 * np.eye(4)).tolist()}


def detector_file(name: str = "usual", missed: float = 0.1, false: float = 0.2, **state: Any) -> dict[str, Any]:
    """The content of a detector file; `state` has keys of the state that are not the usual ones."""
    labels = {"confusion": [[1 - missed], [missed]], "false_positive_labels": [1.0], "false_discovery_rate": false}
    usual = labels | {"box_error": SMALL_ERRORS, "confidence": {"mean": 0.6, "std": 0.1}}
    chain = {"initial_state": name, "transition_matrix": [[1.0]]}
    return {"labels": ["boat"], "confidence_threshold": 0.2, **chain, "states": {name: usual | state}}


def of_boats(pictures: Images, there: Annotations, seen: Results | None = None, name: str = "usual") -> LabelledSet:
    """Images of one condition and annotations of one label, with nothing detected unless it is given."""
    return LabelledSet(("boat",), (name,), pictures, there, found([], [], [], []) if seen is None else seen)


def detected(labelled: LabelledSet, content: dict[str, Any], seed: int) -> LabelledSet:
    """The set with what the detector puts out for it."""
    return simulated(labelled, np.zeros(len(labelled.images), dtype=np.int64), parse_detector(content), seed)


def observed_as(labelled: LabelledSet, states, state: Indices, rule: Rule = IOU, without=()) -> Outcomes:
    return Outcomes(labelled, match(labelled, rule, 0.2), states, state, 0.2, frozenset(without))


def observed_in(labelled: LabelledSet, rule: Rule = IOU, without: Collection[str] = (), name="usual") -> Outcomes:
    return observed_as(labelled, (name,), np.zeros(len(labelled.images), dtype=np.int64), rule, without)


def observed_by_condition(labelled: LabelledSet, rule: Rule = IOU, without: Collection[str] = ()) -> Outcomes:
    """With a state for each of the conditions `clear` and `haze`."""
    states = each_its_own(("clear", "haze"))
    return observed_as(labelled, states.names, states.of_images(labelled.images, labelled.conditions), rule, without)


def learned_in(observed: Outcomes, rule: Rule = IOU, chain: Transitions | None = None, **settings: Any) -> Estimates:
    """What is learned, with few replicates unless others are asked for."""
    settings = {"replicates": 20, "without": observed.without, **settings}
    nothing = Transitions(np.zeros((len(observed.states), len(observed.states))))
    return learn(observed, chain or nothing, LearnSettings(rule, **settings))


def learned_by_condition(labelled: LabelledSet, rule: Rule = IOU, **settings: Any) -> Estimates:
    observed = observed_by_condition(labelled, rule, settings.get("without", ()))
    return learned_in(observed, rule, transitions_of(labelled.images, observed.image_state, 2, 1.0), **settings)


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


def moored(frames: int, boats: int, columns: int, size_px, top_px=200.0, side_px=60.0, step_s=0.5) -> LabelledSet:
    """Boats that lie 250 px apart in so many columns."""
    image, boat = np.repeat(np.arange(frames), boats), np.tile(np.arange(boats), frames)
    corner = np.column_stack([100 + 250.0 * (boat % columns), top_px + 250.0 * (boat // columns)])
    far = corner + np.broadcast_to(side_px, boats)[boat][:, None]
    annotations = truth(image, 0 * image, np.hstack([corner, far]), identity=boat)
    return of_boats(images(frames, size_px, np.arange(frames) * step_s), annotations)


def detector(confidence: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A detector of one state with small box errors and these keys of confidence."""
    section = {"model": "calibrated", "size": {"model": "lognormal", "px": [40, 40], "log_std": 0.5}}
    return {**detector_file(confidence=confidence), "false_positives": section, **sections}


def learned_from(labelled: LabelledSet, rule: Rule = PROVENANCE, without: Collection[str] = (), **others) -> Estimates:
    """What is learned from a set of one condition, with sixty replicates unless others are asked for."""
    observed = observed_in(labelled, rule, without, labelled.conditions[0])
    return learned_in(observed, rule, **{"replicates": 60, **others})


def normal_chain(kept: float, rng: np.random.Generator, *shape: int) -> Array:
    """Standard normal numbers of which a share is kept from one row to the next, with a first axis of rows."""
    value = rng.normal(size=shape)
    for row in range(1, len(value)):
        value[row] = kept * value[row - 1] + np.sqrt(1 - kept**2) * value[row]
    return value


def drawn_models(learned: Estimates, folder: Path, count: int) -> list[DetectorModel]:
    """Detectors that a campaign draws around one that was learned."""
    path, text = folder / "learned.yaml", yaml.safe_dump(learned.detector())
    path.write_text(text)
    known = LearnedUncertainty.model_validate_json(uncertainty_text(learned, text))
    drawn = (drawn_detector(known, seed) for seed in range(count))
    return [choose_detector(path, settings=settings, may_be_unread=True)[0] for settings in drawn]
