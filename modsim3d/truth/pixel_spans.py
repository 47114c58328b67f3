"""Silhouettes as spans: runs of pixels in a scan line, which say the same as a mask in far fewer numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask, run_starts


@dataclass(frozen=True, eq=False)
class Spans:
    """Runs of pixels of n silhouettes.

    Attributes:
        row: Index of the silhouette, shape (m,).
        y: Pixel row, shape (m,).
        start: First column, shape (m,).
        stop: The column after the last, greater than `start`, shape (m,).
    """

    row: Indices
    y: Indices
    start: Indices
    stop: Indices

    @classmethod
    def none(cls) -> Spans:
        """No spans."""
        empty = np.empty(0, dtype=np.int64)
        return cls(empty, empty, empty, empty)

    def take(self, chosen: Mask | Indices) -> Spans:
        """The chosen spans, given by a mask, shape (m,), or by indices, shape (k,)."""
        return Spans(self.row[chosen], self.y[chosen], self.start[chosen], self.stop[chosen])

    def ordered(self) -> Spans:
        """The spans in order of silhouette."""
        return self.take(np.argsort(self.row, kind="stable"))

    def moved(self, dx: Indices | int, dy: Indices | int) -> Spans:
        """The spans moved right by dx and down by dy, each a number or of shape (m,)."""
        return Spans(self.row, self.y + dy, self.start + dx, self.stop + dx)


_FAR = np.iinfo(np.int64).max
_NO_BOX = np.array([np.inf, np.inf, -np.inf, -np.inf])


def counts_and_boxes(spans: Spans, count: int) -> tuple[Array, Array]:
    """Numbers of pixels, shape (n,), and bounding boxes, shape (n, 4), of n = `count` silhouettes; spans in any order.

    Boxes are half-open, [x_min, x_max) × [y_min, y_max); the box of a silhouette without a pixel is
    (inf, inf, −inf, −inf).
    """
    # The first of the spans of one silhouette that follow each other: summed up first if they are several as a rule.
    first = run_starts(spans.row)
    several = 4 * len(first) < len(spans.row)
    row = spans.row[first] if several else spans.row

    def of_rows(reduce: np.ufunc, values: Indices) -> Indices:
        """One value for each of `row`, shape of `row`."""
        reduced: Indices = reduce.reduceat(values, first) if several else values
        return reduced

    pixels: Array = np.bincount(row, of_rows(np.add, spans.stop - spans.start), minlength=count).astype(np.float64)
    low, high = np.full((2, count), _FAR), np.full((2, count), -1)
    for axis, (starts, stops) in enumerate(((spans.start, spans.stop), (spans.y, spans.y + 1))):
        np.minimum.at(low[axis], row, of_rows(np.minimum, starts))
        np.maximum.at(high[axis], row, of_rows(np.maximum, stops))
    boxes: Array = np.where(pixels > 0, np.concatenate([low, high]), _NO_BOX[:, None]).T.copy()
    return pixels, boxes


def joined_spans(parts: Sequence[Spans]) -> Spans:
    """Spans of several sets, one at least, one set after another."""
    if len(parts) == 1:
        return parts[0]
    return Spans(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "y", "start", "stop")))


def runs_of_ids(ids: NDArray[np.uint32]) -> tuple[Indices, Indices]:
    """Where each run of equal IDs begins in an ID image (h, w) read row by row, and its ID; both of shape (k,).

    Each pixel row begins a new run.
    """
    flat = ids.reshape(-1)
    begins = np.empty(flat.shape, dtype=bool)
    np.not_equal(flat[1:], flat[:-1], out=begins[1:])
    begins[:: ids.shape[1]] = True
    starts = np.flatnonzero(begins)
    return starts, flat[starts].astype(np.int64)


def spans_of_ids(ids: NDArray[np.uint32]) -> Spans:
    """The spans of the silhouettes in an ID image in which none hides another; ordered by scan line.

    An ID is the index of the silhouette + 1, zero where there is none, shape (h, w).
    """
    starts, values = runs_of_ids(ids)
    stops = np.append(starts[1:], ids.size)
    filled = values > 0
    lines, first = np.divmod(starts[filled], ids.shape[1])
    return Spans(values[filled] - 1, lines, first, first + (stops - starts)[filled])
