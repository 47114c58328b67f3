"""Which of two disjoint convex solids is in front, from a plane between them.

If a plane has one solid on the camera's side and the other beyond, no ray from the camera can meet the far one first:
behind the plane it never comes back. The distance of the centres decides nothing: a long ship's centre may be nearer
than that of a boat that lies in front of its stern.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from modsim3d.annotate.outlines import Outlines
from modsim3d.frames import Array
from modsim3d.vessels import Solid

TOUCHING_M = 1e-7
"""Solids that overlap by less are taken to touch: rounding must not turn neighbours at a quay into a collision."""

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Order:
    """What pairs of rows of `Outlines` can do to each other.

    Attributes:
        first: Row, shape (P,).
        second: Row of the same frame, greater than `first`, shape (P,).
        first_can_hide: Whether the first can hide a part of the second, shape (P,).
        second_can_hide: The other way round, shape (P,).
        intersecting: Whether no plane separates them: then nothing is known, and both of the above are false.
    """

    first: Indices
    second: Indices
    first_can_hide: NDArray[np.bool_]
    second_can_hide: NDArray[np.bool_]
    intersecting: NDArray[np.bool_]


def overlapping_pairs(frame: Indices, boxes_px: Array) -> tuple[Indices, Indices]:
    """Pairs of rows of the same frame whose boxes overlap.

    Args:
        frame: Non-decreasing, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).

    Returns:
        First and second rows, each of shape (P,), first < second.
    """
    edges = [*np.flatnonzero(np.diff(frame, prepend=-1)).tolist(), len(frame)]
    firsts, seconds = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for start, stop in pairwise(edges):
        boxes = boxes_px[start:stop]
        over = (boxes[:, None, :2] < boxes[None, :, 2:]).all(axis=2)
        first, second = np.nonzero(np.triu(over & over.T, k=1))
        firsts.append(first + start)
        seconds.append(second + start)
    return np.concatenate(firsts), np.concatenate(seconds)


def order_of(outlines: Outlines) -> Order:
    """Look for a plane between every two solids whose boxes overlap in the image.

    Two disjoint convex polyhedra are separated along a face normal of one of them or the cross product of an edge of
    each (Gottschalk, Lin & Manocha (1996), "OBBTree", for boxes).
    """
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    edges = edge_directions(outlines.vertices_camera, outlines.solid)
    axes = candidate_axes(edges[first], edges[second])
    low_a, high_a = extents_along(outlines.vertices_camera[first], axes)
    low_b, high_b = extents_along(outlines.vertices_camera[second], axes)
    # The camera is at zero. A plane may be put anywhere between the two; the camera is on the side of the first if
    # it is nearer to it than the second is, or between them, in which case it is on either side as one likes.
    a_below, b_below = high_a <= low_b + TOUCHING_M, high_b <= low_a + TOUCHING_M
    first_is_safe = (a_below & (low_b >= 0)) | (b_below & (high_b <= 0))
    second_is_safe = (b_below & (low_a >= 0)) | (a_below & (high_a <= 0))
    separated: NDArray[np.bool_] = np.any(a_below | b_below, axis=1)
    return Order(
        first,
        second,
        first_can_hide=separated & ~np.any(second_is_safe, axis=1),
        second_can_hide=separated & ~np.any(first_is_safe, axis=1),
        intersecting=~separated,
    )


def edge_directions(vertices: Array, solid: Solid) -> Array:
    """Unit vectors along a shoebox's length, beam and height, shape (n, 3, 3).

    Args:
        vertices: Of n shoeboxes, shape (n, 8, 3).
        solid: The unit shoebox, which says which vertex is which.
    """
    corner = solid.vertices.min(axis=0)
    origin = int(np.flatnonzero((solid.vertices == corner).all(axis=1))[0])
    along = []
    for axis in range(3):
        other = corner.copy()
        other[axis] = solid.vertices[:, axis].max()
        end = int(np.flatnonzero((solid.vertices == other).all(axis=1))[0])
        along.append(vertices[:, end] - vertices[:, origin])
    directions = np.stack(along, axis=1)
    unit: Array = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return unit


def candidate_axes(edges_a: Array, edges_b: Array) -> Array:
    """Directions along which two boxes may be apart: three face normals each and nine cross products of edges.

    Args:
        edges_a: Unit edge directions, which are also the face normals of a box, shape (P, 3, 3).
        edges_b: Of the other, shape (P, 3, 3).

    Returns:
        Unit vectors, shape (P, 15, 3); zero where two edges are parallel.
    """
    crosses = np.cross(edges_a[:, :, None, :], edges_b[:, None, :, :]).reshape(-1, 9, 3)
    length = np.linalg.norm(crosses, axis=-1, keepdims=True)
    crosses = np.where(length > 1e-6, crosses / np.where(length > 1e-6, length, 1.0), 0.0)
    return np.concatenate([edges_a, edges_b, crosses], axis=1)


def extents_along(vertices: Array, axes: Array) -> tuple[Array, Array]:
    """Least and greatest coordinate of vertices along axes; an axis of length zero gives (−1, 1).

    Args:
        vertices: Shape (P, K, 3).
        axes: Shape (P, A, 3).

    Returns:
        Two arrays of shape (P, A). (−1, 1) for both solids overlaps, so such an axis never separates.
    """
    along = axes @ np.swapaxes(vertices, 1, 2)
    none = ~axes.any(axis=-1)
    return np.where(none, -1.0, along.min(axis=-1)), np.where(none, 1.0, along.max(axis=-1))
