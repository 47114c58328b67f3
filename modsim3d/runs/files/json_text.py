"""JSON text of many rows at once: columns of texts are joined to one text with a line for each frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices

Column = bytes | Sequence[bytes] | Array
"""A text that is the same in all n rows; one for each row; or numbers of shape (n,), or (n, k) with commas between."""
ROWS_AT_ONCE = 1024
"""Rows whose texts are made together: those of many more rows take fresh memory, which costs more time than to fill it.
"""


def string_texts(strings: Sequence[str]) -> list[bytes]:
    """The JSON text of each string."""
    # One a line: JSON has no line breaks inside a string.
    return orjson.dumps(strings, option=orjson.OPT_INDENT_2)[4:-2].split(b",\n  ") if strings else []


def number_texts(numbers: Array | Indices) -> list[bytes]:
    """The JSON text of each number, `null` for NaN; the numbers have shape (n,)."""
    if not len(numbers):
        return []
    return orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")


def list_texts(numbers: Array) -> list[bytes]:
    """The JSON text of each row of numbers of shape (n, k), with commas between them and without brackets."""
    if not len(numbers):
        return []
    return orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].split(b"],[")


def frame_lines(heads: Sequence[bytes], tail: bytes, frame: Indices, *columns: Column) -> bytes:
    """A line for each frame: its head, the texts of its rows with commas between them, and the tail.

    Args:
        heads: What the line of each of F frames begins with.
        tail: What every line ends with.
        frame: The frame of each of n rows, from 0, ascending, shape (n,).
        columns: What stands side by side in each row.
    """
    bounds = np.searchsorted(frame, np.arange(len(heads) + 1)).tolist()
    before, between = [b","] * len(frame), b""
    for head, start, stop in zip(heads, bounds[:-1], bounds[1:], strict=True):
        if start == stop:
            between += head + tail
        else:
            before[start], between = between + head, tail
    starts = range(0, len(frame), ROWS_AT_ONCE)
    parts = [_joined(slice(start, start + ROWS_AT_ONCE), before, *columns) for start in starts]
    return b"".join([*parts, between])


def _joined(rows: slice, before: Sequence[bytes], *columns: Column) -> bytes:
    """The texts of some rows, each after what stands before it."""
    texts = [column if isinstance(column, bytes) else _texts(column[rows]) for column in (before, *columns)]
    count = len(before[rows])
    pieces = [b""] * (count * len(texts))
    for place, text in enumerate(texts):
        pieces[place :: len(texts)] = [text] * count if isinstance(text, bytes) else text
    return b"".join(pieces)


def _texts(column: Sequence[bytes] | Array) -> Sequence[bytes]:
    if not isinstance(column, np.ndarray):
        return column
    return number_texts(column) if column.ndim == 1 else list_texts(column)
