"""Tests of clipped normal numbers against the mean and standard deviation asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.clipped_normal import clipped_laws, clipped_score
from modsim3d.verify.kept_scores import KeptScores
from modsim3d.verify.measures import AMOUNT, ANY, Estimate

_FAR, _STEPS = 4.5, 8  # an estimate farther off than this is refined by so many Newton steps
_SINGULAR = 1e10
LEAST_DETECTIONS = 50
"""Independent detections that a number needs."""
_LEVELS = 100
"""Means at which the integrals are computed; those between are interpolated."""


@dataclass(frozen=True, eq=False)
class Clipped:
    """Numbers (n,) clipped to [threshold, 1], whose means before clipping are the design (n, k) times coefficients.

    `kept` says which of them have kept a part of their deviation from one another; none have if None.
    """

    scores: Array
    design: Array
    threshold: float
    kept: KeptScores | None = None

    def measures(self, coefficients: Array, std: float) -> Sequence[Estimate | None]:
        """Estimates of the first coefficient, the standard deviation, and the other coefficients, shape (k,) in all.

        One step from the asked values towards the maximum likelihood, which is also the score test of each with the
        others free; several steps for an estimate that is far off.
        """
        information = self._information(self.design @ coefficients, std)
        step, covariance, third = self._step(coefficients, std, information)
        if step is None:
            return [None] * (len(coefficients) + 1)
        inflation = self._inflation(information, covariance)
        errors = np.sqrt(np.diag(covariance) * inflation)
        third = third * inflation**2
        z = step / errors
        asked = np.concatenate([coefficients[:1], [std], coefficients[1:]])
        found = asked + step
        if np.abs(z).max() > _FAR:
            found = self._fitted(asked)
        counts = [len(self.scores) if self.kept is None else len(self.scores) / part for part in inflation.tolist()]
        return [
            Estimate(
                found[k], asked[k], errors[k], count, third[k] / errors[k] ** 3, z[k], k == 1, AMOUNT if k == 1 else ANY
            )
            if self.kept is None or count >= LEAST_DETECTIONS
            else None
            for k, count in enumerate(counts)
        ]

    def _inflation(self, information: Array, covariance: Array) -> Array:
        """Variance of each estimate over that from independent numbers, in the order of `measures`."""
        if self.kept is None:
            return np.ones(len(covariance))
        design = np.insert(self.design, 1, 0.0, axis=1)
        of_mean = (design @ covariance) * np.sqrt(information[:, :1])
        of_std = np.sqrt(information[:, 2:]) * covariance[1]
        return self.kept.inflation(of_mean, of_std)

    def _fitted(self, value: Array) -> Array:
        for _ in range(_STEPS):
            coefficients = np.concatenate([value[:1], value[2:]])
            step, _, _ = self._step(coefficients, value[1], self._information(self.design @ coefficients, value[1]))
            if step is None:
                break
            value = value + np.clip(step, -0.5 * value[1], 0.5 * value[1])
        return value

    def _step(self, coefficients: Array, std: float, information: Array) -> tuple[Array | None, Array, Array]:
        """Step from the law towards the maximum likelihood, its covariance, and its third cumulants."""
        means = self.design @ coefficients
        # In this order: first coefficient, standard deviation, the others.
        design = np.insert(self.design, 1, 1.0, axis=1)
        of_std = np.arange(design.shape[1]) == 1
        score = clipped_score(self.scores, means, std, self.threshold)
        total = (design * np.where(of_std, score[:, 1:], score[:, :1])).sum(axis=0)
        part = np.where(
            of_std[:, None] & of_std,
            information[:, 2, None, None],
            np.where(of_std[:, None] | of_std, information[:, 1, None, None], information[:, 0, None, None]),
        )
        matrix = np.einsum("ni,nj,nij->ij", design, design, part)
        if not np.all(np.isfinite(matrix)) or np.linalg.cond(matrix) > _SINGULAR:
            return None, matrix, total
        covariance = np.linalg.inv(matrix)
        # From a few rows, spread evenly, that stand for all.
        rows = np.linspace(0, len(means) - 1, min(len(means), 64)).astype(np.int64)
        third = np.zeros(len(total))
        for row, chances, each in zip(rows, *self._laws(means[rows], std), strict=True):
            influence = (design[row] * np.where(of_std, each[:, 1:], each[:, :1])) @ covariance
            third += chances @ influence**3
        return covariance @ total, covariance, third * len(means) / len(rows)

    def _information(self, means: Array, std: float) -> Array:
        """Fisher information of mean and standard deviation of each number: mm, ms, ss; shape (n, 3)."""
        low, high = float(means.min()), float(means.max())
        levels = np.linspace(low, high, _LEVELS if high - low > 1e-12 else 1)
        table = np.empty((len(levels), 3))
        for k, (chances, score) in enumerate(zip(*self._laws(levels, std), strict=True)):
            table[k] = chances @ (score[:, [0, 0, 1]] * score[:, [0, 1, 1]])
        return np.column_stack([np.interp(means, levels, column) for column in table.T])

    def _laws(self, means: Array, std: float) -> tuple[Array, Array]:
        """Probabilities and scores at the nodes of the law of each mean, shapes (n, nodes) and (n, nodes, 2)."""
        places, chances = clipped_laws(means, std, self.threshold)
        return chances, clipped_score(places, means[:, None], std, self.threshold)
