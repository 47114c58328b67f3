"""Mean, standard deviations and correlations of box errors from errors that were cut down box by box.

Under the asked law the errors of a box are an exponential family in their four values and ten products, truncated to
what the box allows. What is left after the expectation of those fourteen numbers, box by box, is taken away has mean
zero and a known covariance, whatever the boxes. One step from the asked parameters along the inverse information is
the test of each parameter with all others free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes
from modsim3d.detector.model import PerformanceState
from modsim3d.learn.truncation import Accepted, accepted_errors

FIRST, SECOND = np.triu_indices(4)
PAIRS = tuple((i, j) for i in range(4) for j in range(i + 1, 4))
_FAR, _STEPS = 4.5, 6
_SINGULAR = 1e10
_SKEWNESS_BOXES = 100  # about as many, from which the skewness is taken


@dataclass(frozen=True, eq=False)
class NormalLaw:
    """A normal law of box errors before it is cut.

    Attributes:
        mean: In pixels, or in sides of the box where relative, shape (4,).
        std: Likewise, shape (4,), all positive.
        correlation: Shape (4, 4), not singular.
        relative: Whether errors are in sides of the box.
        growth: By how many pixels each standard deviation grows with each pixel of the side, shape (4,).
    """

    mean: Array
    std: Array
    correlation: Array
    relative: bool = False
    growth: Array = field(default_factory=lambda: np.zeros(4))

    @classmethod
    def of(cls, state: PerformanceState) -> NormalLaw:
        """That of a performance state."""
        asked = state.box_error
        correlation = asked.covariance / np.outer(asked.std, asked.std)
        return cls(asked.mean, asked.std, correlation, asked.relative, asked.growth)

    @property
    def growing(self) -> Indices:
        """Components whose standard deviations grow."""
        return np.flatnonzero(self.growth > 0)

    def at(self, boxes_px: Array) -> tuple[Array, Array]:
        """Means and standard deviations of boxes in pixels, shapes (n, 4)."""
        sides = np.tile(sizes(boxes_px), 2)
        if self.relative:
            return self.mean * sides, self.std * sides
        return np.broadcast_to(self.mean, sides.shape), self.std + self.growth * sides

    def gains(self, boxes_px: Array) -> tuple[Indices, Array]:
        """Which direction each parameter moves, and how much of it box by box, shapes (p,) and (n, p)."""
        of = np.concatenate([np.arange(14), 4 + self.growing])
        gains = np.ones((len(boxes_px), len(of)))
        if len(self.growing):
            _, stds = self.at(boxes_px)
            share = self.std / stds
            gains[:, :4], gains[:, 4:8] = share, share
            gains[:, 14:] = (np.tile(sizes(boxes_px), 2) / stds)[:, self.growing]
        return of, gains

    def numbers(self) -> Array:
        """Four means, four standard deviations, six correlations, then the growths that are not zero."""
        correlations = [self.correlation[i, j] for i, j in PAIRS]
        return np.concatenate([self.mean, self.std, correlations, self.growth[self.growing]])

    def units(self) -> Array:
        """What a step of one is worth in these numbers."""
        return np.concatenate([self.std, self.std, np.ones(6 + len(self.growing))])

    def moved(self, step: Array) -> NormalLaw:
        """Another law a step away: means in standard deviations, standard deviations in parts of themselves."""
        shrink = min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        correlation = self.correlation.copy()
        for value, (i, j) in zip(shrink * step[8:14], PAIRS, strict=True):
            correlation[i, j] = correlation[j, i] = np.clip(correlation[i, j] + value, -0.99, 0.99)
        values, vectors = np.linalg.eigh(correlation)
        if values[0] < 1e-3:  # the step has left what correlations can be
            correlation = (vectors * np.maximum(values, 1e-3)) @ vectors.T
            scale = np.sqrt(np.diag(correlation))
            correlation = correlation / np.outer(scale, scale)
        growth = self.growth.copy()
        growth[self.growing] = np.maximum(growth[self.growing] + shrink * step[14:], 1e-6)
        mean, std = self.mean + shrink * step[:4] * self.std, self.std * np.exp(shrink * step[4:8])
        return replace(self, mean=mean, std=std, correlation=correlation, growth=growth)


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


def _points(law: NormalLaw, boxes_px: Array, images_px: Array) -> Iterator[tuple[Accepted, Array]]:
    """Points of the truncated law of boxes, some at a time, and the fourteen numbers at each."""
    means, stds = law.at(boxes_px)
    covariances = law.correlation * stds[:, :, None] * stds[:, None, :]
    for part in accepted_errors(boxes_px, images_px, means, covariances):
        standard = (part.errors - means[part.rows, None]) / stds[part.rows, None]
        yield part, statistics(standard)


class MomentTable:
    """Expectations of the fourteen numbers and of their products, box by box.

    Boxes that were asked for before under the same law are not integrated again: many seeds over one truth cost
    hardly more than one.
    """

    def __init__(self) -> None:
        """Nothing known yet."""
        self._known: dict[bytes, tuple[Mask, Array, Array, Array]] = {}

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
        key, size = bytes([law.relative]) + law.numbers().tobytes(), len(boxes_px)
        if key not in self._known:
            empty = np.empty((size, 14)), np.empty((size, 14, 14)), np.empty(size)
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

    def standardised(self, law: NormalLaw) -> Array:
        """The errors in the standard deviations of a law, box by box, shape (n, 4)."""
        means, stds = law.at(self.boxes_px[self.rows])
        result: Array = (self.errors_px - means) / stds
        return result


@dataclass(frozen=True, eq=False)
class ErrorFit:
    """What one pass over the boxes says about the p parameters, in the units of `NormalLaw.moved`.

    Attributes:
        step: From the law towards the largest likelihood, shape (p,).
        errors: Standard errors of the step under the law if errors do not persist, shape (p,).
        skewness: Of each entry of the step, shape (p,).
        weights: Of the fourteen numbers in the score of each parameter, before `gains`, shape (p, 14).
        covariance: Inverse of the information, shape (p, p).
        gains: Box by box, shape (n, p).
        expected: Of the fourteen numbers, shape (n, 14).
        whitened: Errors less their expectation, made independent with variance one, shape (n, 4).
        roots: Inverse roots that did so, shape (n, 4, 4).
        acceptance: Chance of each box that a first draw counts, shape (n,).
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

    def step_of(self, numbers: Array) -> Array:
        """The step that other numbers would have given, shape (..., p), from (..., n, 14)."""
        scores = (numbers - self.expected) @ self.weights.T * self.gains
        step: Array = scores.sum(axis=-2) @ self.covariance
        return step


def fit_step(law: NormalLaw, sample: ErrorSample, table: MomentTable) -> ErrorFit | None:
    """One step of the fit.

    Args:
        law: Where it starts: what was asked for.
        sample: What was found.
        table: Of the truth that the sample is of.

    Returns:
        None where the errors say nothing about some parameter.
    """
    boxes = sample.boxes_px[sample.rows]
    of, gains = law.gains(boxes)
    weights = directions(law.correlation)[of]
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
    found = sample.standardised(law)
    residuals = statistics(found) - expected
    step = covariance @ ((residuals @ weights.T) * gains).sum(axis=0)
    errors = np.sqrt(np.diag(covariance))
    skewness = _third_cumulants(law, sample, weights, covariance) / errors**3
    roots = _inverse_roots(covariances[:, :4, :4])
    return ErrorFit(
        step=step,
        errors=errors,
        skewness=skewness,
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


def _third_cumulants(law: NormalLaw, sample: ErrorSample, weights: Array, covariance: Array) -> Array:
    """Of the step, shape (p,), from some of the boxes."""
    rows = sample.rows[:: max(1, len(sample.rows) // _SKEWNESS_BOXES)]
    _, gains = law.gains(sample.boxes_px[rows])
    third = np.zeros(len(covariance))
    for part, values in _points(law, sample.boxes_px[rows], sample.images_px[rows]):
        influence = ((values @ weights.T) * gains[part.rows, None]) @ covariance
        influence = influence - part.mean(influence)[:, None, :]
        third += part.mean(influence**3).sum(axis=0)
    return third * len(sample.rows) / len(rows)


def fitted_law(law: NormalLaw, fit: ErrorFit, sample: ErrorSample) -> NormalLaw:
    """The law of largest likelihood, one step away or, where that is far, as many as it takes."""
    if np.abs(fit.step / fit.errors).max() < _FAR:
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
