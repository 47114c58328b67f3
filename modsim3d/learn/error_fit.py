"""Mean, standard deviations and correlations of box errors from errors that were cut down box by box.

Under the asked law the errors of a box are an exponential family in their four values and ten products, truncated to
what the box allows. What is left after the expectation of those fourteen numbers, box by box, is taken away has mean
zero and a known covariance, whatever the boxes. One step from the asked parameters along the inverse information is
the test of each parameter with all others free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modsim3d.detector.records import Array, Indices
from modsim3d.learn.truncation import accepted_errors

FIRST, SECOND = np.triu_indices(4)
PAIRS = tuple((i, j) for i in range(4) for j in range(i + 1, 4))
_FAR, _STEPS = 4.5, 6
_SKEWNESS_BOXES = 100  # about as many, from which the skewness is taken


@dataclass(frozen=True, eq=False)
class NormalLaw:
    """A normal law of box errors before it is cut.

    Attributes:
        mean: Shape (4,).
        std: Shape (4,), all positive.
        correlation: Shape (4, 4), not singular.
    """

    mean: Array
    std: Array
    correlation: Array

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> NormalLaw:
        """From mean and covariance."""
        std = np.sqrt(np.diag(covariance))
        return cls(np.asarray(mean, dtype=np.float64), std, covariance / np.outer(std, std))

    @property
    def covariance(self) -> Array:
        """Shape (4, 4)."""
        return self.correlation * np.outer(self.std, self.std)

    def numbers(self) -> Array:
        """Four means, four standard deviations, six correlations, shape (14,)."""
        return np.concatenate([self.mean, self.std, [self.correlation[i, j] for i, j in PAIRS]])

    def moved(self, step: Array) -> NormalLaw:
        """Another law a step away: means in standard deviations, standard deviations in parts of themselves."""
        shrink = min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        correlation = self.correlation.copy()
        for value, (i, j) in zip(shrink * step[8:], PAIRS, strict=True):
            correlation[i, j] = correlation[j, i] = np.clip(correlation[i, j] + value, -0.99, 0.99)
        values, vectors = np.linalg.eigh(correlation)
        if values[0] < 1e-3:  # the step has left what correlations can be
            correlation = (vectors * np.maximum(values, 1e-3)) @ vectors.T
            scale = np.sqrt(np.diag(correlation))
            correlation = correlation / np.outer(scale, scale)
        return NormalLaw(self.mean + shrink * step[:4] * self.std, self.std * np.exp(shrink * step[4:8]), correlation)


def directions(correlation: Array) -> Array:
    """Derivatives of the log-likelihood as weights of four values and ten products, shape (14, 14).

    Of a change of each mean in standard deviations, of the logarithm of each standard deviation, and of each
    correlation, for errors standardised by the law.
    """
    precision = np.linalg.inv(correlation)
    weights = np.zeros((14, 14))
    weights[:4, :4] = precision
    for row in range(10):
        change = np.zeros((4, 4))
        if row < 4:
            change[row, :] += correlation[row, :]
            change[:, row] += correlation[:, row]
        else:
            i, j = PAIRS[row - 4]
            change[i, j] = change[j, i] = 1
        quadratic = precision @ change @ precision
        weights[4 + row, 4:] = np.where(FIRST == SECOND, 0.5, 1) * quadratic[FIRST, SECOND]
    return weights


def statistics(standardised: Array) -> Array:
    """Four values and their ten products, shape (..., 14)."""
    return np.concatenate([standardised, standardised[..., FIRST] * standardised[..., SECOND]], axis=-1)


class MomentTable:
    """Expectations of the fourteen numbers and of their products, box by box.

    Boxes that were asked for before under the same law are not integrated again: many seeds over one truth cost
    hardly more than one.
    """

    def __init__(self) -> None:
        """Nothing known yet."""
        self._known: dict[bytes, tuple[NDArray[np.bool_], Array, Array, Array]] = {}

    def branch(self) -> MomentTable:
        """A table that knows what this one does, and keeps further laws to itself."""
        branch = MomentTable()
        branch._known = dict(self._known)
        return branch

    def of(self, law: NormalLaw, boxes_px: Array, images_px: Array, rows: Indices) -> tuple[Array, Array, Array]:
        """Moments of some of the boxes of a truth.

        Args:
            law: Before it is cut.
            boxes_px: All of the truth, the same whenever this table is asked, shape (N, 4).
            images_px: Shape (N, 2).
            rows: Which of them, shape (n,).

        Returns:
            Expectations of shape (n, 14), of products (n, 14, 14), and acceptance (n,).
        """
        key, size = law.numbers().tobytes(), len(boxes_px)
        if key not in self._known:
            empty = np.empty((size, 14)), np.empty((size, 14, 14)), np.empty(size)
            self._known[key] = (np.zeros(size, dtype=bool), *empty)
        known, first, second, acceptance = self._known[key]
        missing = np.unique(rows[~known[rows]])
        for part in accepted_errors(boxes_px[missing], images_px[missing], law.mean, law.covariance):
            values = statistics((part.errors - law.mean) / law.std)
            into = missing[part.rows]
            first[into] = part.mean(values)
            second[into] = np.swapaxes(values, 1, 2) @ (values * part.weights[..., None])
            acceptance[into] = part.acceptance
        known[missing] = True
        return first[rows], second[rows], acceptance[rows]


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """Errors found in a state.

    Attributes:
        errors_px: Shape (n, 4).
        rows: Of the truth, of each, shape (n,).
        boxes_px: The truth's boxes that errors were added to, shape (N, 4).
        images_px: Their images' width and height, shape (N, 2).
    """

    errors_px: Array
    rows: Indices
    boxes_px: Array
    images_px: Array


@dataclass(frozen=True, eq=False)
class ErrorFit:
    """What one pass over the boxes says about the parameters, in the units of `NormalLaw.moved`.

    Attributes:
        step: From the law towards the largest likelihood, shape (14,).
        covariance: Of the step under the law, shape (14, 14).
        skewness: Of each entry of the step, shape (14,).
        residuals: Errors less their expectation, in the law's standard deviations, shape (n, 4).
        variances: Of these, shape (n, 4).
        acceptance: Chance of each box that a first draw counts, shape (n,).
    """

    step: Array
    covariance: Array
    skewness: Array
    residuals: Array
    variances: Array
    acceptance: Array


def fit_step(law: NormalLaw, sample: ErrorSample, table: MomentTable) -> ErrorFit | None:
    """One step of the fit.

    Args:
        law: Where it starts: what was asked for.
        sample: What was found.
        table: Of the truth that the sample is of.

    Returns:
        None where the errors say nothing about some parameter.
    """
    weights = directions(law.correlation)
    found = statistics((sample.errors_px - law.mean) / law.std)
    expected, products, acceptance = table.of(law, sample.boxes_px, sample.images_px, sample.rows)
    residuals = found - expected
    variances = expected[:, [4, 8, 11, 13]] - expected[:, :4] ** 2
    information = weights @ (products.sum(axis=0) - expected.T @ expected) @ weights.T
    if not np.all(np.isfinite(information)) or np.linalg.cond(information) > 1e10:
        return None
    covariance = np.linalg.inv(information)
    influence = covariance @ weights
    skewness = _third_cumulants(law, sample, influence) / np.diag(covariance) ** 1.5
    step = influence @ residuals.sum(axis=0)
    return ErrorFit(step, covariance, skewness, residuals[:, :4], variances, acceptance)


def _third_cumulants(law: NormalLaw, sample: ErrorSample, influence: Array) -> Array:
    """Of the step, shape (14,), from some of the boxes."""
    rows = sample.rows[:: max(1, len(sample.rows) // _SKEWNESS_BOXES)]
    third = np.zeros(14)
    for part in accepted_errors(sample.boxes_px[rows], sample.images_px[rows], law.mean, law.covariance):
        values = statistics((part.errors - law.mean) / law.std) @ influence.T
        values = values - part.mean(values)[:, None, :]
        third += part.mean(values**3).sum(axis=0)
    return third * len(sample.rows) / len(rows)


def fitted_law(law: NormalLaw, fit: ErrorFit, sample: ErrorSample) -> NormalLaw:
    """The law of largest likelihood, one step away or, where that is far, as many as it takes."""
    if np.abs(fit.step / np.sqrt(np.diag(fit.covariance))).max() < _FAR:
        return law.moved(fit.step)
    step: ErrorFit | None = fit
    for _ in range(_STEPS):
        if step is None:
            break
        law = law.moved(step.step)
        if np.abs(step.step).max() < 1e-3:
            break
        step = fit_step(law, sample, MomentTable())
    return law
