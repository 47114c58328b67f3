"""Normal numbers that were clipped to a range, those outside moved to its ends (Tobin (1958)): tests and fits.

`Clipped` tests a mean that is linear in what it depends on, and a standard deviation, against values asked for;
`fit_clipped` finds both from sums, many times over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.learn.measures import Estimate

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_REACH = 9.0  # standard deviations that the integrals go to
_FAR, _STEPS = 4.5, 8  # an estimate farther off than this is refined by so many Newton steps
_SINGULAR = 1e10
_LEVELS = 100
"""Means at which the integrals are computed; those between are interpolated."""
_MOST_ROUNDS, _SETTLED = 400, 1e-10


@dataclass(frozen=True, eq=False)
class Clipped:
    """Clipped numbers and what their means depend on.

    Attributes:
        scores: Shape (n,).
        design: Their means are this times the coefficients, shape (n, k).
        threshold: Lower end.
    """

    scores: Array
    design: Array
    threshold: float

    def measures(self, coefficients: Array, std: float) -> Sequence[Estimate | None]:
        """Estimates of the first coefficient, the standard deviation, and the other coefficients.

        One step from the asked values towards the maximum likelihood, which is also the score test of each with the
        others free; several steps for an estimate that is far off.
        """
        step, covariance, third = self._step(coefficients, std)
        if step is None:
            return [None] * (len(coefficients) + 1)
        errors = np.sqrt(np.diag(covariance))
        z = step / errors
        asked = np.concatenate([coefficients[:1], [std], coefficients[1:]])
        found = asked + step
        if np.abs(z).max() > _FAR:
            found = self._fitted(asked)
        return [
            Estimate(found[k], asked[k], errors[k], len(self.scores), third[k] / errors[k] ** 3, z[k], grows=k == 1)
            for k in range(len(asked))
        ]

    def _fitted(self, value: Array) -> Array:
        for _ in range(_STEPS):
            step, _, _ = self._step(np.concatenate([value[:1], value[2:]]), value[1])
            if step is None:
                break
            value = value + np.clip(step, -0.5 * value[1], 0.5 * value[1])
        return value

    def _step(self, coefficients: Array, std: float) -> tuple[Array | None, Array, Array]:
        """Step, its covariance under the law, and its third cumulants."""
        means = self.design @ coefficients
        # In this order: first coefficient, standard deviation, the others.
        design = np.insert(self.design, 1, 1.0, axis=1)
        of_std = np.arange(design.shape[1]) == 1
        score = clipped_score(self.scores, means, std, self.threshold)
        total = (design * np.where(of_std, score[:, 1:], score[:, :1])).sum(axis=0)
        information = self._information(means, std)
        part = np.where(
            of_std[:, None] & of_std,
            information[:, 2, None, None],
            np.where(of_std[:, None] | of_std, information[:, 1, None, None], information[:, 0, None, None]),
        )
        matrix = np.einsum("ni,nj,nij->ij", design, design, part)
        if not np.all(np.isfinite(matrix)) or np.linalg.cond(matrix) > _SINGULAR:
            return None, matrix, total
        covariance = np.linalg.inv(matrix)
        # Of a few rows, spread evenly, as many as all stand for.
        rows = np.linspace(0, len(means) - 1, min(len(means), 64)).astype(np.int64)
        third = np.zeros(len(total))
        for row in rows:
            places, chances = _law(means[row], std, self.threshold)
            each = clipped_score(places, means[row], std, self.threshold)
            influence = (design[row] * np.where(of_std, each[:, 1:], each[:, :1])) @ covariance
            third += chances @ influence**3
        return covariance @ total, covariance, third * len(means) / len(rows)

    def _information(self, means: Array, std: float) -> Array:
        """Fisher information of mean and standard deviation of each number: mm, ms, ss; shape (n, 3)."""
        low, high = float(means.min()), float(means.max())
        levels = np.linspace(low, high, _LEVELS if high - low > 1e-12 else 1)
        table = np.empty((len(levels), 3))
        for k, mean in enumerate(levels):
            places, chances = _law(mean, std, self.threshold)
            score = clipped_score(places, mean, std, self.threshold)
            table[k] = chances @ (score[:, [0, 0, 1]] * score[:, [0, 1, 1]])
        return np.column_stack([np.interp(means, levels, column) for column in table.T])


def clipped_score(scores: Array, means: Array | float, std: float, threshold: float) -> Array:
    """Derivatives of the log-likelihood by mean and standard deviation, shape (n, 2)."""
    z = (scores - means) / std
    low, high = (threshold - np.asarray(means)) / std, (1 - np.asarray(means)) / std
    below, above = -_hazard(-low), _hazard(high)
    first = np.where(scores <= threshold, below, np.where(scores >= 1, above, z))
    second = np.where(scores <= threshold, below * low, np.where(scores >= 1, above * high, z**2 - 1))
    return np.stack([first, second], axis=-1) / std


def _hazard(z: Array) -> Array:
    """Normal density over the tail above z."""
    ratio: Array = np.exp(-(z**2) / 2 - special.log_ndtr(-z)) / np.sqrt(2 * np.pi)
    return ratio


def _law(mean: float, std: float, threshold: float) -> tuple[Array, Array]:
    """Quadrature nodes of the clipped law and their probabilities, shapes (nodes,)."""
    low, high = max((threshold - mean) / std, -_REACH), min((1 - mean) / std, _REACH)
    nodes, weights = np.zeros(0), np.zeros(0)
    if high > low:
        nodes = (low + high) / 2 + (high - low) / 2 * _NODES
        weights = (high - low) / 2 * _WEIGHTS * np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi)
    inside = np.clip(mean + std * nodes, threshold + 1e-15, 1 - 1e-15)
    ends = special.ndtr((threshold - mean) / std), special.ndtr(-(1 - mean) / std)
    return np.concatenate([[threshold], inside, [1.0]]), np.concatenate([[ends[0]], weights, [ends[1]]])


def clipped_sums(values: Array, low: float, high: float) -> Array:
    """The sums that the fit needs, of each number of shape (n,), shape (n, 5).

    Whether it is at the low end, at the high end and between, and there its value and square.
    """
    at_low, at_high = values <= low, values >= high
    inside = ~(at_low | at_high)
    return np.column_stack([at_low, at_high, inside, np.where(inside, values, 0), np.where(inside, values**2, 0)]) * 1.0


def fit_clipped(sums: Array, low: float, high: float) -> tuple[Array, Array]:
    """Mean and standard deviation of maximum likelihood, by expectation and maximisation (Dempster et al. (1977)).

    Args:
        sums: Of `clipped_sums`, shape (rows, 5).
        low: Lower end of the range; smaller numbers were moved to it.
        high: Upper end.

    Returns:
        Shapes (rows,); NaN where there is nothing.
    """
    below, above, inside, first, second = sums.T
    number = below + above + inside
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (below * low + above * high + first) / number
        std = np.sqrt(np.maximum((below * low**2 + above * high**2 + second) / number - mean**2, 1e-12))
        for _ in range(_MOST_ROUNDS):
            m_low, s_low = _tail((low - mean) / std, -1)
            m_high, s_high = _tail((high - mean) / std, 1)
            total = below * (mean + std * m_low) + above * (mean + std * m_high) + first
            squares = (
                below * (mean**2 + 2 * mean * std * m_low + std**2 * s_low)
                + above * (mean**2 + 2 * mean * std * m_high + std**2 * s_high)
                + second
            )
            new_mean = total / number
            new_std = np.sqrt(np.maximum(squares / number - new_mean**2, 1e-12))
            change = np.nanmax(np.abs(new_mean - mean) + np.abs(new_std - std), initial=0.0)
            mean, std = new_mean, new_std
            if change < _SETTLED:
                break
    return mean, std


def _tail(edge: Array, side: int) -> tuple[Array, Array]:
    """Mean and mean square of a standard normal number below (−1) or above (1) an edge, shapes of the edge."""
    away = side * edge
    hazard = _hazard(away)
    return side * hazard, 1 + away * hazard
