"""The parameters of box errors, estimated from errors that were truncated box by box. The derivatives of the
log-likelihood by the parameters are sums of statistics of the errors. Under the law in the file, truncated to what the
box allows, each statistic less its expectation has mean zero and a known covariance, whatever the boxes. One step from
the parameters in the file along the inverse information is the score test of each parameter with all others free."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.confidence import drawn_levels
from modsim3d.detector.draws import poisson_quantile
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import FALSE_POSITIVE
from modsim3d.detector.truncation import AcceptedErrors, accepted_errors
from modsim3d.verify.class_checks import expected_outcomes
from modsim3d.verify.confidence_checks import levels_of, scored
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.evidence import Evidence, unknown_rest_note
from modsim3d.verify.false_positive_checks import RATE_CHECKS, expected_false_positives

_FAR, _STEPS, _SETTLED = 4.5, 6, 1e-3
_SINGULAR = 1e10
_SKEWNESS_BOXES = 100  # the skewness is computed from about as many boxes


def _points(law: ErrorParameters, boxes_px: Array, images_px: Array) -> Iterator[tuple[AcceptedErrors, Array]]:
    """Points of the truncated law of some of the boxes at a time, and the statistics (rows, points, m) at each."""
    means, stds = law.at(boxes_px)
    covariances = law.correlation * stds[:, :, None] * stds[:, None, :]
    for part in accepted_errors(boxes_px, images_px, means, covariances, law.distribution):
        errors = np.ascontiguousarray(part.errors)  # the order in memory decides the last digits of sums over points
        yield part, law.statistics((errors - means[part.rows, None]) / stds[part.rows, None])


class MomentTable:
    """Expectations of the statistics and their products for each law and box, kept for other seeds over one truth."""

    def __init__(self) -> None:
        """Start empty."""
        self._known: dict[bytes, tuple[Mask, Array, Array, Array]] = {}

    def branch(self) -> MomentTable:
        """A copy of this table; laws that it adds are not added here."""
        branch = MomentTable()
        branch._known = dict(self._known)
        return branch

    def of(self, law: ErrorParameters, boxes_px: Array, images_px: Array, rows: Indices) -> tuple[Array, Array, Array]:
        """Moments of n rows of a truth under a law truncated to what each box allows. Boxes (N, 4) and sizes of their
        images (N, 2) are the whole truth, the same in each call. Returns expectations of the m statistics, shape
        (n, m), of their products (n, m, m), and acceptance (n,)."""
        key = repr((law.distribution, law.relative)).encode() + law.numbers().tobytes()
        if key not in self._known:
            size, m = len(boxes_px), law.statistics(np.zeros(4)).size
            empty = np.empty((size, m)), np.empty((size, m, m)), np.empty(size)
            self._known[key] = (np.zeros(size, dtype=bool), *empty)
        filled, first, second, acceptance = self._known[key]
        missing = np.unique(rows[~filled[rows]])
        for part, values in _points(law, boxes_px[missing], images_px[missing]):
            into = missing[part.rows]
            first[into] = part.mean(values)
            second[into] = np.swapaxes(values, 1, 2) @ (values * part.weights[..., None])
            acceptance[into] = part.acceptance
        filled[missing] = True
        return first[rows], second[rows], acceptance[rows]


@dataclass(frozen=True, eq=False)
class StateErrors:
    """Errors (n, 4) of a state, their rows (n,) of the truth, and the truth's boxes (N, 4) and image sizes (N, 2)."""

    errors_px: Array
    rows: Indices
    boxes_px: Array
    images_px: Array

    def standardised(self, law: ErrorParameters) -> Array:
        """The errors less the means of a law, in its standard deviations, shape (n, 4)."""
        means, stds = law.at(self.boxes_px[self.rows])
        return (self.errors_px - means) / stds


@dataclass(frozen=True, eq=False)
class FitStep:
    """Result of one pass over n boxes for the p parameters, in the units of `ErrorParameters.moved`."""

    step: Array  # from the law towards the largest likelihood, shape (p,)
    errors: Array  # standard errors of the step under the law if errors do not persist, shape (p,)
    skewness: Array
    weights: Array  # of the m statistics in the score of each parameter, before `gains`, shape (p, m)
    covariance: Array  # inverse of the information, shape (p, p)
    gains: Array  # factors on the scores, box by box, shape (n, p)
    expected: Array  # expectation of the statistics, shape (n, m)
    whitened: Array  # the first four statistics, centred and made independent with variance one, shape (n, 4)
    roots: Array  # inverse roots that whiten, shape (n, 4, 4)
    acceptance: Array  # probability that a first draw of each box counts, shape (n,)

    def step_of(self, statistics: Array) -> Array:
        """The step that other statistics of shape (..., n, m) would have given, shape (..., p)."""
        scores = (statistics - self.expected) @ self.weights.T * self.gains
        return np.asarray(scores.sum(axis=-2) @ self.covariance)


def fit_step(law: ErrorParameters, sample: StateErrors, table: MomentTable) -> FitStep | None:
    """One step of the fit from a law to a sample of the table's truth; None where errors miss a parameter."""
    weights, gains = law.score_weights(sample.boxes_px[sample.rows])
    expected, products, acceptance = table.of(law, sample.boxes_px, sample.images_px, sample.rows)
    covariances = products - expected[:, :, None] * expected[:, None, :]
    if np.all(gains == 1):
        information = weights @ covariances.sum(axis=0) @ weights.T
    else:
        matrices = np.einsum("pi,nij,qj->npq", weights, covariances, weights, optimize=True)
        information = np.einsum("npq,np,nq->pq", matrices, gains, gains, optimize=True)
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
    return np.linalg.inv(np.linalg.cholesky(covariances + 1e-9 * np.maximum(scale, 1e-12) * np.eye(4)))


def _third_cumulants(law: ErrorParameters, sample: StateErrors, weights: Array, covariance: Array) -> Array:
    """Third cumulants of the step, shape (p,), estimated from some of the boxes."""
    rows = sample.rows[:: max(1, len(sample.rows) // _SKEWNESS_BOXES)]
    _, gains = law.score_weights(sample.boxes_px[rows])
    third = np.zeros(len(covariance))
    for part, values in _points(law, sample.boxes_px[rows], sample.images_px[rows]):
        influence = ((values @ weights.T) * gains[part.rows, None]) @ covariance
        influence = influence - part.mean(influence)[:, None, :]
        third += part.mean(influence**3).sum(axis=0)
    return third * len(sample.rows) / len(rows)


def fitted_law(law: ErrorParameters, step: FitStep, sample: StateErrors) -> ErrorParameters:
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
    """Box errors of a state: the law asked for, the law found, the step between, and the sample's detections (n,)."""

    law: ErrorParameters
    found: ErrorParameters
    step: FitStep
    sample: StateErrors
    rows: Indices


# ---- What is left of each random draw of a run once its law is taken away ----

NO_VESSEL = -1
_MIN_OF_STATE = 30  # rows of a state with fewer are left out: they cannot show the state's own mean and spread
_MIN_LEVEL = 1e-12
_MANY, _NO_CAP = 10.0, 1 << 30
_CAP = 0.9  # level at which small Poisson numbers are capped: products of rare large ones have no nearly normal sum


class Draw(StrEnum):
    """Drawn errors."""

    BOX_ERROR = "box errors"
    MISS = "misses"
    CONFIDENCE = "confidence"
    FALSE_POSITIVES = "false positives"


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one kind of draw; n rows, of c numbers each."""

    draw: Draw
    image: Indices  # row of `FrameTable`, shape (n,)
    vessel: Indices  # `NO_VESSEL` for a false positive, 0 for a number of false positives, shape (n,)
    values: Array  # less their expectation, shape (n, c)
    variance: Array  # of each number of a row, shape (n,)
    third: Array  # third central moments, shape (n, c)
    correlation_s: float = 0.0  # time in which a vessel's correlation falls to 1/e; 0 for independent draws
    continuous: bool = False  # whether squares of the values say anything that the values do not
    note: str = ""  # why there are none; empty if there are

    def of_vessels(self) -> Residuals:
        """The rows that belong to a vessel."""
        rows = np.flatnonzero(self.vessel != NO_VESSEL)
        names = ("image", "vessel", "values", "variance", "third")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def none_of(draw: Draw, note: str) -> Residuals:
    """No residuals, and why."""
    nobody, nothing = np.empty(0, dtype=np.int64), np.empty((0, 1))
    return Residuals(draw, nobody, nobody, nothing, np.empty(0), nothing, note=note)


def residuals_of(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> list[Residuals]:
    """The residuals of every kind of draw, given the fits of box errors."""
    return [
        box_error_residuals(model, evidence, fits),
        miss_residuals(model, evidence),
        confidence_residuals(model, evidence),
        false_positive_residuals(model, evidence),
    ]


def box_error_residuals(model: DetectorModel, evidence: Evidence, fits: Sequence[StateFit]) -> Residuals:
    """Whitened box errors, four of each detection that is one box of one vessel."""
    if not fits:
        return none_of(Draw.BOX_ERROR, "")
    instance = evidence.true_detections.instance[np.concatenate([fit.rows for fit in fits])]
    values = np.concatenate([fit.step.whitened for fit in fits])
    images, vessels = evidence.images_of(instance), evidence.instances.vessel[instance]
    return _standardised(Draw.BOX_ERROR, evidence, images, vessels, values, model.persistence.box_memory_s)


def miss_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Misses (1 or 0) less their probability, of each chance that could have gone either way."""
    note = unknown_rest_note(model, evidence)
    if note:
        return none_of(Draw.MISS, note)
    expected, instances = expected_outcomes(model, evidence), evidence.instances
    rows = np.flatnonzero(expected.tested & (expected.missed > 0) & (expected.missed < 1))
    p = expected.missed[rows]
    variance = p * (1 - p)
    values = _centred((instances.outcome[rows] == -1) - p, variance, instances.state[rows])
    images, third = evidence.images_of(rows), (variance * (1 - 2 * p))[:, None]
    memory_s = model.persistence.class_memory_s
    return Residuals(Draw.MISS, images, instances.vessel[rows], values[:, None], variance, third, memory_s)


def false_positive_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Number of transient false positives of each image, small numbers capped, less its expectation."""
    note = unknown_rest_note(model, evidence)
    if note or model.false_positives.model not in RATE_CHECKS:
        return none_of(Draw.FALSE_POSITIVES, note)
    expected, images = expected_false_positives(model, evidence), evidence.frames
    rows = np.flatnonzero(expected.transient > 0)
    mean, dispersion = expected.transient[rows], expected.dispersion[rows]
    poisson = (dispersion == 1) & (mean < _MANY)
    counts, cap = n_transient(evidence)[rows], np.full(len(rows), _NO_CAP)
    cap[poisson] = np.maximum(poisson_quantile(np.full(int(poisson.sum()), _CAP), mean[poisson]), 1)
    variance = mean * dispersion
    third = variance * (2 * dispersion - 1)
    mean[poisson], variance[poisson], third[poisson] = capped_poisson(mean[poisson], cap[poisson])
    values = _centred(np.minimum(counts, cap) - mean, variance, images.state[rows])
    vessel = np.zeros(len(rows), dtype=np.int64)
    return Residuals(Draw.FALSE_POSITIVES, rows, vessel, values[:, None], variance, third[:, None])


def capped_poisson(means: Array, caps: Indices) -> tuple[Array, Array, Array]:
    """Mean, variance and third central moment of Poisson numbers cut down to caps of 1 or more, shapes (n,)."""
    counts = np.arange(int(caps.max(initial=0)) + 1)
    chances = np.where(counts < caps[:, None], special.pdtr(counts, means[:, None]), 1.0)
    chances = np.diff(chances, axis=1, prepend=0.0)
    mean: Array = chances @ counts.astype(np.float64)
    rest = counts - mean[:, None]
    return mean, (chances * rest**2).sum(axis=1), (chances * rest**3).sum(axis=1)


def n_transient(evidence: Evidence) -> Indices:
    """Number of false positives of each image that are no second boxes and do not persist, shape (s,)."""
    false = evidence.false_positives
    return np.bincount(false.frame_row[false.kind == FALSE_POSITIVE], minlength=len(evidence.frames.state))


def confidence_residuals(model: DetectorModel, evidence: Evidence) -> Residuals:
    """Normal numbers at the levels that confidences have in their laws; at the ends of the range they are drawn."""
    note = unknown_rest_note(model, evidence)
    if note:
        return none_of(Draw.CONFIDENCE, note)
    rng, true, false = np.random.default_rng(0), evidence.true_detections, evidence.false_positives
    parts: list[tuple[Indices, Indices, Array]] = []
    for s, state in enumerate(model.states):
        law = state.confidence
        instance = true.instance[evidence.instances.state[true.instance] == s]
        row = false.frame_row[false.state == s]
        vessels = evidence.images_of(instance), evidence.instances.vessel[instance]
        places = vessels, (row, np.full(len(row), NO_VESSEL))
        for scores, sample, place in zip((law.true, law.false), scored(evidence, s, law), places, strict=True):
            levels = levels_of(law, scores, sample)
            if levels is not None:
                level = drawn_levels(levels, sample.scores, model.confidence_threshold, rng)
                parts.append((*place, special.ndtri(np.clip(level, _MIN_LEVEL, 1 - _MIN_LEVEL))))
    if not parts:
        return none_of(Draw.CONFIDENCE, "")
    image, vessel, values = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    kept_s = model.persistence.confidence_memory_s
    return _standardised(Draw.CONFIDENCE, evidence, image, vessel, values[:, None], kept_s)


def _standardised(
    draw: Draw, evidence: Evidence, image: Indices, vessel: Indices, values: Array, correlation_s: float
) -> Residuals:
    """Residuals with mean zero and variance one in each state: a state's wrong mean must not look like a pattern."""
    state = evidence.frames.state[image]
    scaled, kept = np.zeros_like(values), np.zeros(len(values), dtype=bool)
    for s in np.unique(state):
        rows = np.flatnonzero(state == s)
        spread = values[rows].std(axis=0)
        if len(rows) >= _MIN_OF_STATE and (spread > 0).all():
            scaled[rows], kept[rows] = (values[rows] - values[rows].mean(axis=0)) / spread, True
    if not kept.any():
        return none_of(draw, "")
    scaled = scaled[kept]
    third = np.tile((scaled**3).mean(axis=0), (len(scaled), 1))
    return Residuals(draw, image[kept], vessel[kept], scaled, np.ones(len(scaled)), third, correlation_s, True)


def _centred(values: Array, variance: Array, state: Indices) -> Array:
    """Values less what a wrong rate of their state explains, shapes (n,)."""
    weight = np.bincount(state, variance)
    return values - (np.bincount(state, values) / np.where(weight > 0, weight, 1))[state] * variance
