"""Mean, standard deviation and correlation of box errors, with replicates (Jessen & Mohr (2023), eq. 5.36 to 5.41)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.learn.numbers.resampling import Column, Resampling

CELLS = tuple((i, j) for i in range(4) for j in range(i, 4))
"""Cells of the upper triangle of a covariance."""


@dataclass(frozen=True, eq=False)
class ErrorMoments:
    """Mean (4,), standard deviation with n − 1 (4,) and correlation of the `ERROR_PAIRS` (6,) of box errors."""

    mean: Column
    std: Column
    correlation: Column

    @classmethod
    def of(cls, resampling: Resampling, image: Indices, errors: Array) -> ErrorMoments:
        """Moments of errors of shape (n, 4), given the image of each, shape (n,)."""
        mean, std, correlation = moments(resampling, image, errors)
        number = float(len(errors))
        return cls(
            Column(mean, "mean", np.full(4, number)),
            Column(std, "positive", np.full(4, number)),
            Column(correlation, "correlation", np.full(6, number)),
        )

    def covariance(self) -> Column:
        """Covariances of the `CELLS`, shape (10,)."""
        std, correlation = self.std.values, self.correlation.values
        of_pair = [correlation[:, ERROR_PAIRS.index(cell)] if cell in ERROR_PAIRS else 1.0 for cell in CELLS]
        values = [std[:, i] * std[:, j] * of for (i, j), of in zip(CELLS, of_pair, strict=True)]
        return Column(np.stack(values, axis=1), "mean", np.repeat(self.mean.counts[:1], len(CELLS)))


def covariance(std: Array, correlation: Array) -> Array:
    """Covariance from standard deviations and correlations of the `ERROR_PAIRS`, shapes (4, 4), (4,) and (6,)."""
    matrix = np.eye(4)
    for (i, j), value in zip(ERROR_PAIRS, correlation, strict=True):
        matrix[i, j] = matrix[j, i] = value
    result: Array = np.outer(std, std) * matrix
    return result


def moments(resampling: Resampling, image: Indices, values: Array) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and correlation of vectors (n, 4), shapes (rows, 4), (rows, 4) and (rows, 6)."""
    centre = values.mean(axis=0) if len(values) else np.zeros(4)
    moved = values - centre  # squares of small numbers keep their digits
    products = moved[:, :, None] * moved[:, None, :]
    sums = resampling.sums(image, np.column_stack([np.ones(len(values)), moved, products.reshape(-1, 16)]))
    number = sums[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = sums[:, 1:5] / number[:, None]
        second = sums[:, 5:].reshape(-1, 4, 4) - number[:, None, None] * mean[:, :, None] * mean[:, None, :]
        second = second / (number - 1)[:, None, None]
        std = np.sqrt(np.maximum(np.einsum("bii->bi", second), 0))
        correlation = np.stack([second[:, i, j] / (std[:, i] * std[:, j]) for i, j in ERROR_PAIRS], axis=1)
    few = number < 2
    correlation = np.where(np.isfinite(correlation), correlation, 0.0)
    std[few], correlation[few] = np.nan, np.nan
    return mean + centre, std, correlation
