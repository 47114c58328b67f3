"""The likeliest distribution of box errors, given what the edges of matched boxes say and what matching cut off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.learn.box_error_fits.edge_completion import completed, standard_errors
from modsim3d.learn.box_error_fits.error_model import ErrorModel
from modsim3d.learn.box_error_fits.gate_passing import Gate, drawn, normal_points
from modsim3d.learn.box_error_fits.matched_edges import MatchedEdges

_STEPS, _ENOUGH = 30, 0.01
_LONGEST_STEP, _MOST_TIMES, _WORSE = 0.5, 4.0, 1.5
_DIFFERENCE = 0.25
_HOPE, _MARGIN = 4.0, 10.0
_MANY_MORE = 1.2


@dataclass(frozen=True, eq=False)
class Slopes:
    """Log-likelihood of a distribution with its slopes, box by box.

    Attributes:
        value: Log-likelihood of all boxes.
        scores: Slopes by the numbers of the distribution, shape (n, p).
    """

    value: float
    scores: Array


@dataclass(frozen=True, eq=False)
class ErrorFit:
    """A distribution that was fitted.

    Attributes:
        gate: What matching cuts off; None where it cuts off nothing.
        value: Its log-likelihood.
        settled: Whether the likelihood has a maximum that was found.
    """

    model: ErrorModel
    edges: MatchedEdges
    gate: Gate | None
    value: float
    settled: bool

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
        found = np.empty_like(usual)
        for place, width in enumerate(step):
            moved = start.copy()
            moved[place] += width
            found[place] = (
                score - slopes(self.model.with_numbers(moved), self.edges, self.gate).scores.sum(axis=0)
            ) / width
        found = (found + found.T) / 2
        scale = np.sqrt(np.diag(usual))
        if not np.isfinite(found).all() or np.linalg.eigvalsh(found / np.outer(scale, scale))[0] < 1e-3:
            return usual
        return found


def slopes(model: ErrorModel, edges: MatchedEdges, gate: Gate | None) -> Slopes:
    """Log-likelihood and slopes of a distribution, given boxes and what matching cuts off."""
    statistics, value = np.empty((len(edges), 14 + model.heavy)), 0.0
    for part in completed(model, edges):
        standard = standard_errors(model, edges.sides_px[part.rows], part.outward_px)
        statistics[part.rows] = model.mean_statistics(standard, part.weights)
        value += float(part.log_likelihood.sum())
    if gate is not None:
        passing, lost = gate.passing(model)
        statistics += lost
        value -= float(passing.sum())
    return Slopes(value, statistics[:, model.places] * model.gains(edges.sides_px))


def fit_errors(start: ErrorModel, edges: MatchedEdges, least: float = -np.inf) -> ErrorFit:
    """Newton's steps from a distribution to the likeliest of its kind (Broyden's method for the derivatives).

    A fit that will surely not reach the least log-likelihood that is asked of it is given up; it is not settled.
    """
    gate = Gate.of(edges, start)
    fit = _fit(start, edges, gate, least)
    if not fit.settled and fit.value < least:
        return fit
    again = None if gate is None else Gate.of(edges, fit.model)
    if again is not None and gate is not None and again.boxes > _MANY_MORE * gate.boxes:
        fit = _fit(fit.model, edges, again, least)  # more boxes may fail than it seemed
    return fit


def fit_without_gate(start: ErrorModel, edges: MatchedEdges) -> ErrorFit:
    """The same as if matching cut off nothing; it does not count as settled."""
    return replace(_fit(start, edges, None), settled=False)


def _fit(start: ErrorModel, edges: MatchedEdges, gate: Gate | None, least: float = -np.inf) -> ErrorFit:
    model, settled = start, False
    information = _expected_information(start, edges)
    unit: Array = 1 / np.sqrt(np.diag(information))  # all numbers in standard errors, so that they are alike
    usual = np.asarray(np.linalg.inv(information * np.outer(unit, unit)), dtype=np.float64)
    inverse, longest = usual, _LONGEST_STEP
    found = slopes(start, edges, gate)
    numbers, score = start.numbers(), found.scores.sum(axis=0)
    for _ in range(_STEPS):
        step = _step(inverse, score * unit, model.held(score)) * unit
        if found.value + _HOPE * abs(score @ step) + _MARGIN < least:
            break
        if np.all(np.abs(step) <= _ENOUGH * unit):
            settled = True
            break
        size = _size(step, model)
        if size > longest:
            step *= longest / size
        last, model = model, model.with_numbers(numbers + step)
        if np.any(model.std > _MOST_TIMES * start.std) or not np.isfinite(model.numbers()).all():
            model = last
            break
        found = slopes(model, edges, gate)
        moved, after = model.numbers() - numbers, found.scores.sum(axis=0)
        if np.linalg.norm(after * unit) > _WORSE * np.linalg.norm(score * unit):
            inverse, longest = usual, longest / 2
        else:
            inverse = _broyden(inverse, moved / unit, (score - after) * unit)
        numbers, score = numbers + moved, after
    return ErrorFit(model, edges, gate, found.value, settled)


def _step(inverse: Array, score: Array, held: Mask) -> Array:
    """Newton's step of the numbers that are not held, shape (p,), given the inverse of the derivatives (p, p)."""
    if not held.any():
        step: Array = inverse @ score
        return step
    step, free = np.zeros(len(score)), np.flatnonzero(~held)
    step[free] = np.linalg.solve(np.linalg.inv(inverse)[np.ix_(free, free)], score[free])
    return step


def _size(step: Array, model: ErrorModel) -> float:
    """The longest step of any number, of means in standard deviations."""
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
    result: Array = inverse + np.outer(moved - predicted, moved @ inverse) / whole
    return result


def _expected_information(model: ErrorModel, edges: MatchedEdges) -> Array:
    """Information that boxes would carry if all edges were known and matching cut off nothing, shape (p, p)."""
    statistics = model.statistics(drawn(model, normal_points(1, 1024)[0]))
    covariance = statistics.T @ statistics / len(statistics)
    gains, places = model.gains(edges.sides_px), model.places
    information = covariance[np.ix_(places, places)] * (gains.T @ gains)
    scale = np.sqrt(np.diag(information))
    result: Array = information + 1e-6 * np.diag(scale**2)
    return result
