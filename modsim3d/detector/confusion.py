"""Confusion matrices from counts to probabilities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.arrays import Array
from modsim3d.errors import InputError


def probabilistic_confusion(counts: ArrayLike) -> tuple[Array, Array]:
    """Estimates Pr(detected as i | true label j) and the labels of false positives from counts.

    Eq. 5.25 sums a column over the labels only; the worked Table 5.5 divides by the sum with dropouts, which
    is what makes a column a distribution, and is what is done here.

    Args:
        counts: Rows what was detected, columns what was there: k labels, then background. Shape
            (k + 1, k + 1). The count of background as background is undefined, and not read.

    Returns:
        Probabilities, rows labels then background, shape (k + 1, k) (Jessen & Mohr (2023), eq. 5.25); and
        Pr(label i | false positive), shape (k,) (eq. 5.26), uniform if there were no false positives.

    Raises:
        InputError: The shape is wrong, a count is negative or not finite, or a label never occurred.
    """
    table = np.array(counts, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] != table.shape[1] or len(table) < 2:
        raise InputError("confusion counts", [f"shape is {table.shape}, must be (k + 1, k + 1) with k >= 1"])
    table[-1, -1] = 0
    columns = table[:, :-1].sum(axis=0)
    if not np.all(np.isfinite(table) & (table >= 0)):
        raise InputError("confusion counts", ["every count must be finite and at least 0"])
    if not np.all(columns > 0):
        empty = ", ".join(str(column) for column in np.flatnonzero(columns == 0))
        raise InputError("confusion counts", [f"nothing was there in column {empty}: no rate can be estimated"])
    background = table[:-1, -1]
    clutter = background / background.sum() if background.any() else np.full(len(background), 1 / len(background))
    return table[:, :-1] / columns, clutter
