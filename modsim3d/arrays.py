"""Names for the kinds of arrays, and what many rooms do with rows of numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


def read_only(values: ArrayLike) -> Array:
    """A copy as doubles that cannot be written to, of the same shape."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def ranges(first: Indices, count: Indices) -> Indices:
    """The numbers first, first + 1, … of each range, one range after another.

    Args:
        first: First number of each range, shape (k,).
        count: How many numbers each range has, shape (k,).

    Returns:
        Shape (sum of the counts,).
    """
    before = np.cumsum(count) - count
    numbers: Indices = np.arange(int(count.sum())) + np.repeat(first - before, count)
    return numbers
