"""The likeliest distribution of box errors, given what the edges of matched boxes say and what matching cut off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.learn.box_errors.matched_edges import ERRORS, OUTWARD, ErrorModel, MatchedEdges

# ---- What the matching rule cuts off ----

_BOXES, _POINTS = 512, 64
_POINTS_FOR_EACH = 8
_SCREENED_AT_ONCE, _STRETCH = 4096, 1.5
_NEAR_SHARE = 0.25
_MIN_PASSING = 1e-3
_LEVELS = np.linspace(-7, 7, 1025)


@dataclass(frozen=True, eq=False)
class Gate:
    """The matching rule over those of n boxes that may fail it."""

    sample: MatchedEdges  # the boxes over which is integrated
    normal: Array  # standard normal numbers of their points, shape (b, p, 5)
    stands: Indices  # which of the sample stands for each of n boxes, −1 for those that hardly ever fail, shape (n,)

    @classmethod
    def of(cls, edges: MatchedEdges, model: ErrorModel) -> Gate | None:
        """The rule over a few hundred boxes with errors about like a distribution's; None if they hardly ever fail."""
        stretched = replace(model, std=_STRETCH * model.std, growth=_STRETCH * model.growth)
        risky = np.zeros(len(edges), dtype=bool)
        for first in range(0, len(edges), _SCREENED_AT_ONCE):
            screened = np.arange(first, min(first + _SCREENED_AT_ONCE, len(edges)))
            risky[screened] = _may_fail(stretched, edges.take(screened))
        rows = np.flatnonzero(risky)
        if not len(rows):
            return None
        subset = edges.take(rows)
        near = (subset.inward_px < _NEAR_SHARE * subset.sides_px) @ 2 ** np.arange(4)
        width, height = subset.sides_px[:, 0], subset.sides_px[:, 1]
        order = rows[np.lexsort((width / height, np.round(2 * np.log2(width * height)), near))]
        number = min(len(order), _BOXES)
        chosen = order[((np.arange(number) + 0.5) * len(order) / number).astype(np.int64)]
        stands = np.full(len(edges), -1)
        stands[order] = np.arange(len(order)) * number // len(order)
        wanted = max(_BOXES * _POINTS, _POINTS_FOR_EACH * len(order)) / number
        points = normal_points(number, 1 << int(np.log2(np.clip(wanted, _POINTS, 16 * _POINTS))))
        return cls(edges.take(chosen), points, stands)

    @property
    def boxes(self) -> int:
        """Number of boxes that may fail."""
        return int(np.count_nonzero(self.stands >= 0))

    def passing(self, model: ErrorModel) -> tuple[Array, Array]:
        """Log-probability to pass of each box, shape (n,), and mean statistics of what fails over it, (n, s)."""
        from scipy.sparse import csr_array  # slow to import

        standard = errors_from(model, self.normal)
        fails = _fails(model, self.sample, standard)
        number = np.count_nonzero(fails, axis=1)
        chance = np.maximum(1 - number / fails.shape[1], _MIN_PASSING)
        terms = model.statistics(standard[fails])
        ones, ends = np.ones(len(terms)), np.append(0, np.cumsum(number))
        sums = csr_array((ones, np.arange(len(terms)), ends), shape=(len(chance), len(terms))) @ terms
        lost = sums / fails.shape[1] / chance[:, None]
        return np.append(np.log(chance), 0.0)[self.stands], np.vstack([lost, np.zeros(lost.shape[1])])[self.stands]


@cache
def sobol(number: int, width: int) -> Array:
    """Scrambled points of Sobol's sequence, a power of two of them, shape (number, width)."""
    from scipy.stats import qmc  # slow to import

    return np.asarray(qmc.Sobol(width, rng=np.random.default_rng(0)).random(number))


def normal_points(boxes: int, number: int) -> Array:
    """Normal numbers from Sobol's sequence, shifted for each box by an amount of its own, (boxes, number, 5)."""
    return _points_of(1 << (boxes - 1).bit_length(), number)[:boxes]


@lru_cache(maxsize=8)
def _points_of(boxes: int, number: int) -> Array:
    shifted = (sobol(number, 5) + np.random.default_rng(3).random((boxes, 1, 5))) % 1
    points: Array = special.ndtri(np.clip(shifted, 1e-12, 1 - 1e-12))
    points.flags.writeable = False
    return points


def errors_from(model: ErrorModel, normal: Array) -> Array:
    """Standardised errors (..., 4) from normal numbers (..., 5), the last of which gives the scale of heavy tails."""
    values, vectors = np.linalg.eigh(model.correlation)
    standard: Array = normal[..., :4] @ ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)
    if model.heavy:
        chi_square = 2 * special.gammaincinv(model.freedom / 2, special.ndtr(_LEVELS))
        scales = np.interp(normal[..., 4], _LEVELS, np.sqrt((model.freedom - 2) / chi_square))
        standard = standard * scales[..., None]
    return standard


def _may_fail(model: ErrorModel, edges: MatchedEdges) -> Mask:
    """Whether some point of each box fails, shape (n,)."""
    standard = errors_from(model, normal_points(len(edges), _POINTS))
    mean, std = model.at(edges.sides_px)
    farthest = np.stack([np.abs(axis).max(axis=1) for axis in np.moveaxis(standard, -1, 0)], axis=-1)  # 8 × as fast
    largest = np.abs(mean) + std * farthest
    rows = np.flatnonzero(~edges.surely_passes(largest @ np.abs(OUTWARD).T))
    risky = np.zeros(len(edges), dtype=bool)
    risky[rows] = _fails(model, edges.take(rows), standard[rows]).any(axis=1)
    return risky


def _fails(model: ErrorModel, edges: MatchedEdges, standard: Array) -> Mask:
    """Whether boxes with standardised errors (n, p, 4) fail, shape (n, p)."""
    mean, std = model.at(edges.sides_px)
    return ~edges.passes((mean[:, None] + std[:, None] * standard) @ OUTWARD.T)


# ---- What the edges of a box leave open ----

_COMPLETION_POINTS = 64
_POINTS_IN_ALL = 1 << 18


@dataclass(frozen=True, eq=False)
class CompletedEdges:
    """Edges of some boxes, with points in place of what is open."""

    rows: Indices  # the boxes, shape (m,)
    outward_px: Array  # how far each edge lies outside the true one, shape (m, p, 4)
    weights: Array  # of each point, sum to one, shape (m, p)
    log_likelihood: Array  # of the known and censored edges, shape (m,)


def completed(model: ErrorModel, edges: MatchedEdges) -> Iterator[CompletedEdges]:
    """All boxes, those with the same edges known together."""
    for rows, group in edges.alike:
        yield _of_pattern(model, group, rows)


def _of_pattern(model: ErrorModel, edges: MatchedEdges, rows: Indices) -> CompletedEdges:
    """Boxes of which the same edges are known and censored, and their rows."""
    known, censored = edges.known[0], edges.censored[0]
    order = np.argsort(np.where(known, 0, np.where(censored, 1, 2)), kind="stable")
    count, ends = int(known.sum()), int(known.sum() + censored.sum())
    mean, std = model.at(edges.sides_px)
    turn = OUTWARD[order]
    scaled = turn * std[:, None]
    root = np.linalg.cholesky(scaled @ model.correlation @ np.swapaxes(scaled, 1, 2))
    moved = edges.outward_px[:, order] - mean @ turn.T
    zeta = np.zeros((len(rows), 4))
    for j in range(count):
        zeta[:, j] = (moved[:, j] - (root[:, j, :j] * zeta[:, :j]).sum(axis=1)) / root[:, j, j]
    value = _log_density(model, zeta[:, :count]) - np.log(np.diagonal(root[:, :count, :count], axis1=1, axis2=2)).sum(1)
    if count == 4:
        return CompletedEdges(rows, edges.outward_px[:, None], np.ones((len(rows), 1)), value)
    uniforms = _uniforms(len(rows), 4 - count + model.heavy)
    points, scale = np.zeros((*uniforms.shape[:2], 4)), np.ones(uniforms.shape[:2])
    points[..., :count] = zeta[:, None, :count]
    if model.heavy:
        nu, q = model.freedom, (zeta[:, :count] ** 2).sum(axis=1)[:, None]
        chi_square = 2 * special.gammaincinv((nu + count) / 2, uniforms[..., -1]) / (1 + q / (nu - 2))
        scale = np.sqrt((nu - 2) / chi_square)
    weights = np.ones(uniforms.shape[:2])
    for j in range(count, 4):
        least = -np.inf
        if j < ends:
            given = np.einsum("mk,mpk->mp", root[:, j, :j], points[..., :j])
            least = (moved[:, j, None] - given) / (root[:, j, j, None] * scale)
        beyond = special.ndtr(-least)  # the probability
        points[..., j] = -scale * special.ndtri(np.maximum(uniforms[..., j - count] * beyond, 1e-300))
        weights *= beyond
    total = weights.mean(axis=1)
    outward = np.empty_like(points)
    outward[..., order] = np.einsum("mjk,mpk->mpj", root, points) + (mean @ turn.T)[:, None]
    if ends < 4:
        passes = edges.passes(outward)
        weights = np.where(passes.any(axis=1, keepdims=True), weights * passes, weights)
        total = np.maximum(weights.mean(axis=1), 1e-300)
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    return CompletedEdges(rows, outward, weights, value + np.log(np.maximum(total, 1e-300)))


@lru_cache(maxsize=128)
def _uniforms(count: int, width: int) -> Array:
    """Points of Sobol's sequence for each of so many boxes, shifted by an amount of its own, (count, p, width)."""
    points = max(8, min(_COMPLETION_POINTS, 1 << int(np.log2(max(_POINTS_IN_ALL / count, 8)))))
    shifted: Array = (sobol(points, width) + np.random.default_rng(1).random((count, 1, width))) % 1
    uniforms: Array = np.clip(shifted, 1e-12, 1 - 1e-12)
    uniforms.flags.writeable = False
    return uniforms


def _log_density(model: ErrorModel, zeta: Array) -> Array:
    """Log-density of standardised independent numbers (m, k), shape (m,)."""
    k, q = zeta.shape[1], (zeta**2).sum(axis=1)
    if not model.heavy:
        return np.asarray(-q / 2 - k / 2 * np.log(2 * np.pi))
    nu = model.freedom
    constant = special.gammaln((nu + k) / 2) - special.gammaln(nu / 2) - k / 2 * np.log(np.pi * (nu - 2))
    return np.asarray(constant - (nu + k) / 2 * np.log1p(q / (nu - 2)))


_STEPS, _ENOUGH = 30, 0.01
_MAX_STEP, _MAX_TIMES, _WORSE = 0.5, 4.0, 1.5
_DIFFERENCE = 0.25
_HOPE, _MARGIN = 4.0, 10.0
_MANY_MORE = 1.2


@dataclass(frozen=True, eq=False)
class Slopes:
    """Log-likelihood of a distribution with its slopes, box by box."""

    value: float  # log-likelihood of all boxes
    scores: Array  # slopes by the numbers of the distribution, shape (n, p)


@dataclass(frozen=True, eq=False)
class ErrorFit:
    """A distribution that was fitted."""

    model: ErrorModel
    edges: MatchedEdges
    gate: Gate | None  # what matching cuts off; None where it cuts off nothing
    value: float  # its log-likelihood
    settled: bool  # whether the likelihood has a maximum that was found

    @property
    def plain(self) -> bool:
        """Whether every edge is known and matching cuts off nothing."""
        return self.gate is None and bool(self.edges.known.all())

    def slopes(self) -> Slopes:
        """Slopes at the fitted numbers."""
        return slopes(self.model, self.edges, self.gate)

    def information(self) -> Array:
        """Minus the second derivatives of the log-likelihood, shape (p, p), by differences of its slopes."""
        start, score = self.model.numbers(), self.slopes().scores.sum(axis=0)
        usual = _expected_information(self.model, self.edges)
        step = _DIFFERENCE / np.sqrt(np.diag(usual))
        curvature = np.empty_like(usual)
        for place, width in enumerate(step):
            moved = start.copy()
            moved[place] += width
            change = slopes(self.model.with_numbers(moved), self.edges, self.gate).scores.sum(axis=0)
            curvature[place] = (score - change) / width
        curvature = (curvature + curvature.T) / 2
        scale = np.sqrt(np.diag(usual))
        if not np.isfinite(curvature).all() or np.linalg.eigvalsh(curvature / np.outer(scale, scale))[0] < 1e-3:
            return usual
        return curvature


def slopes(model: ErrorModel, edges: MatchedEdges, gate: Gate | None) -> Slopes:
    """Log-likelihood and slopes of a distribution, given boxes and what matching cuts off."""
    statistics, value = np.empty((len(edges), 14 + model.heavy)), 0.0
    for part in completed(model, edges):
        mean, std = model.at(edges.sides_px[part.rows])
        standard = (part.outward_px @ ERRORS.T - mean[:, None]) / std[:, None]
        statistics[part.rows] = model.mean_statistics(standard, part.weights)
        value += float(part.log_likelihood.sum())
    if gate is not None:
        passing, lost = gate.passing(model)
        statistics += lost
        value -= float(passing.sum())
    return Slopes(value, statistics[:, model.places] * model.gains(edges.sides_px))


def log_likelihoods(model: ErrorModel, edges: MatchedEdges, gate: Gate | None) -> Array:
    """Log-likelihood of each box, shape (n,)."""
    values = np.zeros(len(edges)) if gate is None else -gate.passing(model)[0]
    for part in completed(model, edges):
        values[part.rows] += part.log_likelihood
    return values


_STRAYS, _WIDE = 0.01, 5.0
_REFITS = 2


def gain_beside_strays(fit: ErrorFit, plain: ErrorFit) -> float:
    """Log-likelihood of a fit less that of a plainer one, if a hundredth of the boxes may be strays, spread five times
    as far, which look like heavy tails: false positives on missed vessels. The plainer one is fitted without them."""
    edges, model = plain.edges, plain.model
    wide = replace(model, std=_WIDE * model.std, growth=_WIDE * model.growth)
    stray = log_likelihoods(wide, edges, None) + np.log(_STRAYS)

    def value(own: Array) -> float:
        return float(np.logaddexp(own + np.log1p(-_STRAYS), stray).sum())

    own = log_likelihoods(model, edges, plain.gate)
    best = value(own)
    for _ in range(_REFITS):
        likeliest = np.argsort(own - stray)[: int(np.ceil(_STRAYS * len(edges)))]
        strays = likeliest[own[likeliest] < stray[likeliest]]
        if not len(strays):
            break
        model = fit_errors(model, edges.take(np.setdiff1d(np.arange(len(edges)), strays))).model
        own = log_likelihoods(model, edges, plain.gate)
        best = max(best, value(own))
    return value(log_likelihoods(fit.model, edges, fit.gate)) - best


def fit_errors(start: ErrorModel, edges: MatchedEdges, least: float = -np.inf) -> ErrorFit:
    """Newton's steps from a distribution to the likeliest of its kind (Broyden's method for the derivatives). A fit
    that will surely not reach the least log-likelihood that is asked of it is given up; it is not settled."""
    gate = Gate.of(edges, start)
    fit = _fit(start, edges, gate, least)
    if not fit.settled and fit.value < least:
        return fit
    again = None if gate is None else Gate.of(edges, fit.model)
    if again is not None and gate is not None and again.boxes > _MANY_MORE * gate.boxes:
        fit = _fit(fit.model, edges, again, least)  # more boxes may fail than it seemed
    return fit


def fit_without_gate(start: ErrorModel, edges: MatchedEdges) -> ErrorFit:
    """Fit as if matching cut off nothing; it does not count as settled."""
    return replace(_fit(start, edges, None), settled=False)


def _fit(start: ErrorModel, edges: MatchedEdges, gate: Gate | None, least: float = -np.inf) -> ErrorFit:
    model, settled = start, False
    information = _expected_information(start, edges)
    unit: Array = 1 / np.sqrt(np.diag(information))  # all numbers in standard errors, so that they are alike
    usual = np.asarray(np.linalg.inv(information * np.outer(unit, unit)), dtype=np.float64)
    inverse, longest = usual, _MAX_STEP
    gradient = slopes(start, edges, gate)
    numbers, score = start.numbers(), gradient.scores.sum(axis=0)
    for _ in range(_STEPS):
        step = _step(inverse, score * unit, model.held(score)) * unit
        if gradient.value + _HOPE * abs(score @ step) + _MARGIN < least:
            break
        if np.all(np.abs(step) <= _ENOUGH * unit):
            settled = True
            break
        size = _size(step, model)
        if size > longest:
            step *= longest / size
        last, model = model, model.with_numbers(numbers + step)
        if np.any(model.std > _MAX_TIMES * start.std) or not np.isfinite(model.numbers()).all():
            model = last
            break
        gradient = slopes(model, edges, gate)
        moved, after = model.numbers() - numbers, gradient.scores.sum(axis=0)
        if np.linalg.norm(after * unit) > _WORSE * np.linalg.norm(score * unit):
            inverse, longest = usual, longest / 2
        else:
            inverse = _broyden(inverse, moved / unit, (score - after) * unit)
        numbers, score = numbers + moved, after
    return ErrorFit(model, edges, gate, gradient.value, settled)


def _step(inverse: Array, score: Array, held: Mask) -> Array:
    """Newton's step of the numbers that are not held, shape (p,), given the inverse of the derivatives (p, p)."""
    if not held.any():
        return inverse @ score
    step, free = np.zeros(len(score)), np.flatnonzero(~held)
    step[free] = np.linalg.solve(np.linalg.inv(inverse)[np.ix_(free, free)], score[free])
    return step


def _size(step: Array, model: ErrorModel) -> float:
    scaled = step.copy()
    scaled[:4] /= model.std
    if model.unit == "mixed":
        scaled[14:18] = 0
    return float(np.abs(scaled).max())


def _broyden(inverse: Array, moved: Array, change: Array) -> Array:
    """Broyden's rank-one change of an inverse derivative (p, p), given a step and what it changed, shapes (p,)."""
    predicted = inverse @ change
    whole = float(moved @ predicted)
    if abs(whole) < 1e-3 * float(moved @ moved):
        return inverse
    return inverse + np.outer(moved - predicted, moved @ inverse) / whole


def _expected_information(model: ErrorModel, edges: MatchedEdges) -> Array:
    """Information that boxes would carry if all edges were known and matching cut off nothing, shape (p, p)."""
    statistics = model.statistics(errors_from(model, normal_points(1, 1024)[0]))
    covariance = statistics.T @ statistics / len(statistics)
    gains, places = model.gains(edges.sides_px), model.places
    information = covariance[np.ix_(places, places)] * (gains.T @ gains)
    return information + 1e-6 * np.diag(np.sqrt(np.diag(information)) ** 2)
