"""The parameters of box errors, estimated from errors that were truncated box by box.

The derivatives of the log-likelihood by the parameters are sums of statistics of the errors. Under the law in the file,
truncated to what the box allows, each statistic less its expectation has mean zero and a known covariance, whatever the
boxes. One step from the parameters in the file along the inverse information is the score test of each parameter with
all others free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.truncation import Accepted, accepted_errors
from modsim3d.verify.error_parameters import ErrorParameters

_FAR, _STEPS, _SETTLED = 4.5, 6, 1e-3
_SINGULAR = 1e10
_SKEWNESS_BOXES = 100  # the skewness is computed from about as many boxes


def _points(law: ErrorParameters, boxes_px: Array, images_px: Array) -> Iterator[tuple[Accepted, Array]]:
    """Points of the truncated law of some of the boxes at a time, and the statistics (rows, points, m) at each."""
    means, stds = law.at(boxes_px)
    covariances = law.correlation * stds[:, :, None] * stds[:, None, :]
    for part in accepted_errors(boxes_px, images_px, means, covariances, law.distribution):
        errors = np.ascontiguousarray(part.errors)  # the order in memory decides the last digits of sums over points
        standard = (errors - means[part.rows, None]) / stds[part.rows, None]
        yield part, law.statistics(standard)


class MomentTable:
    """Expectations of the statistics and of their products, box by box.

    They are kept for each law and box, so many seeds over one truth cost hardly more than one.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._known: dict[bytes, tuple[Mask, Array, Array, Array]] = {}

    def branch(self) -> MomentTable:
        """A copy of this table; laws that it adds are not added here."""
        branch = MomentTable()
        branch._known = dict(self._known)
        return branch

    def of(self, law: ErrorParameters, boxes_px: Array, images_px: Array, rows: Indices) -> tuple[Array, Array, Array]:
        """Moments of n rows of a truth under a law truncated to what each box allows.

        Boxes (N, 4) and sizes of their images (N, 2) are the whole truth, the same in each call. Returns expectations
        of the m statistics, shape (n, m), of their products (n, m, m), and acceptance (n,).
        """
        key = repr((law.distribution, law.relative)).encode() + law.numbers().tobytes()
        if key not in self._known:
            size, m = len(boxes_px), law.statistics(np.zeros(4)).size
            empty = np.empty((size, m)), np.empty((size, m, m)), np.empty(size)
            self._known[key] = (np.zeros(size, dtype=bool), *empty)
        known, first, second, acceptance = self._known[key]
        missing = np.unique(rows[~known[rows]])
        for part, values in _points(law, boxes_px[missing], images_px[missing]):
            into = missing[part.rows]
            first[into] = part.mean(values)
            second[into] = np.swapaxes(values, 1, 2) @ (values * part.weights[..., None])
            acceptance[into] = part.acceptance
        known[missing] = True
        return first[rows], second[rows], acceptance[rows]


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """Errors (n, 4) of a state, their rows (n,) of the truth, and the truth's boxes (N, 4) and image sizes (N, 2)."""

    errors_px: Array
    rows: Indices
    boxes_px: Array
    images_px: Array

    def standardised(self, law: ErrorParameters) -> Array:
        """The errors less the means of a law, in its standard deviations, shape (n, 4)."""
        means, stds = law.at(self.boxes_px[self.rows])
        result: Array = (self.errors_px - means) / stds
        return result


@dataclass(frozen=True, eq=False)
class FitStep:
    """What one pass over n boxes says about the p parameters, in the units of `ErrorParameters.moved`.

    Attributes:
        step: From the law towards the largest likelihood, shape (p,).
        errors: Standard errors of the step under the law if errors do not persist, shape (p,).
        weights: Weights of the m statistics in the score of each parameter, before `gains`, shape (p, m).
        covariance: Inverse of the information, shape (p, p).
        gains: Factors on the scores, box by box, shape (n, p).
        expected: Expectation of the statistics, shape (n, m).
        whitened: The first four statistics, centred and made independent with variance one, shape (n, 4).
        roots: Inverse roots that whiten, shape (n, 4, 4).
        acceptance: Probability that a first draw of each box counts, shape (n,).
    """

    step: Array
    errors: Array
    skewness: Array
    weights: Array
    covariance: Array
    gains: Array
    expected: Array
    whitened: Array
    roots: Array
    acceptance: Array

    def step_of(self, statistics: Array) -> Array:
        """The step that other statistics of shape (..., n, m) would have given, shape (..., p)."""
        scores = (statistics - self.expected) @ self.weights.T * self.gains
        step: Array = scores.sum(axis=-2) @ self.covariance
        return step


def fit_step(law: ErrorParameters, sample: ErrorSample, table: MomentTable) -> FitStep | None:
    """One step of the fit from a law to a sample; None where the errors say nothing about some parameter.

    The table is that of the sample's truth.
    """
    boxes = sample.boxes_px[sample.rows]
    weights, gains = law.score_weights(boxes)
    expected, products, acceptance = table.of(law, sample.boxes_px, sample.images_px, sample.rows)
    covariances = products - expected[:, :, None] * expected[:, None, :]
    if np.all(gains == 1):
        information = weights @ covariances.sum(axis=0) @ weights.T
    else:
        each = np.einsum("pi,nij,qj->npq", weights, covariances, weights, optimize=True)
        information = np.einsum("npq,np,nq->pq", each, gains, gains, optimize=True)
    if not np.all(np.isfinite(information)) or np.linalg.cond(information) > _SINGULAR:
        return None
    covariance = np.linalg.inv(information)
    residuals = law.statistics(sample.standardised(law)) - expected
    errors, roots = np.sqrt(np.diag(covariance)), _inverse_roots(covariances[:, :4, :4])
    return FitStep(
        step=covariance @ ((residuals @ weights.T) * gains).sum(axis=0),
        errors=errors,
        skewness=_third_cumulants(law, sample, weights, covariance) / errors**3,
        weights=weights,
        covariance=covariance,
        gains=gains,
        expected=expected,
        whitened=np.einsum("nij,nj->ni", roots, residuals[:, :4]),
        roots=roots,
        acceptance=acceptance,
    )


def _inverse_roots(covariances: Array) -> Array:
    """Lower triangular matrices that make errors of such covariances independent, shape (n, 4, 4)."""
    scale = np.einsum("nii->n", covariances)[:, None, None] / 4
    safe = covariances + 1e-9 * np.maximum(scale, 1e-12) * np.eye(4)
    inverse: Array = np.linalg.inv(np.linalg.cholesky(safe))
    return inverse


def _third_cumulants(law: ErrorParameters, sample: ErrorSample, weights: Array, covariance: Array) -> Array:
    """Third cumulants of the step, shape (p,), estimated from some of the boxes."""
    rows = sample.rows[:: max(1, len(sample.rows) // _SKEWNESS_BOXES)]
    _, gains = law.score_weights(sample.boxes_px[rows])
    third = np.zeros(len(covariance))
    for part, values in _points(law, sample.boxes_px[rows], sample.images_px[rows]):
        influence = ((values @ weights.T) * gains[part.rows, None]) @ covariance
        influence = influence - part.mean(influence)[:, None, :]
        third += part.mean(influence**3).sum(axis=0)
    return third * len(sample.rows) / len(rows)


def fitted_law(law: ErrorParameters, step: FitStep, sample: ErrorSample) -> ErrorParameters:
    """The law of maximum likelihood: one step away, or several steps where that is far."""
    if np.abs(step.step / step.errors).max() < _FAR:
        return law.moved(step.step)
    following: FitStep | None = step
    for _ in range(_STEPS):
        if following is None:
            break
        law = law.moved(following.step)
        if np.abs(following.step).max() < _SETTLED:
            break
        following = fit_step(law, sample, MomentTable())
    return law


@dataclass(frozen=True, eq=False)
class StateFit:
    """The box errors of a performance state: the law asked for, the law found, and the step between them.

    `rows` are the rows (n,) of `TrueDetections` that the sample is of.
    """

    law: ErrorParameters
    found: ErrorParameters
    step: FitStep
    sample: ErrorSample
    rows: Indices
