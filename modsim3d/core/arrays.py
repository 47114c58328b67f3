"""Names for the types of arrays, and functions on arrays that many rooms use."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

NOBODY = -1
"""The index of a name that is not given, or not among the names."""


def read_only(values: ArrayLike) -> Array:
    """A copy as doubles that cannot be written to, of the same shape."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def ranges(first: Indices, count: Indices) -> Indices:
    """The numbers first, first + 1, … of each of k ranges with `count` numbers, joined, shape (sum of counts,)."""
    before = count.cumsum() - count  # methods: a live step calls this too often for functions that look for them
    numbers: Indices = np.arange(int(count.sum())) + (first - before).repeat(count)
    return numbers


def run_starts(*columns: Indices) -> Indices:
    """The first row, and those at which one of some columns (n,) has another value than in the row before, (k,)."""
    starts = np.ones(len(columns[0]), dtype=bool)
    starts[1:] = columns[0][1:] != columns[0][:-1]  # `np.diff` with `prepend` takes three times as long for few rows
    for column in columns[1:]:
        starts[1:] |= column[1:] != column[:-1]
    return starts.nonzero()[0]


def distinct(values: Indices) -> Indices:
    """The distinct values of an array (n,), ascending, (k,).

    `np.unique` gives the same by a hash table, which is slower: ten times for a thousand values.
    """
    ordered = np.sort(values)
    return ordered[run_starts(ordered)]


def extents(column: Indices, wanted: Indices) -> tuple[Indices, Indices]:
    """First row of each of k numbers in an ascending column, and how often it is there, shapes (k,)."""
    first, stop = (np.searchsorted(column, wanted, side=side) for side in ("left", "right"))
    return first, stop - first


def occurring(indices: Indices, count: int) -> tuple[Indices, Indices]:
    """Indices below `count` that occur, ascending, and the place of each of n indices among them, shapes (k,) and (n,).

    What `np.unique` gives, but faster for few indices; and that loads `numpy.ma` at its first call, which takes 15 ms.
    """
    occurs = np.zeros(count, dtype=bool)
    occurs[indices] = True
    return occurs.nonzero()[0], (occurs.cumsum() - 1)[indices]
