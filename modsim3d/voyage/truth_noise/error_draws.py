"""Covariances that errors of truth give to errors of boxes, drawn at random.

Errors of truth are not averaged out as those of a detector are: a vessel keeps its wrong length, and a wrong position
lasts for minutes. So what a voyage holds of them is itself a draw, and the learned covariance, about a mean, lacks what
all boxes have in common. Both are exact if the errors are drawn as they are, in time, and their covariances taken as
the learned one is.

Of a vessel that registration has put where its detections are, only what is left counts: how the errors change while
it is in view. So the same is fitted to the errors that are drawn, and taken off them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.truth_noise.noise import CONSTANT, SLOW, TruthNoise

_DRAWS_AT_ONCE = 20
_KNOWN_TO = 0.1
"""Share to which standard deviations of errors of truth are known themselves: they are rules of thumb."""
_SEEN = np.array([[1, 0, 0, 0], [0, 1, 0, 0.5]])
"""What registration looks at: bearing and waterline, from centre x, centre y, width and height."""
_MOVED = slice(6, 8)
"""The `PARAMETERS` that registration finds of a vessel."""
_LEAST_M = 0.01
_SEEN_PX = 3.0
"""Standard deviation of errors of bearing and waterline; it hardly matters where a vessel is seen often."""


@dataclass(frozen=True, eq=False)
class TruthErrors:
    """n true boxes and how they follow from their vessels.

    Attributes:
        jacobians: From `box_jacobians`, shape (n, 4, 8).
        time_s: Time of each, shape (n,).
        vessel: Index of each vessel, shape (n,).
        noise: How well the vessels are known.
        unit_px: Unit of the learned errors, shape (n, 4).
        moved: Number of the fit that has moved each, such as the camera and the vessel; −1 for none, shape (n,).
    """

    jacobians: Array
    time_s: Array
    vessel: Indices
    noise: TruthNoise
    unit_px: Array
    moved: Indices

    @property
    def change(self) -> Array:
        """Variance of that part of each error that changes with time, mean over the boxes, shape (4,)."""
        part = (self.jacobians * self.noise.std[self.vessel][:, None])[..., SLOW] / self.unit_px[..., None]
        variance: Array = (part**2).sum(axis=2).mean(axis=0)
        return variance

    def covariances(self, draws: int, seed: int) -> Array:
        """Covariance of the errors about their mean in each draw, shape (draws, 4, 4)."""
        rng, count = np.random.default_rng([seed, 23]), max(len(self.vessel) - 1, 1)
        found = [np.empty((0, 4, 4))]
        for errors in self._errors(rng, draws):
            about = errors - errors.mean(axis=1, keepdims=True)
            found.append(np.swapaxes(about, 1, 2) @ about / count)
        larger = 1 + _KNOWN_TO * special.ndtri((rng.permutation(draws) + 0.5) / max(draws, 1))
        covariances: Array = np.concatenate(found) * larger[:, None, None] ** 2
        return covariances

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
            for rows, slopes, fit in self._fits:
                seen = np.einsum("ij,snj->sni", _SEEN, errors[:, rows]).reshape(some, -1)
                errors[:, rows] -= np.einsum("nij,sj->sni", slopes, seen @ fit)
            yield errors / self.unit_px

    @cached_property
    def _fits(self) -> list[tuple[Indices, Array, Array]]:
        """Of each vessel that was moved its m rows, their slopes (m, 4, 2), and what is fitted from them, (2m, 2)."""
        fits = []
        for number in np.unique(self.moved[self.moved >= 0]).tolist():
            rows = np.flatnonzero(self.moved == number)
            slopes = self.jacobians[rows][..., _MOVED]
            seen = (_SEEN @ slopes).reshape(-1, 2) / _SEEN_PX
            expected_m = max(float(self.noise.std[self.vessel[rows[0]], 0]), _LEAST_M)
            inverse = np.linalg.inv(seen.T @ seen + np.eye(2) / expected_m**2)
            fits.append((rows, slopes, seen / _SEEN_PX @ inverse))
        return fits
