"""The numbers of a distribution of box errors as a detector file has them, with their replicates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.file.checks import covariance_problems
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.learn.box_error_fits.error_fit import ErrorFit
from modsim3d.learn.box_error_fits.error_model import Unit
from modsim3d.learn.box_errors.error_choice import excess
from modsim3d.learn.box_errors.error_moments import ErrorMoments, covariance
from modsim3d.learn.numbers.entries import Entry, Key, nested
from modsim3d.learn.numbers.resampling import Column, Kind, Resampling, from_scale, to_scale, widened

LAWS = ("normal", "student_t")
"""Distributions of box errors that can be learned, by the name that `box_error.law` has in a detector file."""
_PAIR_NAMES = tuple(f"{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}" for i, j in ERROR_PAIRS)
_LARGEST_STEP = 5.0
_SHRUNK = 1e-5


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """What the distribution of one state is learned from.

    Attributes:
        errors: e_x, e_y, e_w, e_h in the unit as measured, shape (n, 4).
        image: Image of each, shape (n,).
        kept: Correlation of an error with that of the same vessel one frame before.
        state: Name of the state.
        unit: What standard deviations follow.
        fit: The likeliest distribution; None where the errors determine none.
    """

    errors: Array
    image: Indices
    kept: float
    state: str
    unit: Unit
    fit: ErrorFit | None

    def entry(self, name: str, column: Column, *axes: tuple[str, ...]) -> Entry:
        """A number of the distribution."""
        remark = {"mean": self.in_words, "std": self.in_words, "growth": "px/px"}.get(name, "")
        return Entry(Key((f"box_error_{name}",), self.state, axes, remark), column)

    @property
    def in_words(self) -> str:
        """The unit of the mean."""
        return "relative" if self.unit == "relative" else "px"

    def spread_of_means(self, power: int) -> float:
        """Standard error of the mean of powers of a standard normal error, which persist like it to that power."""
        return float(np.sqrt(excess(self.kept**power)) / np.sqrt(max(len(self.errors), 1)))


@dataclass(frozen=True, eq=False)
class LearnedErrors:
    """The distribution of the box errors of a state.

    Attributes:
        unit: What standard deviations follow.
        mean: Shape (4,).
        std: Standard deviation; of mixed errors its fixed part, shape (4,).
        correlation: Of the `ERROR_PAIRS`, shape (6,).
        growth: By how much standard deviations grow with the side, shape (4,); None unless mixed.
        degrees_of_freedom: Of Student's t law; None if normal.
    """

    unit: Unit
    mean: Entry
    std: Entry
    correlation: Entry
    growth: Entry | None = None
    degrees_of_freedom: Entry | None = None

    def section(self) -> dict[str, Any]:
        """The section `box_error` of a detector file."""
        section: dict[str, Any] = {"unit": self.unit}
        if self.degrees_of_freedom is not None:
            section |= {"law": "student_t", "degrees_of_freedom": nested(self.degrees_of_freedom.estimate)}
        mean, std, correlation = (np.nan_to_num(each.estimate) for each in (self.mean, self.std, self.correlation))
        section |= {"mean": nested(mean), "covariance": _written(_positive(covariance(std, correlation)))}
        if self.growth is not None:
            section["growth"] = nested(np.maximum(self.growth.estimate, 0.0))
        return section


def learned_errors(resampling: Resampling, sample: ErrorSample) -> LearnedErrors:
    """The numbers of one state, with replicates that spread at least as theory has it for errors that persist."""
    if sample.fit is None or (sample.fit.plain and not sample.fit.model.heavy and sample.unit != "mixed"):
        return _moments(resampling, sample)
    return _likeliest(resampling, sample, sample.fit)


def _moments(resampling: Resampling, sample: ErrorSample) -> LearnedErrors:
    """Moments of errors of which nothing is cut off."""
    moments = ErrorMoments.of(resampling, sample.image, sample.errors)
    mean, std, correlation = moments.mean, moments.std, moments.correlation
    of_sums, of_squares = sample.spread_of_means(1), sample.spread_of_means(2)
    least = (1 - correlation.estimate**2) * of_squares
    return LearnedErrors(
        sample.unit,
        sample.entry("mean", _wide(mean, std.estimate * of_sums), ERROR_COMPONENTS),
        sample.entry("std", _wide(std, std.estimate * of_squares / np.sqrt(2)), ERROR_COMPONENTS),
        sample.entry("correlation", _wide(correlation, least), _PAIR_NAMES),
    )


def _likeliest(resampling: Resampling, sample: ErrorSample, fit: ErrorFit) -> LearnedErrors:
    """Maximum likelihood; replicates by one Newton step from the estimate."""
    model, count, replicates = fit.model, len(fit.edges), len(resampling.weights) - 1
    inverse: Array = np.zeros((len(model.places), len(model.places)))
    steps: Array = np.zeros((1, len(model.places)))
    if replicates:
        inverse = np.asarray(np.linalg.inv(fit.information()), dtype=np.float64)
        steps = resampling.sums(fit.edges.image, fit.slopes().scores) @ inverse
        steps -= steps[0].copy()
        steps[:, 4:] = np.clip(steps[:, 4:], -_LARGEST_STEP, _LARGEST_STEP)
    freed = 1.0 if model.heavy else np.sqrt(count / max(count - 1, 1))
    i, j = np.array(ERROR_PAIRS).T
    # What follows the common scale of a vessel's errors persists like that scale does, other spreads like squares.
    of_spread = 1 if model.heavy else 2
    numbers: dict[str, tuple[Array, Kind, int]] = {
        "mean": (model.mean, "mean", 1),
        "std": (freed * model.std, "positive", of_spread),
        "correlation": (model.correlation[i, j], "correlation", 2),
    }
    if model.unit == "mixed":
        numbers["growth"] = (freed * model.growth, "mean", of_spread)
    if model.heavy:
        numbers["degrees_of_freedom"] = (np.array(model.freedom), "above_two", 1)
    axes = {"correlation": (_PAIR_NAMES,), "degrees_of_freedom": ()}
    entries, place = {}, 0
    for name, (number, kind, power) in numbers.items():
        ours = slice(place, place := place + number.size)
        scaled = to_scale(number, kind) + steps[:, ours].reshape(-1, *number.shape)
        error = np.sqrt(np.maximum(np.diag(inverse)[ours], 0) * excess(sample.kept**power)).reshape(number.shape)
        values = from_scale(widened(scaled, error), kind)
        column = Column(values, kind, np.full(number.shape, float(count)))
        entries[name] = sample.entry(name, column, *axes.get(name, (ERROR_COMPONENTS,)))
    return LearnedErrors(model.unit, **entries)


def _wide(column: Column, least: Array) -> Column:
    return replace(column, values=widened(column.values, least))


def _positive(matrix: Array) -> Array:
    """A covariance (4, 4) without negative eigenvalues, which rounding or a correction may have left."""
    values, vectors = np.linalg.eigh(matrix)
    return matrix if values[0] >= 0 else (vectors * np.maximum(values, 0)) @ vectors.T


def _written(matrix: Array) -> Any:
    """A covariance (4, 4) in six digits; where rounding makes it invalid, its correlations are made 10⁻⁵ smaller."""
    rounded = nested(matrix)
    if not covariance_problems(rounded):
        return rounded
    return nested(matrix * np.where(np.eye(4, dtype=bool), 1.0, 1 - _SHRUNK))
