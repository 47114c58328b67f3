"""Columns of a run's tables as NumPy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.runs.files.table_columns import BOX_SIDES

NOBODY = -1
"""The index of a name that is null, or not among the names."""


def numbers(table: pa.Table, name: str) -> Array:
    """A column of numbers, NaN for null, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.float64)


def integers(table: pa.Table, name: str) -> Indices:
    """A column of whole numbers without nulls, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.int64)


def flags(table: pa.Table, name: str) -> Mask:
    """A column of truth values without nulls, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=bool)


def indices(table: pa.Table, name: str, names: Sequence[str]) -> Indices:
    """A column of names as indices, `NOBODY` for null and for a name that is not among them, shape (n,)."""
    found = pc.index_in(table[name], value_set=pa.array(list(names), pa.string()))
    return np.asarray(found.fill_null(NOBODY).to_numpy(zero_copy_only=False), dtype=np.int64)


def positions(keys: Indices, wanted: Indices) -> Indices:
    """Where each of m wanted keys stands among n distinct keys, `NOBODY` if nowhere, shape (m,)."""
    if not len(keys):
        return np.full(len(wanted), NOBODY)
    order = np.argsort(keys)
    place = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
    return np.where(keys[place] == wanted, place, NOBODY)


def truth_boxes_px(table: pa.Table, prefix: str) -> Array:
    """The `full` or `visible` boxes of a truth table as x_min, y_min, x_max, y_max; NaN for no box, shape (n, 4)."""
    return np.column_stack([numbers(table, f"{prefix}_{side}") for side in BOX_SIDES])


def detection_boxes_px(table: pa.Table) -> Array:
    """The boxes of a table of detections as x_min, y_min, x_max, y_max, shape (n, 4)."""
    return np.column_stack([numbers(table, name) for name in BOX_SIDES])


@dataclass(frozen=True, eq=False)
class Occluders:
    """Who hides whom: m entries of the n rows of a truth table.

    Attributes:
        counts: Number of entries of each row, shape (n,).
        name: Index of the occluder's name, shape (m,).
        px: Number of pixels that it hides, shape (m,).
    """

    counts: Indices
    name: Indices
    px: Array

    @classmethod
    def of(cls, truth: pa.Table, occluder_names: Sequence[str]) -> Occluders:
        """Read the column `occluded_by`."""
        lists = truth["occluded_by"].combine_chunks()
        entries = lists.flatten()
        table = pa.table({name: entries.field(name) for name in ("id", "px")})
        counts = np.asarray(lists.value_lengths(), dtype=np.int64)
        return cls(counts, indices(table, "id", occluder_names), numbers(table, "px"))

    @property
    def hidden(self) -> Indices:
        """Row of the hidden vessel of each entry, shape (m,)."""
        return np.repeat(np.arange(len(self.counts)), self.counts)

    @property
    def offsets(self) -> Indices:
        """Where the entries of each row begin, and the end, shape (n + 1,)."""
        return np.concatenate([[0], np.cumsum(self.counts)])
