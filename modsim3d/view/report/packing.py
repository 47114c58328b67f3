"""Columns of whole numbers in few bytes for the player of a run's page; its other side is `report/player/columns.js`.
A column that changes little is stored as differences: from its row before, from the row before of the same vessel, or
from another column. The differences are zigzag numbers (0, −1, 1, −2 become 0, 1, 2, 3), first the low bytes of all of
them, then the higher ones, so that gzip finds long runs of zeros."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from modsim3d.core import arrays
from modsim3d.core.arrays import Array, Indices, row_before

NONE = 0xFFFF  # a box side, a vessel or an occluder that is not there; every place in an image is below it
ALIGNED_BYTES = 8  # a typed array in the browser begins at a multiple of its item's size
LEVEL = 6  # of zlib: level 9 takes three times as long for 2% fewer bytes
ROW_BEFORE, OUTLINE_BEFORE = "row", "outline"  # what a row may be a difference from, besides a column's name

Column = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Codes:
    """A column, shape (n,) or (n, k), stored as differences `by` the row before (`ROW_BEFORE`), the row before with the
    same value in the column of this name, or the corner of the outline before (`OUTLINE_BEFORE`)."""

    values: Column
    by: str | None = None
    base: str | None = None  # name of the column from whose same row each row is the difference


Columns = Mapping[str, Column | Codes]  # by name; one comes after those that it is a difference from


def packed(columns: Columns) -> bytes:
    """All columns after an index of them, compressed; the same for the same numbers."""
    index, parts, offset = [], [], 0
    for name, column in columns.items():
        coded = column if isinstance(column, Codes) else Codes(column)
        values = coded.values
        entry: dict[str, Any] = {"name": name, "type": values.dtype.name, "length": int(values.size), "offset": offset}
        if isinstance(column, Codes):
            entry |= {"width": width_of(values), "by": coded.by, "base": coded.base}
        data = _planes(_differences(coded, columns)) if isinstance(column, Codes) else _bytes(values)
        index.append(entry)
        parts += [data, bytes(-len(data) % ALIGNED_BYTES)]
        offset += len(data) + len(parts[-1])
    head = orjson.dumps(index)
    head += b" " * (-(len(head) + ALIGNED_BYTES) % ALIGNED_BYTES)
    packer = zlib.compressobj(LEVEL, wbits=31)  # gzip, without a time
    content = b"".join([len(head).to_bytes(ALIGNED_BYTES, "little"), head, *parts])
    return packer.compress(content) + packer.flush()


def as_text(data: bytes) -> str:
    """Bytes as text for an HTML file."""
    return base64.b64encode(data).decode("ascii")


def _bytes(values: Column) -> bytes:
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()


def _planes(zigzag: Column) -> bytes:
    """The lowest byte of each number, then the next byte of each, and so on."""
    size = zigzag.dtype.itemsize
    return np.ascontiguousarray(np.frombuffer(_bytes(zigzag), np.uint8).reshape(-1, size).T).tobytes()


def _differences(coded: Codes, columns: Columns) -> Column:
    """The differences as zigzag numbers, of the column's size and item size."""
    bits = 8 * coded.values.dtype.itemsize
    whole = _whole(coded.values).astype(np.int64)
    if coded.base is not None:
        before = _whole(_values(columns[coded.base])).astype(np.int64)
    else:
        rows = rows_before(coded, columns)
        before = np.where((rows >= 0)[:, None], whole[rows], 0)
    signed = (whole - before).astype(f"uint{bits}").view(f"int{bits}")
    return ((signed << 1) ^ (signed >> (bits - 1))).view(f"uint{bits}")


def _whole(values: Column) -> Column:
    """Rows of whole numbers, shape (n, k); floating point numbers as their bits."""
    if values.dtype.kind == "f":
        values = np.ascontiguousarray(values).view(f"uint{8 * values.dtype.itemsize}")
    return values.reshape(len(values), width_of(values))


def width_of(values: Column) -> int:
    """Numbers in a row of a column."""
    return int(values.shape[1]) if values.ndim > 1 else 1


def _values(column: Column | Codes) -> Column:
    return column.values if isinstance(column, Codes) else column


def rows_before(coded: Codes, columns: Columns) -> Indices:
    """The row that each row is a difference from, −1 for none, shape (n,)."""
    if coded.by is None:
        return np.full(len(coded.values), -1)
    if coded.by == ROW_BEFORE:
        return np.arange(len(coded.values)) - 1
    if coded.by == OUTLINE_BEFORE:
        names = "outlineOwner", "lineCount", "cornerCount"
        return _corners_before(*(_values(columns[name]).astype(np.int64) for name in names))
    return row_before(_values(columns[coded.by]))


def _corners_before(owner: Indices, line_count: Indices, corner_count: Indices) -> Indices:
    """For each corner that of the outline before of the same owner, if it has as many; else the corner before."""
    lines = np.concatenate([[0], np.cumsum(line_count)])
    corners = np.concatenate([[0], np.cumsum(corner_count)])[lines]
    size, first, before = np.diff(corners), corners[:-1], row_before(owner)
    alike = (before >= 0) & (size[before] == size)
    shift = np.where(alike, first - first[before], 1)
    rows: Indices = np.arange(corners[-1]) - np.repeat(shift, size)
    begins = first[~alike & (size > 0)]
    rows[begins] = -1
    return rows


def in_quanta(lengths_px: Array, quantum: float) -> NDArray[np.uint16]:
    """Lengths in pixels as multiples of a quantum, `NONE` for NaN, of the same shape."""
    counted = np.clip(np.rint(np.nan_to_num(lengths_px) / quantum), 0, NONE - 1)
    return np.where(np.isnan(lengths_px), NONE, counted).astype(np.uint16)


def starts(frame: Indices, frames: int) -> NDArray[np.uint32]:
    """The first row of each frame, and the number of rows, shape (frames + 1,); from each row's frame, shape (n,)."""
    return np.searchsorted(frame, np.arange(frames + 1)).astype(np.uint32)


# ---- Stretches of steps in which something is so without a break ----


@dataclass(frozen=True, eq=False)
class Stretches(arrays.Columns):
    """Stretches of shown steps, in order of key and time."""

    key: Indices  # what is so, of whom: any whole number, shape (n,)
    first: Indices  # index of the first step, shape (n,)
    until: Indices  # index of the last step, shape (n,)

    def of(self, first_key: int, stop_key: int) -> Stretches:
        """Stretches with keys first_key to stop_key − 1."""
        return self.take(slice(*np.searchsorted(self.key, (first_key, stop_key)).tolist()))

    def by_time(self) -> Stretches:
        """Stretches in order of their first steps and then of their keys."""
        return self.take(np.lexsort((self.key, self.first)))


def onsets(begins: Stretches, holds: Stretches) -> Stretches:
    """Stretches of `holds`, each from the first step in it that is in `begins` too; those with none are left out.
    Stretches in `begins` lie in longer ones of `holds` of the same keys."""

    span = int(holds.until.max(initial=0)) + 1
    place = np.searchsorted(holds.key * span + holds.first, begins.key * span + begins.first, side="right") - 1
    which, first = np.unique(place, return_index=True)
    return Stretches(holds.key[which], begins.first[first], holds.until[which])


class StretchesBuilder:
    """Stretches of a run that comes in parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self._parts: list[Stretches] = []

    def add(self, key: Indices, index: Indices) -> None:
        """Add steps at which something is so: keys and indices of steps, both of shape (n,), each pair once."""
        order = np.lexsort((index, key))
        self._parts.append(_joined(key[order], index[order], index[order]))

    def stretches(self) -> Stretches:
        """All of them; those that touch across parts are one."""
        none = np.empty(0, dtype=np.int64)
        key, first, until = (
            np.concatenate([none, *(getattr(part, name) for part in self._parts)]) for name in ("key", "first", "until")
        )
        order = np.lexsort((first, key))
        return _joined(key[order], first[order], until[order])


def _joined(key: Indices, first: Indices, until: Indices) -> Stretches:
    """Stretches in order of key and time, those that follow on each other without a gap joined."""
    if not len(key):
        return Stretches(key, first, until)
    begins = np.append(True, (np.diff(key) != 0) | (first[1:] > until[:-1] + 1))
    return Stretches(key[begins], first[begins], until[np.append(begins[1:], True)])
