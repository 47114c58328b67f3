"""Dropout and class: one draw from the column of the confusion matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.detector.draws import choose, cumulative, target_uniforms
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array, Frames, Indices, Targets
from modsim3d.random_streams import Streams


@dataclass(frozen=True, eq=False)
class ConfusionClassifier:
    """Reads a uniform number through the distribution of the target's label in the current state.

    Attributes:
        distributions: Distribution function over labels and background, shape (states, labels, labels + 1).
    """

    distributions: Array

    @classmethod
    def from_model(cls, model: DetectorModel) -> ConfusionClassifier:
        """The classifier of a detector model."""
        return cls(cumulative(np.swapaxes(model.column("confusion"), 1, 2)))

    def classify(self, streams: Streams, frames: Frames, states: Indices, targets: Targets) -> Indices:
        """What each target is taken for, shape (n,): a label, or -1 where it is missed."""
        uniforms = target_uniforms(streams, "detector.class", frames, targets, width=1)[:, 0]
        label = choose(self.distributions[states[targets.frame], targets.label], uniforms)
        background = self.distributions.shape[1]
        return np.where(label == background, -1, label)
