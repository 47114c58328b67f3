"""Which boxes of the same frame overlap: only those can hide each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, ranges, run_starts


def frame_slices(frame: Indices) -> list[slice]:
    """The rows of each frame that has any; `frame` is that of each row, non-decreasing, shape (n,)."""
    edges = [*run_starts(frame).tolist(), len(frame)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def overlapping_pairs(frame: Indices, boxes_px: Array, some_of: Mask | None = None) -> tuple[Indices, Indices]:
    """Pairs of rows of the same frame whose boxes overlap.

    All frames are swept at once from left to right: a box meets those that begin before it ends.

    Args:
        frame: Frame of each row, non-decreasing, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        some_of: At least one row of each pair must be set here, shape (n,); by default all rows are.

    Returns:
        First and second rows in ascending order, each of shape (P,), first < second.
    """
    n, chosen = len(frame), np.ones(len(frame), dtype=bool) if some_of is None else some_of
    if n < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    left, top, right, bottom = np.ascontiguousarray(boxes_px.T)
    # Right sides come before left sides at the same place: boxes that only touch do not overlap.
    is_left = np.arange(2 * n) < n
    side = np.lexsort((is_left, np.concatenate([left, right]), np.concatenate([frame, frame])))
    place = np.empty(2 * n, dtype=np.int64)
    place[side] = np.arange(2 * n)
    begun = side[side < n]
    one, other = (
        np.concatenate(pair)
        for pair in zip(
            _begins_within(place, side, np.flatnonzero(chosen), begun),
            _begins_within(place, side, np.flatnonzero(~chosen), begun[chosen[begun]]),
            strict=True,
        )
    )
    overlap = (top[one] < bottom[other]) & (top[other] < bottom[one]) & (left[one] < right[other])
    first, second = np.minimum(one, other)[overlap], np.maximum(one, other)[overlap]
    order = np.argsort(first * n + second)
    return first[order], second[order]


def _begins_within(place: Indices, side: Indices, rows: Indices, others: Indices) -> tuple[Indices, Indices]:
    """Pairs of one of `rows` and one of `others` whose left side comes between the row's left and right sides.

    Args:
        place: Place in the sweep of the n left sides and then of the n right sides, shape (2n,).
        side: The inverse of `place`.
        rows: Shape (k,).
        others: In the order of the sweep, shape (m,).
    """
    if not len(rows):
        return rows, rows
    n = len(place) // 2
    # How many of `others` begin before each place.
    is_other = np.zeros(2 * n + 1, dtype=np.int64)
    is_other[place[others] + 1] = 1
    begun = np.cumsum(is_other)
    first = begun[place[rows] + 1]
    count = np.maximum(begun[place[rows + n]] - first, 0)
    return np.repeat(rows, count), others[ranges(first, count)]
