"""Names for the types of arrays, and functions on arrays that many rooms use."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

NOBODY = -1  # the index of a name that is not given, or not among the names


@dataclass(frozen=True, eq=False)
class Columns:
    """A table of n rows: its fields are arrays with a row each, but for fields that are no arrays and hold for all."""

    def _fields(self) -> dict[str, Any]:
        values = vars(self)  # a live step calls this too often for `dataclasses.fields`
        return {name: values[name] for name in type(self).__dataclass_fields__ if name in values}

    def __len__(self) -> int:
        """Number of rows."""
        return next(len(column) for column in self._fields().values() if isinstance(column, np.ndarray))

    def take(self, rows: Indices | Mask | slice) -> Self:
        """Some of the rows: by mask, shape (n,), by row numbers in any order, shape (m,), or by slice."""
        columns = self._fields().items()
        return type(self)(**{name: field[rows] if isinstance(field, np.ndarray) else field for name, field in columns})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The rows of one or more tables of arrays alone, one table after another."""
        tables = [part._fields() for part in parts]
        return cls(**{name: np.concatenate([table[name] for table in tables]) for name in tables[0]})


def read_only(values: ArrayLike) -> Array:
    """A copy as doubles that cannot be written to, of the same shape."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def ranges(first: Indices, count: Indices) -> Indices:
    """The numbers first, first + 1, … of each of k ranges with `count` numbers, joined, shape (sum of counts,)."""
    before = count.cumsum() - count  # methods: a live step calls this too often for functions that look for them
    return np.arange(int(count.sum())) + (first - before).repeat(count)


def run_starts(*columns: Indices) -> Indices:
    """The first row, and those at which one of some columns (n,) has another value than in the row before, (k,)."""
    starts = np.ones(len(columns[0]), dtype=bool)
    starts[1:] = columns[0][1:] != columns[0][:-1]  # `np.diff` with `prepend` takes three times as long for few rows
    for column in columns[1:]:
        starts[1:] |= column[1:] != column[:-1]
    return starts.nonzero()[0]


def row_before(keys: Indices) -> Indices:
    """The last row before each row that has the same key, −1 for none, shape (n,)."""
    before = np.full(len(keys), -1)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    before[order[same + 1]] = order[same]
    return before


def distinct(values: Indices) -> Indices:
    """The distinct values of an array (n,), ascending, (k,). `np.unique` gives the same by a hash table, which is
    slower: ten times for a thousand values."""
    ordered = np.sort(values)
    return ordered[run_starts(ordered)]


def extents(column: Indices, wanted: Indices) -> tuple[Indices, Indices]:
    """First row of each of k numbers in an ascending column, and how often it is there, shapes (k,)."""
    first, stop = (np.searchsorted(column, wanted, side=side) for side in ("left", "right"))
    return first, stop - first


def positions(keys: Indices, wanted: Indices) -> Indices:
    """Place of each of m wanted keys among n distinct keys, `NOBODY` if nowhere, shape (m,)."""
    if not len(keys):
        return np.full(len(wanted), NOBODY)
    order = np.argsort(keys)
    place = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
    return np.where(keys[place] == wanted, place, NOBODY)


def occurring(indices: Indices, count: int) -> tuple[Indices, Indices]:
    """Indices below `count` that occur, ascending, and the place of each of n indices among them, shapes (k,) and (n,).
    What `np.unique` gives, but faster for few indices; and that loads `numpy.ma` at its first call, which takes
    15 ms."""
    occurs = np.zeros(count, dtype=bool)
    occurs[indices] = True
    return occurs.nonzero()[0], (occurs.cumsum() - 1)[indices]
