"""The covariance of box errors without that part which comes from errors of truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Mask
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.learn.box_errors.error_laws import LearnedErrors
from modsim3d.learn.numbers.entries import Entry
from modsim3d.learn.numbers.resampling import spread

_LEAST_PART = 1e-3
"""A replicate whose rest is not positive keeps this share of a variance."""
_MOST_CORRELATION = 0.999
_ALIKE = 0.15
"""By which share standard deviations as measured may differ from those of the law."""
_FIRST, _SECOND = (np.array(each) for each in zip(*ERROR_PAIRS, strict=True))


@dataclass(frozen=True, eq=False)
class LessNoise:
    """Errors of one state, less those of truth.

    Attributes:
        errors: What is written.
        taken_off: Of which of e_x, e_y, e_w, e_h errors of truth were taken off; the others are upper bounds, (4,).
        noise_std: Standard deviations that errors of truth give, in the unit of the errors, shape (4,).
        before: Standard deviations that were learned, mean over the boxes, shape (4,).
        after: The same, as written, shape (4,).
        at_least: Standard deviations of what changes from frame to frame, which is the detector's, NaN where frames do
            not tell, shape (4,).
        share: Share of the whitened errors that was taken off, shape (rows,).
    """

    errors: LearnedErrors
    taken_off: Mask
    noise_std: Array
    before: Array
    after: Array
    at_least: Array
    share: Array

    @property
    def bounds(self) -> tuple[str, ...]:
        """Names of the components that are upper bounds."""
        names = zip(ERROR_COMPONENTS, self.taken_off, strict=True)
        return tuple(name for name, taken in names if not taken)


def less_noise(
    errors: LearnedErrors,
    noise: Array,
    sides_px: Array,
    level: float,
    measured: Array | None,
    at_least: Array,
    cut_off: bool = False,
) -> LessNoise:
    """Take the covariance of errors of truth off, where the rest is surely positive.

    The law keeps its form: of mixed errors, whose standard deviations grow with the side, both parts shrink alike.
    Correlations with a component that is an upper bound are unknown: they keep their estimate, but no replicates.

    Args:
        errors: The errors of a state.
        noise: Covariance of errors of truth in their unit, estimate and replicates, shape (rows, 4, 4).
        sides_px: Width, height, width and height of the boxes, shape (n, 4).
        level: Level of the intervals that must not reach 0.
        measured: Covariances of the errors themselves, to take it off, shape (rows, 4, 4). Errors of truth differ from
            box to box, so that the likeliest law has not quite their covariance. Those of components that are far from
            it, as wrong matches make them, are not used; but where they are smaller, they must surely be larger than
            errors of truth. None if unknown.
        at_least: Standard deviations of what changes from frame to frame, shape (4,).
        cut_off: Whether the matching has cut off errors, which only the law knows.
    """
    std, correlation = np.nan_to_num(errors.std.column.values), np.nan_to_num(errors.correlation.column.values)
    growth = np.zeros_like(std) if errors.growth is None else np.maximum(errors.growth.column.values, 0)
    products = _mean_products(std, growth, sides_px)
    whole = products * _matrix(correlation)
    if measured is not None and not cut_off:
        whole = _as_measured(whole, measured)
    taken = _sure(whole, noise, level)
    if measured is not None:  # tails of the law may be wider than the errors
        smaller = np.diag(measured[0]) < np.diag(whole[0])
        taken = taken & (_sure(measured, noise, level) | ~smaller)
    part = noise * (taken[:, None] & taken[None, :])
    rest = whole - part
    if np.linalg.eigvalsh(rest[0])[0] <= 0:
        taken, part, rest = np.zeros(4, dtype=bool), np.zeros_like(part), whole
    variance = np.einsum("bii->bi", products)
    least = np.maximum(np.einsum("bii->bi", rest), _LEAST_PART * variance)
    shrunk = np.sqrt(least / np.where(variance > 0, variance, 1.0))
    shrunk = np.where(taken, np.minimum(shrunk, 1.0), 1.0)
    shrunk_products = products * shrunk[:, :, None] * shrunk[:, None, :]
    left = rest / np.where(shrunk_products > 0, shrunk_products, 1.0)
    left = np.clip(left[:, _FIRST, _SECOND], -_MOST_CORRELATION, _MOST_CORRELATION)
    correlation = np.where(taken[_FIRST] | taken[_SECOND], left, correlation)
    correlation[1:, ~(taken[_FIRST] & taken[_SECOND])] = np.nan  # with errors of truth in it, it tells no interval
    result = replace(
        errors,
        std=_with(errors.std, std * shrunk),
        correlation=_with(errors.correlation, correlation),
        growth=None if errors.growth is None else _with(errors.growth, growth * shrunk),
    )
    inverse = np.linalg.pinv(whole)
    return LessNoise(
        result,
        taken,
        np.sqrt(np.diag(noise[0])),
        np.sqrt(variance[0]),
        np.sqrt(variance[0]) * shrunk[0],
        at_least,
        np.clip(np.einsum("bij,bji->b", inverse, part) / 4, 0, 1),
    )


def _as_measured(law: Array, measured: Array) -> Array:
    """Covariances of the law (rows, 4, 4) with standard deviations as measured, where both are nearly the same.

    A vessel that is not where it is thought to be makes errors of one component that are far from the law. The tails of
    the law, which all components share, then are too wide for the others. Where all are alike, correlations are those
    measured, too.
    """
    ratio = np.sqrt(np.einsum("bii->bi", measured) / np.maximum(np.einsum("bii->bi", law), 1e-300))
    alike = np.abs(ratio[0] - 1) <= _ALIKE
    if alike.all():
        return measured
    scale = np.where(alike, ratio, 1.0)
    return law * scale[:, :, None] * scale[:, None, :]


def _sure(whole: Array, noise: Array, level: float) -> Mask:
    """Which variances are surely larger than those that errors of truth give, shape (4,)."""
    rest = np.einsum("bii->bi", whole - noise)
    if len(rest) < 3:
        return np.zeros(4, dtype=bool)
    sure: Mask = rest[0] - float(special.ndtri((1 + level) / 2)) * spread(rest[1:]) > 0
    return sure


def _mean_products(std: Array, growth: Array, sides_px: Array) -> Array:
    """Means over boxes of σ_j σ_k with σ = std + growth · side, shape (rows, 4, 4)."""
    mean, second = sides_px.mean(axis=0), sides_px.T @ sides_px / len(sides_px)
    cross = np.einsum("bj,bk->bjk", std, growth * mean)
    products: Array = (
        np.einsum("bj,bk->bjk", std, std)
        + cross
        + np.swapaxes(cross, 1, 2)
        + np.einsum("bj,bk->bjk", growth, growth) * second
    )
    return products


def _matrix(pairs: Array) -> Array:
    """Correlation matrices (rows, 4, 4) from correlations of the `ERROR_PAIRS`, shape (rows, 6)."""
    matrix = np.tile(np.eye(4), (len(pairs), 1, 1))
    matrix[:, _FIRST, _SECOND] = matrix[:, _SECOND, _FIRST] = pairs
    return matrix


def _with(entry: Entry, values: Array) -> Entry:
    return replace(entry, column=replace(entry.column, values=values))
