"""Sums of products of residuals: over pairs of one group, and over pairs of one series that are a lag apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from modsim3d.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class PairSums:
    """Sums over pairs of independent rows, one for each of L lags, or one alone; shapes (L,).

    Attributes:
        product: Of the products of both rows' values.
        spread: Of the products of both rows' standard deviations.
        variance: Variance of `product`.
        third: Third cumulant of `product`.
    """

    product: Array
    spread: Array
    variance: Array
    third: Array

    @property
    def pairs(self) -> Array:
        """Pairs of rows of one variance that are worth as much, shape (L,)."""
        worth: Array = self.spread**2 / np.where(self.variance > 0, self.variance, np.inf)
        return worth


def group_sums(values: Array, variance: Array, third: Array, group: Indices) -> PairSums:
    """Sums over all pairs of rows of one group, for values and third moments (n, c) and variances and groups (n,).

    With a variance v of each row, the third cumulant has a part from triples: the sum of six times v₁·v₂·v₃.
    """
    _, group = np.unique(group, return_inverse=True)
    components = values.shape[1]

    def of_groups(column: Array) -> Array:
        totals: Array = np.bincount(group, column).astype(np.float64)
        return totals

    def over_pairs(columns: Array) -> float:
        sums = [float((of_groups(column) ** 2 - of_groups(column**2)).sum()) / 2 for column in columns.T]
        return sum(sums)

    deviation = np.sqrt(variance)
    first, second, cube = (of_groups(variance**power) for power in (1, 2, 3))
    triples = float((first**3 - 3 * first * second + 2 * cube).sum())
    return PairSums(
        np.array([over_pairs(values)]),
        np.array([components * over_pairs(deviation[:, None])]),
        np.array([components * over_pairs(variance[:, None])]),
        np.array([over_pairs(third) + components * triples]),
    )


def lag_sums(values: Array, variance: Array, third: Array, series: Indices, step: Indices) -> PairSums:
    """Sums over pairs of rows of one series, for each number of steps between them from 0 on.

    Values and third moments have shape (n, c), the others (n,).
    """
    order = np.lexsort((step, series))
    ends = np.flatnonzero(np.diff(series[order], append=-2))
    spans = [rows for rows in np.split(order, ends[:-1] + 1) if len(rows) > 1]
    longest = max((int(step[rows[-1]] - step[rows[0]]) + 1 for rows in spans), default=1)
    sums = np.zeros((4, longest))
    components = values.shape[1]
    for rows in spans:
        place = step[rows] - step[rows[0]]
        length = int(place[-1]) + 1
        moments = (values[rows], np.sqrt(variance[rows])[:, None], variance[rows][:, None], third[rows])
        for k, columns in enumerate(moments):
            sums[k, :length] += _lagged(place, columns, length)
    sums[1:3] *= components
    return PairSums(*sums)


def _lagged(place: Indices, columns: Array, length: int) -> Array:
    """Sum of products of columns (n, c) with themselves at each lag, given each row's place, shape (length,)."""
    size = fft.next_fast_len(2 * length, real=True)
    dense = np.zeros((size, columns.shape[1]))
    dense[place] = columns
    power = (np.abs(fft.rfft(dense, axis=0)) ** 2).sum(axis=1)
    products: Array = fft.irfft(power, size)[:length]
    return products
