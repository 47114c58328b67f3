"""What learns each model of a detector, registered under the part and name that `detector.parts.MODELS` gives it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from modsim3d.detector.parts import CONFUSION, MARKOV_CHAIN, MODELS, Part
from modsim3d.learn.box_errors.box_error_estimate import choose_box_errors
from modsim3d.learn.box_errors.error_laws import LAWS
from modsim3d.learn.confidence.confidence_estimate import choose_confidence
from modsim3d.learn.false_positives.false_positive_estimate import choose_false_positives
from modsim3d.learn.form import PartForm
from modsim3d.learn.misses.class_estimate import choose_classes
from modsim3d.learn.states.states import transitions_of
from modsim3d.learn.states.transitions import Transitions

Learner = Callable[..., PartForm | Transitions]

LEARNERS: Mapping[Part, Mapping[str, Learner]] = {
    Part.STATE: {MARKOV_CHAIN: transitions_of},
    Part.CLASS: dict.fromkeys((CONFUSION, "logistic"), choose_classes),
    Part.BOX_ERROR: dict.fromkeys(LAWS, choose_box_errors),
    Part.FALSE_POSITIVES: dict.fromkeys(("calibrated", "per_image"), choose_false_positives),
    Part.CONFIDENCE: dict.fromkeys(("normal", "quantiles"), choose_confidence),
}
"""What chooses and estimates each model that can be learned."""


def models_and_learners() -> Iterator[tuple[Part, str, Learner | None]]:
    """Part, name and learner of every registered model; None for a model that nothing learns."""
    for part, models in MODELS.items():
        for name in models:
            yield part, name, LEARNERS[part].get(name)
