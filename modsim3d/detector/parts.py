"""The parts of a detector, and the models that each part can be.

Each model is registered once here, under the name that detector files use. `verify` registers its checks under the same
part and name, and so may `learn`; a model without checks is listed as such among the verdicts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from modsim3d.detector.classification import ConfusionClassifier, PerformanceStates
from modsim3d.detector.confidence import SCORES
from modsim3d.detector.draws import ERROR_DISTRIBUTIONS
from modsim3d.detector.dropout import EFFECTS
from modsim3d.detector.false_positives import CLUTTER_MODELS
from modsim3d.detector.model import DetectorModel


class DetectorPart(StrEnum):
    """The parts of a detector in the order in which it works, with the names that reports use."""

    STATE = "performance state"
    CLASS = "dropout and class"
    BOX_ERROR = "box error"
    FALSE_POSITIVES = "false positives"
    CONFIDENCE = "confidence"


MARKOV_CHAIN, CONFUSION = "markov_chain", "confusion"

MODELS: Mapping[DetectorPart, Mapping[str, object]] = {
    DetectorPart.STATE: {MARKOV_CHAIN: PerformanceStates},
    DetectorPart.CLASS: {CONFUSION: ConfusionClassifier, **EFFECTS},
    DetectorPart.BOX_ERROR: ERROR_DISTRIBUTIONS,
    DetectorPart.FALSE_POSITIVES: CLUTTER_MODELS,
    DetectorPart.CONFIDENCE: SCORES,
}
"""What draws each part, by the name of the model."""


@dataclass(frozen=True)
class UsedModel:
    """A model that a detector uses: its registered name, the key of the file that chooses it, and its state, if one."""

    part: DetectorPart
    name: str
    key: str
    state: str | None = None


def used_models(model: DetectorModel) -> Iterator[UsedModel]:
    """Every model that a detector uses, in the order of its parts."""
    yield UsedModel(DetectorPart.STATE, MARKOV_CHAIN, "performance")
    yield UsedModel(DetectorPart.CLASS, CONFUSION, "dropout.model")
    for effect in model.dropout.effects:
        yield UsedModel(DetectorPart.CLASS, model_name(EFFECTS, effect), f"dropout.{effect.attribute}")
    for index, effects in model.dropout.own.items():
        for effect in effects:
            name = model.states[index].name
            key = f"states.{name}.dropout.{effect.attribute}"
            yield UsedModel(DetectorPart.CLASS, model_name(EFFECTS, effect), key, name)
    for state in model.states:
        name = model_name(ERROR_DISTRIBUTIONS, state.box_error.distribution)
        yield UsedModel(DetectorPart.BOX_ERROR, name, f"states.{state.name}.box_error.law", state.name)
    yield UsedModel(DetectorPart.FALSE_POSITIVES, model.clutter.model, "false_positives.model")
    for state in model.states:
        true, false = state.confidence.true, state.confidence.false
        kinds = {"": true} if true is false else {".true": true, ".false": false}
        for suffix, scores in kinds.items():
            key = f"states.{state.name}.confidence{suffix}"
            yield UsedModel(DetectorPart.CONFIDENCE, model_name(SCORES, scores), key, state.name)


def model_name(models: Mapping[str, type], value: object) -> str:
    """The name under which the type of a value is registered.

    Raises:
        LookupError: It is not registered.
    """
    for name, kind in models.items():
        if type(value) is kind:
            return name
    raise LookupError(f"{type(value).__name__} is not registered: known are {', '.join(models)}")
