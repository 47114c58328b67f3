"""The parts of a detector, and the models that each part can be.

Each model is registered once here, under the name that detector files use. `verify` registers its checks under the same
part and name, and so may `learn`; a model without checks is listed as such among the verdicts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from modsim3d.detector.box_error_law import ERROR_DISTRIBUTIONS
from modsim3d.detector.classification import ConfusionClassifier
from modsim3d.detector.clutter_models import CLUTTER_MODELS
from modsim3d.detector.confidence import SCORES
from modsim3d.detector.dropout import EFFECTS
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.states import PerformanceStates


class Part(StrEnum):
    """The parts of a detector in the order in which it works, with the names that reports use."""

    STATE = "performance state"
    CLASS = "dropout and class"
    BOX_ERROR = "box error"
    FALSE_POSITIVES = "false positives"
    CONFIDENCE = "confidence"


MARKOV_CHAIN, CONFUSION = "markov_chain", "confusion"

MODELS: Mapping[Part, Mapping[str, object]] = {
    Part.STATE: {MARKOV_CHAIN: PerformanceStates},
    Part.CLASS: {CONFUSION: ConfusionClassifier, **EFFECTS},
    Part.BOX_ERROR: ERROR_DISTRIBUTIONS,
    Part.FALSE_POSITIVES: CLUTTER_MODELS,
    Part.CONFIDENCE: SCORES,
}
"""What draws each part, by the name of the model."""


@dataclass(frozen=True)
class UsedModel:
    """A model that a detector uses: its registered name, the key of the file that chooses it, and its state, if one."""

    part: Part
    name: str
    key: str
    state: str | None = None


def used_models(model: DetectorModel) -> Iterator[UsedModel]:
    """Every model that a detector uses, in the order of its parts."""
    yield UsedModel(Part.STATE, MARKOV_CHAIN, "performance")
    yield UsedModel(Part.CLASS, CONFUSION, "dropout.model")
    for effect in model.dropout.effects:
        yield UsedModel(Part.CLASS, model_name(EFFECTS, effect), f"dropout.{effect.attribute}")
    for index, effects in model.dropout.own.items():
        for effect in effects:
            name = model.states[index].name
            key = f"states.{name}.dropout.{effect.attribute}"
            yield UsedModel(Part.CLASS, model_name(EFFECTS, effect), key, name)
    for state in model.states:
        name = model_name(ERROR_DISTRIBUTIONS, state.box_error.distribution)
        yield UsedModel(Part.BOX_ERROR, name, f"states.{state.name}.box_error.law", state.name)
    yield UsedModel(Part.FALSE_POSITIVES, model.clutter.model, "false_positives.model")
    for state in model.states:
        true, false = state.confidence.true, state.confidence.false
        kinds = {"": true} if true is false else {".true": true, ".false": false}
        for suffix, scores in kinds.items():
            key = f"states.{state.name}.confidence{suffix}"
            yield UsedModel(Part.CONFIDENCE, model_name(SCORES, scores), key, state.name)


def model_name(models: Mapping[str, type], value: object) -> str:
    """The name under which the type of a value is registered.

    Raises:
        LookupError: It is not registered.
    """
    for name, kind in models.items():
        if type(value) is kind:
            return name
    raise LookupError(f"{type(value).__name__} is not registered: known are {', '.join(models)}")
