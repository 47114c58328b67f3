"""Which boxes of the same frame overlap: only those can hide each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from modsim3d.arrays import Array, Indices, Mask


def frame_slices(frame: Indices) -> list[slice]:
    """The rows of each frame that has any; `frame` is that of each row, non-decreasing, shape (n,)."""
    edges = [*np.flatnonzero(np.diff(frame, prepend=-1)).tolist(), len(frame)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def overlapping_pairs(frame: Indices, boxes_px: Array, some_of: Mask | None = None) -> tuple[Indices, Indices]:
    """Pairs of rows of the same frame whose boxes overlap.

    Args:
        frame: Frame of each row, non-decreasing, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        some_of: At least one row of each pair must be set here, shape (n,); by default all rows are.

    Returns:
        First and second rows in ascending order, each of shape (P,), first < second.
    """
    firsts, seconds = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for rows in frame_slices(frame):
        one, other = _overlapping(boxes_px[rows], None if some_of is None else np.flatnonzero(some_of[rows]))
        firsts.append(one + rows.start)
        seconds.append(other + rows.start)
    return np.concatenate(firsts), np.concatenate(seconds)


def _overlapping(boxes: Array, chosen: Indices | None) -> tuple[Indices, Indices]:
    """Pairs of boxes (n, 4) that overlap, of which one is chosen; in order."""
    every = np.arange(len(boxes))
    chosen = every if chosen is None else chosen
    low, high = boxes[chosen, None, :2], boxes[chosen, None, 2:]
    overlap = ((low < boxes[None, :, 2:]) & (boxes[None, :, :2] < high)).all(axis=2)
    not_chosen = np.ones(len(boxes), dtype=bool)
    not_chosen[chosen] = False
    # A pair of two chosen boxes is found from both of them: count it from the first.
    place, other = np.nonzero(overlap & (not_chosen | (every > chosen[:, None])))
    first, second = np.minimum(chosen[place], other), np.maximum(chosen[place], other)
    order = np.lexsort((second, first))
    return first[order], second[order]
