"""Dropout and class: one draw from the column of the confusion matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.census import TargetCensus, tallied
from modsim3d.detector.draws import choose, cumulative
from modsim3d.detector.dropout import Dropout, anchor, shifted_rate
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Targets


@dataclass(frozen=True, eq=False)
class ConfusionClassifier:
    """Inverts the distribution of the target's label in the current state at a uniform number.

    Attributes:
        distributions: Distribution function over labels and background, shape (states, labels, labels + 1).
        intercepts: Log-odds added to all misses of a state and label, shape (states, labels).
    """

    distributions: Array
    dropout: Dropout
    intercepts: Array

    @classmethod
    def from_model(cls, model: DetectorModel, census: TargetCensus) -> ConfusionClassifier:
        """The classifier of a detector whose anchored miss rates hold on average over the scene of the census."""
        distributions = cumulative(np.swapaxes(model.column("confusion"), 1, 2))
        misses = _miss_rates(distributions)
        intercepts = np.zeros_like(misses)
        if model.dropout.anchored:
            for state, label in np.ndindex(*misses.shape):
                intercepts[state, label] = anchor(
                    float(misses[state, label]), *census.log_odds_of(tallied(model.dropout, state), label)
                )
        return cls(distributions, model.dropout, intercepts)

    def miss_rates(self, states: Indices, targets: Targets) -> Array:
        """Probability that each target is missed in a state of its own, shapes (n,)."""
        added = self.intercepts[states, targets.label] + self.dropout.log_odds(states, targets)
        return shifted_rate(_miss_rates(self.distributions)[states, targets.label], added)

    def classify(self, frames: CameraFrames, states: Indices, targets: Targets, uniforms: Array) -> Indices:
        """Detected label of each target from one uniform number each, −1 where it is missed, shapes (n,).

        A changed rate of misses keeps the shares of the labels among detected targets.
        """
        state = states[targets.frame]
        if self.dropout.every_effect:
            seen = 1 - self.miss_rates(state, targets)
            usual = 1 - _miss_rates(self.distributions)[state, targets.label]
            detected = uniforms < seen
            # Up to `seen` the number is stretched over the labels' share of the column, which it must not leave.
            stretched = np.minimum(uniforms * (usual / np.maximum(seen, _LEAST)), np.nextafter(usual, 0))
            uniforms = np.where(detected, stretched, 1.0)
        label = choose(self.distributions[state, targets.label], uniforms)
        background = self.distributions.shape[1]
        return np.where(label >= background, -1, label)


_LEAST = 1e-300


def _miss_rates(distributions: Array) -> Array:
    return 1 - distributions[..., -2]
