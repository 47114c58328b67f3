"""Closed lines around what is covered, without cutting polygons.

Edges that run between the same places in opposite directions cancel each other. What is left are closed lines that wind
around each point as often as it is covered: filled by the non-zero rule they are the silhouette, holes and all, however
many faces lie over each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices, Mask

PLACE_BITS = 17
"""Bits of a coordinate in a vertex's number."""
_PLACE = (1 << PLACE_BITS) - 1


@dataclass(frozen=True, eq=False)
class Contours:
    """Closed lines, those of one shape after the other.

    Attributes:
        shape: Index of the shape that each line belongs to, non-decreasing, shape (l,).
        count: Number of corners of each line, shape (l,).
        corners: Corners of the lines, line after line, the first not repeated at the end, shape (k, 2).
    """

    shape: Indices
    count: Indices
    corners: Indices


def contours(shape: Indices, ends: Indices) -> Contours:
    """Join the directed edges of each shape to closed lines, by the index of the shape, shape (e,).

    Start and end of the edges are whole numbers from 0 to 65,535, shape (e, 2, 2). In each shape as many edges begin at
    a place as end there.
    """
    place = (ends[..., 0] << PLACE_BITS) + ends[..., 1]
    number, vertex = np.unique((shape[:, None] << 2 * PLACE_BITS) + place, return_inverse=True)
    start, end = vertex.reshape(-1, 2).T
    start, end = _unpaired(start, end, len(number))
    line, count = _joined(start, end)
    numbers = number[start[line]]
    flat = np.column_stack([numbers >> PLACE_BITS, numbers]) & _PLACE
    first = np.cumsum(count) - count
    return Contours(numbers[first] >> 2 * PLACE_BITS, count, flat)


def _unpaired(start: Indices, end: Indices, vertices: int) -> tuple[Indices, Indices]:
    """Start and end of the directed edges that no opposite edge cancels, shape (e,) each."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    edge, which = np.unique(low * vertices + high, return_inverse=True)
    net = np.bincount(which.reshape(-1), np.sign(end - start), len(edge)).astype(np.int64)
    low, high = np.divmod(edge, vertices) if vertices else (edge, edge)
    forth, back = (np.repeat(np.arange(len(edge)), np.maximum(sign * net, 0)) for sign in (1, -1))
    return np.concatenate([low[forth], high[back]]), np.concatenate([high[forth], low[back]])


def _joined(start: Indices, end: Indices) -> tuple[Indices, Indices]:
    """Edges in order along closed lines, shape (e,), and the number of edges of each line, shape (l,).

    As many edges begin at each vertex as end there. A line begins at its lowest vertex. Lines are in order of it, so
    that those of a shape stay together.
    """
    order = np.argsort(start, kind="stable")
    after = np.empty_like(order)
    after[np.argsort(end, kind="stable")] = np.arange(len(order))
    after = after[order]
    first = _least_along(after)
    heads = first == np.arange(len(first))
    count = np.bincount(first, minlength=len(first))
    begin = np.cumsum(np.where(heads, count, 0)) - count
    line = np.empty_like(order)
    left = _left_to(heads, after)
    line[begin[first] + (count[first] - left) % count[first]] = order
    return line, count[heads]


def _least_along(after: Indices) -> Indices:
    """The least index in the ring of each, where one follows the other as `after` says, shape (n,)."""
    least, jump = np.arange(len(after)), after
    while True:
        # Each knows the least of 2, 4, 8, … from itself on; once nobody learns more, all know that of the ring.
        lower = np.minimum(least, least[jump])
        if np.array_equal(lower, least):
            return least
        least, jump = lower, jump[jump]


def _left_to(heads: Mask, after: Indices) -> Indices:
    """Number of steps along `after` from each to the next head, zero for a head itself, shape (n,)."""
    left = np.where(heads, 0, 1)
    jump = np.where(heads, np.arange(len(after)), after)
    while not heads[jump].all():
        left, jump = left + left[jump], jump[jump]
    return left


def tidy_at_border(shape: Indices, ends: Indices, size: tuple[int, int]) -> tuple[Indices, Indices]:
    """Edges without the ways to and fro along the border of an image; the lines wind around its pixels as before.

    Args:
        shape: Shape that each edge belongs to, shape (e,).
        ends: Start and end of each edge, whole numbers from 0 to the size, shape (e, 2, 2).
        size: Greatest column and row.

    Returns:
        Shape and ends of the edges that stay, and of those along the border.
    """
    left = np.ones(len(shape), dtype=bool)
    shapes, every = [], []
    for axis, bound in ((0, 0), (0, size[0]), (1, 0), (1, size[1])):
        there = ends[..., axis] == bound
        on = left & there[:, 0] & there[:, 1]
        left &= ~on
        place, which = np.unique((shape[on, None] << PLACE_BITS) + ends[on, :, 1 - axis], return_inverse=True)
        change = np.bincount(which.reshape(-1), np.tile([1, -1], int(on.sum())), len(place)).astype(np.int64)
        place, cover = place[change != 0], np.cumsum(change[change != 0])
        piece = np.repeat(np.arange(len(cover)), np.abs(cover))
        along = np.stack([place[piece], place[np.minimum(piece + 1, len(place) - 1)]], axis=1)
        along[cover[piece] < 0] = along[cover[piece] < 0, ::-1]
        shapes.append(along[:, 0] >> PLACE_BITS)
        both = np.full((len(along), 2, 2), bound)
        both[..., 1 - axis] = along & _PLACE
        every.append(both)
    return np.concatenate([shape[left], *shapes]), np.concatenate([ends[left], *every])
