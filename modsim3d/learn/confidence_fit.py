"""Fit of confidences that fall with what is hidden of a vessel and with the size of its box, then are clipped.
Before it is clipped, a confidence is B − v·h − s·max(r − log₂ size, 0): B from the distribution of its kind (true or
false), h the hidden share, v and s the slopes and r the logarithm of the reference size. Normal kinds are fitted by
maximum likelihood of the clipped normal distribution (Tobin (1958)). Of kinds with quantiles, B is at most 1 and only
the threshold clips: a clipped one counts with its expectation under the product-limit distribution of B (Buckley &
James (1979), "Linear regression with censored data")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import sizes
from modsim3d.detector.confidence import clipped_score, clipped_sums, fit_clipped
from modsim3d.learn.bootstrap import Resampling
from modsim3d.learn.matches import Outcomes

Kind = Literal["true", "false"]
KINDS: tuple[Kind, Kind] = ("true", "false")


@dataclass(frozen=True, eq=False)
class ObservedConfidences(Columns):
    """Confidences of some detections: values, images and states, shapes (n,)."""

    values: Array
    image: Indices
    state: Indices
    visible_fraction: Array  # of the detected vessel, NaN where there is none or where it is unknown, shape (n,)
    log_size: Array  # log₂ of the side of a square as large as the detected box, in pixels, shape (n,)
    thing: Indices  # which thing was detected, a number; one of its own for each whose identity is unknown, shape (n,)

    @classmethod
    def of(cls, observed: Outcomes, kind: Kind) -> ObservedConfidences:
        """Confidences of true detections or false positives."""
        results = observed.labelled.results
        rows = observed.detection[observed.found] if kind == "true" else observed.false
        visible, thing = np.full(len(rows), np.nan), -1 - np.arange(len(rows))
        if kind == "true":
            visible = observed.labelled.annotations.visible_fraction[observed.rows[observed.found]]
            thing = np.where(observed.thing[observed.found] >= 0, observed.thing[observed.found], thing)
        image = results.image[rows]
        area = np.prod(np.maximum(sizes(results.boxes_px[rows]), 1e-6), axis=1)
        return cls(results.confidence[rows], image, observed.image_state[image], visible, np.log2(area) / 2, thing)

    @property
    def hidden(self) -> Array:
        """Hidden share of the vessel, 0 where unknown, shape (n,)."""
        return 1 - np.where(np.isfinite(self.visible_fraction), self.visible_fraction, 1.0)

    def of_state(self, state: int) -> ObservedConfidences:
        """Confidences of one state."""
        return self.take(self.state == state)


_ROUNDS = 40
_SETTLED = 1e-6  # gain in log-likelihood that is not worth a step
_OCTAVE, _GOLDEN, _REFERENCE_SETTLED = 1.0, (np.sqrt(5) - 1) / 2, 0.01
_MIN_STD = 1e-4
_MAX_CONDITION, _HALVINGS = 1e12, 12
_SCANNED, _SCAN_ROWS = 12, 20_000


@dataclass(frozen=True)
class SlopeForm:
    """Slopes in use, and the logarithm to base two of the reference size, fitted or fixed."""

    visibility: bool
    size: bool
    log_reference: float = 0.0
    reference_fitted: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Keys in the detector file of what is fitted, in the order of `SlopeFit.slopes`."""
        asked = (self.visibility, self.size, self.size and self.reference_fitted)
        keys = ("visibility_slope", "size_slope", "size_reference_px")
        return tuple(key for key, wanted in zip(keys, asked, strict=True) if wanted)


@dataclass(frozen=True, eq=False)
class SlopeFit:
    """Means and standard deviations of each kind, shapes (1 + replicates, kinds), and slopes (1 + replicates, q). The
    reference size is among the slopes as a logarithm to base two. The standard errors of all of them, by theory, are in
    the order mean and standard deviation of each kind, then slopes, shape (2 * kinds + q,)."""

    form: SlopeForm
    means: Array
    stds: Array
    slopes: Array
    errors: Array

    def shift(self, scores: ObservedConfidences, row: int = 0) -> Array:
        """Amount by which the slopes lower each confidence, shape (n,)."""
        return shift_of(scores, dict(zip(self.form.names, self.slopes[row].tolist(), strict=True)), self.form)


def shift_of(scores: ObservedConfidences, slopes: dict[str, float], form: SlopeForm) -> Array:
    """Amount by which slopes lower each confidence, shape (n,); the reference size is a logarithm."""
    reference = slopes.get("size_reference_px", form.log_reference)
    shift = slopes.get("visibility_slope", 0.0) * scores.hidden
    halvings: Array = np.maximum(reference - scores.log_size, 0)
    return shift + slopes.get("size_slope", 0.0) * halvings


def _design(scores: ObservedConfidences, slopes: dict[str, float], form: SlopeForm) -> Array:
    """Derivatives of the means by the slopes, shape (n, q)."""
    reference = slopes.get("size_reference_px", form.log_reference)
    columns = {
        "visibility_slope": -scores.hidden,
        "size_slope": -np.maximum(reference - scores.log_size, 0),
        "size_reference_px": -slopes.get("size_slope", 0.0) * (scores.log_size < reference),
    }
    return np.column_stack([columns[name] for name in form.names]) if form.names else np.zeros((len(scores), 0))


@dataclass(frozen=True, eq=False)
class _Terms:
    """Derivatives of each log-likelihood by mean and standard deviation (n, 2), and their negated ones (n, 2, 2)."""

    first: Array
    second: Array


def _normal_terms(values: Array, means: Array, std: float, threshold: float) -> _Terms:
    first = clipped_score(values, means, std, threshold)
    low, inside = values <= threshold, (values > threshold) & (values < 1)
    z, edge = (values - means) / std, np.where(low, threshold - means, means - 1) / std
    hazard, side = np.abs(first[:, 0]) * std, np.where(low, 1.0, -1.0)
    bend = edge * (edge + hazard)
    by_mean = np.where(inside, 1.0, hazard * (edge + hazard))
    mixed = np.where(inside, 2 * z, -side * hazard * (1 - bend))
    by_std = np.where(inside, 3 * z**2 - 1, -hazard * edge * (2 - bend))
    return _Terms(first, np.stack([by_mean, mixed, mixed, by_std], axis=-1).reshape(-1, 2, 2) / std**2)


def product_limit(base: Array, clipped: Mask, weights: Array) -> tuple[Array, Array]:
    """The likeliest distribution of numbers of which some are only known not to be larger (Kaplan & Meier (1958)):
    values, ascending, and their probabilities, up to a factor. `base` has the numbers, or the bounds of `clipped` ones,
    (n,), and `weights` how often each counts. What lies below every known number is at the lowest bound."""
    if not clipped.any():
        order = np.argsort(base, kind="stable")
        return base[order], weights[order]
    order = np.lexsort((~clipped, base))  # of equal ones the bound comes first, since it is at risk with the number
    ordered, known = base[order], ~clipped[order]
    weight = weights[order]
    at_risk = np.cumsum(weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(known & (at_risk > 0), 1 - weight / at_risk, 1.0)
    above = np.cumprod(np.append(1.0, left[:0:-1]))[::-1]  # probability of what is not larger than each
    mass = np.where(known, above * (1 - left), 0.0)
    mass[0] += max(1 - float(mass.sum()), 0.0)
    return ordered, mass


def _quantile_terms(scores: ObservedConfidences, means: Array, shift: Array, std: float, threshold: float) -> _Terms:
    """As `_normal_terms`, with what is clipped at its expectation under the product-limit distribution."""
    clipped, base = scores.values <= threshold, scores.values + shift
    terms = _normal_terms(np.where(clipped, threshold, np.minimum(scores.values, 1 - 1e-12)), means, std, threshold)
    residual = scores.values - means
    if clipped.any():
        ordered, mass = product_limit(base, clipped, np.ones(len(base)))
        place = np.searchsorted(ordered, base[clipped], side="right") - 1
        below = np.cumsum(mass)[place]
        expected = np.cumsum(mass * ordered)[place] / np.maximum(below, 1e-12)
        expected = np.where(below > 0, expected, base[clipped])
        residual[clipped] = expected - (means + shift)[clipped]
    first = np.column_stack([residual / std**2, np.zeros(len(residual))])
    second = terms.second.copy()
    second[:, 0, 1] = second[:, 1, 0] = 0
    second[:, 1, 1] = 2 / std**2
    return _Terms(first, second)


@dataclass(frozen=True, eq=False)
class _Point:
    """Means and standard deviations of the kinds, then slopes, shape (2 * kinds + q,)."""

    values: Array
    samples: Sequence[ObservedConfidences]
    quantiles: Sequence[bool]
    form: SlopeForm
    threshold: float

    @property
    def slopes(self) -> dict[str, float]:
        return dict(zip(self.form.names, self.values[2 * len(self.samples) :].tolist(), strict=True))

    def derivatives(self) -> list[tuple[Array, Array, Array]]:
        """Derivatives for each kind: terms by mean and standard deviation, (n, 2), (n, 2, 2), and by all (n, 2, p)."""
        size, kinds, triples = len(self.values), len(self.samples), []
        for k, (scores, quantiles) in enumerate(zip(self.samples, self.quantiles, strict=True)):
            mean, std = self.values[2 * k : 2 * k + 2]
            shift = shift_of(scores, self.slopes, self.form)
            if quantiles:
                terms = _quantile_terms(scores, mean - shift, shift, std, self.threshold)
            else:
                terms = _normal_terms(scores.values, mean - shift, std, self.threshold)
            by_all = np.zeros((len(scores), 2, size))
            by_all[:, 0, 2 * k] = by_all[:, 1, 2 * k + 1] = 1
            by_all[:, 0, 2 * kinds :] = _design(scores, self.slopes, self.form)
            triples.append((terms.first, terms.second, by_all))
        return triples

    def newton(self) -> tuple[Array, Array]:
        """Gradient (p,) and curvature (p, p) of the log-likelihood."""
        parts = self.derivatives()
        gradient = sum(np.einsum("na,nap->p", first, by_all) for first, _, by_all in parts)
        curvature = sum(np.einsum("nap,nab,nbq->pq", x, second, x, optimize=True) for _, second, x in parts)
        return np.asarray(gradient), np.asarray(curvature)

    def moved(self, step: Array) -> _Point:
        """After a step that takes no standard deviation below half of itself."""
        values = self.values.copy()
        spreads = slice(1, 2 * len(self.samples), 2)
        values += step
        values[spreads] = np.maximum(values[spreads], np.maximum(self.values[spreads] / 2, _MIN_STD))
        return replace(self, values=values)

    def likelihood(self) -> float:
        """Log-likelihood of all as normal ones."""
        total = 0.0
        for k, scores in enumerate(self.samples):
            mean, std = self.values[2 * k : 2 * k + 2]
            means, y = mean - shift_of(scores, self.slopes, self.form), scores.values
            inside = -(((y - means) / std) ** 2) / 2 - np.log(std * np.sqrt(2 * np.pi))
            low, high = special.log_ndtr((self.threshold - means) / std), special.log_ndtr((means - 1) / std)
            total += float(np.where(y <= self.threshold, low, np.where(y >= 1, high, inside)).sum())
        return total


def fit_slopes(
    samples: Sequence[ObservedConfidences], quantiles: Sequence[bool], form: SlopeForm, least: float, drawn: Resampling
) -> SlopeFit | None:
    """Fit the distributions of some kinds with slopes that they share; replicates by one Newton step each. Each kind
    has its confidences, from `least` on, and may have quantiles. None where they do not determine the fit."""
    point = _settled(_started(samples, replace(form, reference_fitted=False), least))
    if point is not None and form.reference_fitted:
        point = _refined(point)
    if point is not None and any(quantiles):
        point = _settled(replace(point, quantiles=tuple(quantiles)))
    if point is None:
        return None
    if form.reference_fitted:
        values = np.append(point.values, point.form.log_reference)
        point = replace(point, values=values, form=replace(point.form, reference_fitted=True))
    inverse: Array = np.linalg.inv(point.newton()[1]).astype(np.float64)
    gradients, curvature = _weighted(point, drawn)
    steps = np.clip(_solved(curvature, gradients, inverse), -1, 1)
    steps[0] = 0.0
    thetas, kinds = point.values + steps, 2 * len(samples)
    thetas[:, 1:kinds:2] = np.maximum(thetas[:, 1:kinds:2], _MIN_STD)
    spread = sum(x.T @ x for x in (np.einsum("na,nap->np", *part[::2]) for part in point.derivatives()))
    errors = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0))
    return SlopeFit(point.form, thetas[:, :kinds:2], thetas[:, 1:kinds:2], thetas[:, kinds:], errors)


def _started(samples: Sequence[ObservedConfidences], form: SlopeForm, threshold: float) -> _Point:
    """Slopes of 0, and the distributions that are then likeliest."""
    values = np.zeros(2 * len(samples) + len(form.names))
    for k, scores in enumerate(samples):
        mean, std = fit_clipped(clipped_sums(scores.values, threshold, 1.0).sum(axis=0)[None], threshold, 1.0)
        values[2 * k : 2 * k + 2] = mean[0], max(std[0], _MIN_STD)
    return _Point(values, samples, (False,) * len(samples), form, threshold)


def _settled(point: _Point) -> _Point | None:
    """The point that Newton's method comes to; None if it does not settle or nothing determines it."""
    exact = not any(point.quantiles)
    likelihood = point.likelihood()
    for _ in range(_ROUNDS):
        gradient, curvature = point.newton()
        if not np.isfinite(curvature).all() or np.linalg.cond(curvature) > _MAX_CONDITION:
            return None
        step: Array = np.linalg.solve(curvature + _ridge(curvature), gradient).astype(np.float64)
        if abs(gradient @ step) < _SETTLED:
            return point
        for halving in range(_HALVINGS):
            moved = point.moved(step * 0.5**halving)
            reached = moved.likelihood()
            if not exact or reached >= likelihood:
                break
        point, likelihood = moved, reached
    return None


def _refined(point: _Point) -> _Point:
    """The point with the likeliest reference size within an octave, by golden section."""
    low, high = point.form.log_reference - _OCTAVE, point.form.log_reference + _OCTAVE
    best = point

    def likelihood(log_reference: float) -> float:
        nonlocal best
        moved = _settled(replace(best, form=replace(best.form, log_reference=log_reference)))
        if moved is None:
            return -np.inf
        value = moved.likelihood()
        best = moved if value > best.likelihood() else best
        return value

    inner = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    values = [likelihood(size) for size in inner]
    while high - low > _REFERENCE_SETTLED:
        if values[0] > values[1]:
            high, inner, values = inner[1], [inner[1] - _GOLDEN * (inner[1] - low), inner[0]], [np.nan, values[0]]
            values[0] = likelihood(inner[0])
        else:
            low, inner, values = inner[0], [inner[1], inner[0] + _GOLDEN * (high - inner[0])], [values[1], np.nan]
            values[1] = likelihood(inner[1])
    return best


def _ridge(curvature: Array) -> Array:
    """Ridge that makes a curvature (p, p) positive definite, 0 if it is."""
    least = float(np.linalg.eigvalsh(curvature)[0])
    return np.eye(len(curvature)) * max(0.0, 1e-9 * (float(np.trace(curvature)) / len(curvature)) - 2 * least)


def _weighted(point: _Point, resampling: Resampling) -> tuple[Array, Array]:
    """Gradient (rows, p) and curvature (rows, p, p) under each row of weights."""
    size, rows = len(point.values), len(resampling.weights)
    gradient, curvature = np.zeros((rows, size)), np.zeros((rows, size, size))
    for scores, (first, second, x) in zip(point.samples, point.derivatives(), strict=True):
        gradient += resampling.sums(scores.image, np.einsum("na,nap->np", first, x))
        for i in range(size):
            by_i = np.einsum("na,nab->nb", x[:, :, i], second)
            curvature[:, i] += resampling.sums(scores.image, np.einsum("nb,nbq->nq", by_i, x))
    return gradient, curvature


def _solved(curvature: Array, gradient: Array, inverse: Array) -> Array:
    """Newton steps (rows, p); with the inverse of the estimate where a row's own curvature is nearly singular."""
    sound = np.linalg.cond(curvature) < 10 * np.linalg.cond(inverse)
    usable = np.where(sound[:, None, None], curvature, np.eye(len(inverse)))
    return np.where(sound[:, None], np.linalg.solve(usable, gradient[..., None])[..., 0], gradient @ inverse)


def likeliest_reference(
    samples: Sequence[ObservedConfidences], form: SlopeForm, threshold: float, needed: int
) -> SlopeForm:
    """The form with the size from which on confidence does not rise, fitted if enough are larger and smaller; else the
    largest, rounded up."""
    sizes = np.sort(np.concatenate([scores.log_size for scores in samples]))
    largest = np.log2(float(f"{2 ** (sizes[-1] + 0.02):.2g}"))
    few = [scores.take(np.arange(len(scores)) % max(1, len(sizes) // _SCAN_ROWS) == 0) for scores in samples]
    candidates = (
        [*np.linspace(sizes[needed], sizes[-needed - 1], _SCANNED), largest] if len(sizes) > 2 * needed else [largest]
    )
    forms: list[tuple[float, SlopeForm]] = []
    for log_reference in candidates:
        tried = replace(form, log_reference=float(log_reference))
        point = _settled(_started(few, tried, threshold))
        if point is not None and point.slopes["size_slope"] > 0:
            forms.append((point.likelihood(), replace(tried, reference_fitted=log_reference != largest)))
    return max(forms, key=lambda pair: pair[0])[1] if forms else form
