"""The frames of a run for the player of its page, in few bytes.

Columns of small integers are stored one after the other, gzipped, in base64. A length in the image is a multiple of
`quantum_px`, which is 0.1 px for all but very large images.
"""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices

FINEST_PX = 0.1
NONE = 0xFFFF
"""A box side, a vessel or an occluder that is not there."""
UNKNOWN_FRACTION, WHOLE = 255, 250
"""Visible fractions are counted in 250ths."""
ALIGNED_BYTES = 8
"""A typed array in the browser begins at a multiple of its item's size."""

Column = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run for the player.

    Attributes:
        facts: What the numbers mean: names, colours, times. Goes into the page as JSON.
        columns: Name → numbers; `player.js` knows what each is.
    """

    facts: dict[str, Any]
    columns: dict[str, Column]

    def packed(self) -> tuple[list[dict[str, Any]], str]:
        """Where each column begins, and all of them as text; the same for the same numbers."""
        index, parts, offset = [], [], 0
        for name, column in self.columns.items():
            data = np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("<")).tobytes()
            index.append({"name": name, "type": column.dtype.name, "offset": offset, "length": int(column.size)})
            padding = -len(data) % ALIGNED_BYTES
            parts += [data, bytes(padding)]
            offset += len(data) + padding
        return index, base64.b64encode(gzip.compress(b"".join(parts), compresslevel=9, mtime=0)).decode("ascii")


def quantum_px(image_sizes_px: list[tuple[int, int]]) -> float:
    """The finest length with which every place in the images fits into 16 bits."""
    return max(FINEST_PX, max(max(size) for size in image_sizes_px) / (NONE - 1))


def in_quanta(lengths_px: Array, quantum: float) -> NDArray[np.uint16]:
    """Lengths in pixels as multiples of a quantum; `NONE` for NaN. Same shape."""
    counted = np.clip(np.rint(np.nan_to_num(lengths_px) / quantum), 0, NONE - 1)
    return np.where(np.isnan(lengths_px), NONE, counted).astype(np.uint16)


def in_250ths(fraction: Array) -> NDArray[np.uint8]:
    """Visible fractions in 250ths, `UNKNOWN_FRACTION` for NaN; a part is never rounded to 0 or 1. Same shape."""
    counted = np.clip(np.rint(np.nan_to_num(fraction) * WHOLE), np.where(fraction > 0, 1, 0), WHOLE)
    counted = np.where((fraction < 1) & (counted == WHOLE), WHOLE - 1, counted)
    return np.where(np.isnan(fraction), UNKNOWN_FRACTION, counted).astype(np.uint8)


def starts(frame: Indices, frames: int) -> NDArray[np.uint32]:
    """The first row of each frame, and the number of rows, shape (frames + 1,).

    Args:
        frame: Index of the frame of each row, ascending, shape (n,).
        frames: Number of frames.
    """
    return np.searchsorted(frame, np.arange(frames + 1)).astype(np.uint32)
