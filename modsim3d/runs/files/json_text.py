"""JSON text of many rows at once: columns of texts are joined to one text with a line for each frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import orjson

from modsim3d.arrays import Array, Indices

Text = bytes | Sequence[bytes]
"""A text that is the same in all rows, or one text for each row."""


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


def frame_lines(heads: Sequence[bytes], tail: bytes, frame: Indices, *columns: Text) -> bytes:
    """A line for each frame: its head, the texts of its rows with commas between them, and the tail.

    Args:
        heads: What the line of each of F frames begins with.
        tail: What every line ends with.
        frame: The frame of each of n rows, from 0, ascending, shape (n,).
        columns: The texts that stand side by side in each row.
    """
    bounds = np.searchsorted(frame, np.arange(len(heads) + 1)).tolist()
    before, between = [b","] * len(frame), b""
    for head, start, stop in zip(heads, bounds[:-1], bounds[1:], strict=True):
        if start == stop:
            between += head + tail
        else:
            before[start], between = between + head, tail
    texts: tuple[Text, ...] = (before, *columns)
    pieces = [between] * (len(frame) * len(texts) + 1)
    for place, column in enumerate(texts):
        pieces[place : -1 : len(texts)] = [column] * len(frame) if isinstance(column, bytes) else column
    return b"".join(pieces)
