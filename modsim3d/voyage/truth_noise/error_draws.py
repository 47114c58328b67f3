"""Covariances that errors of truth give to errors of boxes, drawn at random.

Errors of truth are not averaged out as those of a detector are: a vessel keeps its wrong length, and a wrong position
lasts for minutes. So what a voyage holds of them is itself a draw, and the learned covariance, about a mean, lacks what
all boxes have in common. Both are exact if the errors are drawn as they are, in time, and their covariances taken as
the learned one is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.truth_noise.noise import CONSTANT, SLOW, TruthNoise

_DRAWS_AT_ONCE = 20


@dataclass(frozen=True, eq=False)
class TruthErrors:
    """n true boxes and how they follow from their vessels.

    Attributes:
        jacobians: From `box_jacobians`, in the unit of the learned errors, shape (n, 4, 8).
        time_s: Time of each, shape (n,).
        vessel: Index of each vessel, shape (n,).
        noise: How well the vessels are known.
    """

    jacobians: Array
    time_s: Array
    vessel: Indices
    noise: TruthNoise

    def covariances(self, draws: int, seed: int) -> Array:
        """Covariance of the errors about their mean in each draw, shape (draws, 4, 4)."""
        rng, count = np.random.default_rng([seed, 23]), max(len(self.vessel) - 1, 1)
        found = [np.empty((0, 4, 4))]
        for errors in self._errors(rng, draws):
            about = errors - errors.mean(axis=1, keepdims=True)
            found.append(np.swapaxes(about, 1, 2) @ about / count)
        return np.concatenate(found)

    def _errors(self, rng: np.random.Generator, draws: int) -> Iterator[Array]:
        """Errors of the boxes, some draws at a time, shape (some, n, 4)."""
        times, frame = np.unique(self.time_s, return_inverse=True)
        frame = frame.ravel()
        std = self.noise.std[self.vessel]
        slow_j = (self.jacobians * std[:, None])[..., SLOW]
        constant_j = (self.jacobians * std[:, None])[..., CONSTANT]
        kept = np.exp(-np.diff(times, prepend=times[:1]) / self.noise.position_s)
        vessels, constants = len(self.noise.std), CONSTANT.stop - CONSTANT.start
        for first in range(0, draws, _DRAWS_AT_ONCE):
            some = min(_DRAWS_AT_ONCE, draws - first)
            slow = rng.standard_normal((len(times), some, vessels, SLOW.stop))
            for k in range(1, len(times)):
                slow[k] = kept[k] * slow[k - 1] + np.sqrt(1 - kept[k] ** 2) * slow[k]
            own = rng.standard_normal((some, vessels, constants))
            errors: Array = np.einsum("nij,nsj->sni", slow_j, slow[frame, :, self.vessel])
            errors += np.einsum("nij,snj->sni", constant_j, own[:, self.vessel])
            yield errors
