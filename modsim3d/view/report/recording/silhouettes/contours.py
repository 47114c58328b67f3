"""Outlines of drawn triangles as closed lines, without cutting polygons.

Where triangles that all run the same way round share an edge, they run along it in opposite directions. What is left
when such pairs are taken away are closed lines that wind around each point as often as triangles cover it: filled by
the non-zero rule they are the silhouette, holes and all, however many triangles lie over each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

PLACE_BITS = 17
"""Bits of a coordinate in a vertex's number."""


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


def contours(shape: Indices, corners: Indices) -> Contours:
    """Find the lines around what the triangles of each shape cover, by the index of the shape, shape (T,).

    The corners are whole numbers from 0 to 65,535, shape (T, 3, 2), and all triangles run the same way round.
    """
    place = (corners[..., 0] << PLACE_BITS) + corners[..., 1]
    number, vertex = np.unique((shape[:, None] << 2 * PLACE_BITS) + place, return_inverse=True)
    vertex = vertex.reshape(-1, 3)
    start, end = _unpaired(vertex.ravel(), np.roll(vertex, -1, axis=1).ravel(), len(number))
    line, count = _joined(start, end)
    numbers = number[start[line]]
    flat = np.column_stack([numbers >> PLACE_BITS, numbers]) & ((1 << PLACE_BITS) - 1)
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

    As many edges begin at each vertex as end there.
    """
    after = np.empty_like(start)
    after[np.argsort(end, kind="stable")] = np.argsort(start, kind="stable")
    follows, done = after.tolist(), bytearray(len(start))
    line: list[int] = []
    count: list[int] = []
    # By the lowest vertex of each, so that lines of a shape stay together.
    for first in np.argsort(start, kind="stable").tolist():
        begun, edge = len(line), first
        while not done[edge]:
            done[edge] = 1
            line.append(edge)
            edge = follows[edge]
        if len(line) > begun:
            count.append(len(line) - begun)
    return np.array(line, dtype=np.int64), np.array(count, dtype=np.int64)


def one_way_round(corners_px: Array, corners: Indices, closed: Mask) -> tuple[Mask, Indices]:
    """The triangles that a contour needs, all the same way round; of a closed solid only those that face the camera.

    Args:
        corners_px: Corners in pixels of the image, shape (T, 3, 2).
        corners: The same in the units of `contours`, shape (T, 3, 2).
        closed: Whether a triangle's solid is closed, shape (T,).

    Returns:
        Which triangles are needed, shape (T,), and their corners in those units, shape (T', 3, 2).
    """
    a, b, c = np.moveaxis(corners_px, 1, 0)
    # Rows run downwards: the area of a face turned to the camera is positive this way round.
    doubled = (b - a)[:, 1] * (c - a)[:, 0] - (b - a)[:, 0] * (c - a)[:, 1]
    kept = np.where(closed, doubled, np.abs(doubled)) > 0
    turned = np.where((doubled < 0)[:, None, None], corners[:, ::-1], corners)
    return kept, turned[kept]
