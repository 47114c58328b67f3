"""How long two vessels that overlap come out as one box, or do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.kinds.multiple_box_trials import Trials
from modsim3d.learn.persistence.mean_bias import Stretches, stretches_of_things
from modsim3d.learn.persistence.persistence_fit import Consecutive, Steps, inflation, steps_of


@dataclass(frozen=True, eq=False)
class ConsecutiveMerges:
    """Pairs that could have been merged, and which of them follow each other."""

    trials: Trials
    steps: Steps
    stretches: Stretches

    @classmethod
    def of(cls, labelled: LabelledSet, trials: Trials) -> ConsecutiveMerges:
        """Of pairs of vessels with identities in frames with times."""
        pair = _identities(labelled, trials.vessels)
        return cls(
            trials,
            steps_of(labelled.images, trials.image, pair),
            stretches_of_things(labelled.images, trials.image, pair, np.zeros(len(pair), dtype=np.int64)),
        )

    def products(self) -> Consecutive:
        """Products of the deviations from the mean share.

        A case of which it is not sure whether the pair was tried counts by its weight. It has only hits, so the
        squares of deviations are those of as many hits and misses.
        """
        hits, weight = self.trials.hits, self.trials.weight
        share = float(np.clip(hits.sum() / max(weight.sum(), 1e-12), 0, 1))
        residual = hits - share * weight
        squares = hits * (1 - share) ** 2 + (weight - hits) * share**2
        a, b = self.steps.earlier, self.steps.later
        return Consecutive(
            residual[a] * residual[b], squares[a] * weight[b], self.steps.apart_s, self.trials.image[b], self.stretches
        )

    def inflation(self, correlation_s: float) -> float:
        """Variance of the mean share with a correlation time, over that of independent pairs."""
        return inflation(self.steps, len(self.trials.image), correlation_s)


def _identities(labelled: LabelledSet, vessels: Indices) -> Indices:
    """A number for the same two vessels, whichever comes first, −1 where one has no identity; shape (n,)."""
    both = np.sort(labelled.annotations.identity[vessels], axis=1)
    _, pair = np.unique(both, axis=0, return_inverse=True)
    return np.where(both[:, 0] >= 0, pair.ravel(), -1)
