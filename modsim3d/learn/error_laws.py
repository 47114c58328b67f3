"""The distributions that box errors may have, and how the numbers of each are estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.learn.entries import Entry, Key, nested
from modsim3d.learn.error_moments import ErrorMoments, covariance
from modsim3d.learn.form import SIGNIFICANT
from modsim3d.learn.resampling import Column, Kind, Resampling, from_scale, to_scale, widened
from modsim3d.learn.student_t_fit import MOST_DEGREES, StudentTFit, fit_student_t, gain_over_normal

T_NEEDED = 100
"""Errors of a state that a choice between distributions needs."""
_PAIR_NAMES = tuple(f"{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}" for i, j in ERROR_PAIRS)
_LARGEST_STEP = 5.0


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """The errors that the distribution of one state is learned from.

    Attributes:
        errors: e_x, e_y, e_w, e_h in the unit, shape (n, 4).
        image: Image of each, shape (n,).
        kept: Correlation of an error with that of the same vessel one frame before.
        state: Name of the state.
        unit: `px` or `relative`.
    """

    errors: Array
    image: Indices
    kept: float
    state: str
    unit: str

    def key(self, name: str, *axes: tuple[str, ...], remark: str = "") -> Key:
        """Where a number of the distribution stands."""
        return Key((f"box_error_{name}",), self.state, axes, remark)

    def spread_of_means(self, power: int) -> float:
        """Standard error of the mean of powers of a standard normal error, which persist like it to that power."""
        return float(np.sqrt(excess(self.kept**power)) / np.sqrt(max(len(self.errors), 1)))


def excess(kept: float) -> float:
    """Variance of a sum of numbers of which a share is kept from one to the next, over that of independent ones."""
    return (1 + kept) / (1 - kept)


class LearnedLaw(Protocol):
    """A distribution of box errors in one state; its fields hold `Entry` objects."""

    def section(self) -> dict[str, Any]:
        """What it writes into `box_error` of the detector file, but for the unit."""


class ErrorLaw(Protocol):
    """How the numbers of a distribution of box errors are estimated."""

    def estimate(self, resampling: Resampling, sample: ErrorSample) -> LearnedLaw:
        """The numbers of one state, with replicates that spread at least as theory has it for errors that persist."""

    def whitened(self, errors: Array) -> Array:
        """Errors (n, 4) as uncorrelated numbers with mean zero and variance one, shape (n, 4)."""

    def correlation_left(self, correlation: Array) -> Array:
        """Correlation of whitened errors, over that of the normal numbers that errors are made from, shape (n,)."""


@dataclass(frozen=True, eq=False)
class LearnedNormal:
    """A normal distribution: mean (4,), standard deviation (4,) and correlation of the `ERROR_PAIRS` (6,)."""

    mean: Entry
    std: Entry
    correlation: Entry

    def section(self) -> dict[str, Any]:
        """Mean and covariance."""
        mean, std, correlation = (np.nan_to_num(each.estimate) for each in (self.mean, self.std, self.correlation))
        return {"mean": nested(mean), "covariance": nested(_positive(covariance(std, correlation)))}

    @classmethod
    def of(cls, sample: ErrorSample, mean: Column, std: Column, correlation: Column) -> LearnedNormal:
        """Entries of the columns."""
        return cls(
            Entry(sample.key("mean", ERROR_COMPONENTS, remark=sample.unit), mean),
            Entry(sample.key("std", ERROR_COMPONENTS, remark=sample.unit), std),
            Entry(sample.key("correlation", _PAIR_NAMES), correlation),
        )


class NormalErrors:
    """Normal box errors."""

    def estimate(self, resampling: Resampling, sample: ErrorSample) -> LearnedNormal:
        """Moments of the errors."""
        moments = ErrorMoments.of(resampling, sample.image, sample.errors)
        mean, std, correlation = moments.mean, moments.std, moments.correlation
        of_sums, of_squares = sample.spread_of_means(1), sample.spread_of_means(2)
        least = (1 - correlation.estimate**2) * of_squares
        return LearnedNormal.of(
            sample,
            _wide(mean, std.estimate * of_sums),
            _wide(std, std.estimate * of_squares / np.sqrt(2)),
            _wide(correlation, least),
        )

    def whitened(self, errors: Array) -> Array:
        """Errors (n, 4) with mean zero and the identity as covariance, shape (n, 4)."""
        values, vectors = np.linalg.eigh(np.cov(errors.T))
        root = (vectors / np.sqrt(np.maximum(values, 1e-9 * max(values[-1], 1e-12)))) @ vectors.T
        white: Array = (errors - errors.mean(axis=0)) @ root
        return white

    def correlation_left(self, correlation: Array) -> Array:
        """All of it: ones, shape (n,)."""
        return np.ones_like(correlation)


@dataclass(frozen=True, eq=False)
class LearnedStudentT:
    """A t distribution: moments of the distribution itself, as a detector file has them, and degrees of freedom."""

    moments: LearnedNormal
    degrees_of_freedom: Entry

    def section(self) -> dict[str, Any]:
        """Law, degrees of freedom, mean and covariance."""
        nu = nested(self.degrees_of_freedom.estimate)
        return {"law": "student_t", "degrees_of_freedom": nu, **self.moments.section()}


class StudentTErrors:
    """Student's t box errors."""

    def estimate(self, resampling: Resampling, sample: ErrorSample) -> LearnedStudentT:
        """Maximum likelihood; replicates by one Newton step from the estimate."""
        fit = _fitted(sample.errors)
        scores = fit.scores(sample.errors)
        inverse = np.linalg.inv(scores.T @ scores)
        steps = resampling.sums(sample.image, scores) @ inverse
        steps = np.clip(steps - steps[0], -_LARGEST_STEP, _LARGEST_STEP)
        std = np.sqrt(np.diag(fit.covariance))
        correlation = np.array([fit.covariance[i, j] / (std[i] * std[j]) for i, j in ERROR_PAIRS])
        numbers = (fit.mean, std, correlation, np.array(fit.degrees_of_freedom))
        kinds: tuple[Kind, ...] = ("mean", "positive", "correlation", "above_two")
        # What follows the common scale of a vessel's errors persists like that scale does, correlations like squares.
        power, columns, place = (1, 1, 2, 1), [], 0
        for number, kind, each in zip(numbers, kinds, power, strict=True):
            ours = slice(place, place := place + number.size)
            scaled = to_scale(number, kind) + steps[:, ours].reshape(-1, *number.shape)
            error = np.sqrt(np.diag(inverse)[ours] * excess(sample.kept**each)).reshape(number.shape)
            values = from_scale(widened(scaled, error), kind)
            columns.append(Column(values, kind, np.full(number.shape, float(len(sample.errors)))))
        *moments, degrees = columns
        return LearnedStudentT(LearnedNormal.of(sample, *moments), Entry(sample.key("degrees_of_freedom"), degrees))

    def whitened(self, errors: Array) -> Array:
        """Directions of the errors, shapes (n, 4): lengths would hide how the normal numbers behind them persist."""
        fit = _fitted(errors)
        values, vectors = np.linalg.eigh(fit.covariance)
        white: Array = (errors - fit.mean) @ (vectors / np.sqrt(values)) @ vectors.T
        white *= 2 / np.maximum(np.linalg.norm(white, axis=1, keepdims=True), 1e-300)
        return white

    def correlation_left(self, correlation: Array) -> Array:
        """Mean cosine between two normal vectors of four numbers, over their correlation, shape (n,)."""
        left: Array = 9 * np.pi / 32 * special.hyp2f1(0.5, 0.5, 3, correlation**2)
        return left


LAWS: Mapping[str, ErrorLaw] = {"normal": NormalErrors(), "student_t": StudentTErrors()}
"""Distributions of box errors that can be learned, by the name that `box_error.law` has in a detector file."""


def heavy_tails(errors: Array, kept: float) -> str:
    """Why Student's t law describes errors, shape (n, 4), better than the normal one; empty if it does not.

    Twice the gain in log-likelihood, over the number of errors that count as one because they persist, must pass the
    Bayesian information criterion and the square of `SIGNIFICANT`. The gain follows fourth powers of the errors.
    `kept` is the correlation of an error with that of the same vessel one frame before.
    """
    if len(errors) < T_NEEDED:
        return ""
    alike = excess(kept**4)
    gain, needed = gain_over_normal(errors) / alike, max(np.log(len(errors) / alike), SIGNIFICANT**2) / 2
    if gain <= needed:
        return ""
    return f"tails are heavier than normal ones (log-likelihood {gain:.1f} larger, needs {needed:.1f})"


def _fitted(errors: Array) -> StudentTFit:
    """The t distribution of errors (n, 4), or one near the normal where a new sample determines none."""
    fit = fit_student_t(errors)
    if fit is None:
        return StudentTFit(errors.mean(axis=0), np.cov(errors.T) + 1e-12 * np.eye(4), MOST_DEGREES)
    return fit


def _wide(column: Column, least: Array) -> Column:
    return Column(widened(column.values, least), column.kind, column.counts)


def _positive(matrix: Array) -> Array:
    """A covariance (4, 4) without negative eigenvalues, which rounding or a correction may have left."""
    values, vectors = np.linalg.eigh(matrix)
    return matrix if values[0] >= 0 else (vectors * np.maximum(values, 0)) @ vectors.T
