"""JSON text of many rows at once: columns of texts are joined to rows, and rows to one line for each frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices

Text = bytes | Sequence[bytes]
"""A text that is the same in all rows, or one text for each row."""


def number_texts(numbers: Array | Indices) -> list[bytes]:
    """The JSON text of each number, `null` for NaN; the numbers have shape (n,)."""
    if not len(numbers):
        return []
    return orjson.dumps(np.ascontiguousarray(numbers), option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")


def row_texts(rows: int, *columns: Text) -> list[bytes]:
    """Texts that stand side by side, joined row by row; the JSON in them has no line breaks."""
    pieces = [b"\n"] * (rows * (len(columns) + 1))
    for place, column in enumerate(columns):
        pieces[place :: len(columns) + 1] = [column] * rows if isinstance(column, bytes) else column
    return b"".join(pieces).split(b"\n")[:rows]


def frame_lines(heads: Sequence[bytes], rows: Sequence[bytes], frame: Indices, tail: bytes) -> list[bytes]:
    """One line for each frame: its head, the rows of the frame with commas between them, and the tail.

    Args:
        heads: What the line of each of F frames begins with.
        rows: The texts of n rows.
        frame: The frame of each row, from 0, ascending, shape (n,).
        tail: What every line ends with.
    """
    bounds = np.searchsorted(frame, np.arange(len(heads) + 1)).tolist()
    return [
        head + b",".join(rows[start:stop]) + tail
        for head, start, stop in zip(heads, bounds[:-1], bounds[1:], strict=True)
    ]
