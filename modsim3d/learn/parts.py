"""The parts of a detector, the models that each can be, and what learns them.

Each model is registered once here, by its part and the name that detector files use. Reports list the models that
nothing learns as such.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from modsim3d.learn.box_error_estimate import LAWS, choose_box_errors
from modsim3d.learn.class_estimate import choose_classes
from modsim3d.learn.confidence_estimate import choose_confidence
from modsim3d.learn.false_positive_estimate import choose_false_positives
from modsim3d.learn.form import PartForm
from modsim3d.learn.states import transitions_of
from modsim3d.learn.transitions import Transitions

Learner = Callable[..., PartForm | Transitions]

STATE, CLASS, BOX_ERROR = "performance state", "dropout and class", "box error"
FALSE_POSITIVES, CONFIDENCE = "false positives", "confidence"

LEARNERS: Mapping[str, Mapping[str, Learner | None]] = {
    STATE: {"markov_chain": transitions_of},
    CLASS: {"confusion": choose_classes, "logistic": choose_classes, "table": None},
    BOX_ERROR: dict.fromkeys(LAWS, choose_box_errors),
    FALSE_POSITIVES: {"calibrated": choose_false_positives, "per_image": choose_false_positives, "thesis": None},
    CONFIDENCE: {"normal": choose_confidence, "quantiles": choose_confidence, "precision_recall": None},
}
"""What chooses and estimates each model, by part and name; None for a model that is not learned."""
