"""Which of two disjoint convex solids is in front, from a plane between them.

If a plane has one solid on the camera's side and the other beyond, no ray from the camera can meet the far one first:
behind the plane it never comes back. The distance of the centres decides nothing: a long ship's centre may be nearer
than that of a boat that lies in front of its stern.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from modsim3d.annotate.outlines import Outlines
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.vessels import Solid

TOUCHING_M = 1e-7
"""Solids that overlap by less are taken to touch: rounding must not turn neighbours at a quay into a collision."""

MOST_COORDINATES = 4_000_000
"""Vertices of pairs of solids along axes that are worked out at a time; it bounds the memory."""


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
    first_can_hide: Mask
    second_can_hide: Mask
    intersecting: Mask


def overlapping_pairs(frame: Indices, boxes_px: Array, some_of: Mask | None = None) -> tuple[Indices, Indices]:
    """Pairs of rows of the same frame whose boxes overlap.

    Args:
        frame: Non-decreasing, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        some_of: Rows of which one must be in a pair, shape (n,); any pair unless given.

    Returns:
        First and second rows, each of shape (P,), first < second.
    """
    edges = [*np.flatnonzero(np.diff(frame, prepend=-1)).tolist(), len(frame)]
    firsts, seconds = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for start, stop in pairwise(edges):
        boxes = boxes_px[start:stop]
        rows = np.arange(stop - start) if some_of is None else np.flatnonzero(some_of[start:stop])
        low, high = boxes[rows, None, :2], boxes[rows, None, 2:]
        over = ((low < boxes[None, :, 2:]) & (boxes[None, :, :2] < high)).all(axis=2)
        once = np.ones(stop - start, dtype=bool)
        once[rows] = False  # a pair of two such rows is found from both
        row, other = np.nonzero(over & (once | (np.arange(stop - start) > rows[:, None])))
        row = rows[row]
        order = np.lexsort((np.maximum(row, other), np.minimum(row, other)))
        firsts.append(np.minimum(row, other)[order] + start)
        seconds.append(np.maximum(row, other)[order] + start)
    return np.concatenate(firsts), np.concatenate(seconds)


def order_of(outlines: Outlines) -> Order:
    """Look for a plane between every two solids whose boxes overlap in the image.

    Two disjoint convex polyhedra are separated along a face normal of one of them or the cross product of an edge of
    each (Gottschalk, Lin & Manocha (1996), "OBBTree", for boxes).

    What hides no vessel is left out: of a long coast, all but a few pieces.

    Args:
        outlines: Of convex solids.
    """
    return order_of_pairs(outlines, *_pairs_that_matter(outlines))


def order_of_pairs(outlines: Outlines, first: Indices, second: Indices) -> Order:
    """The same for some pairs of rows.

    Args:
        outlines: Of convex solids.
        first: Rows, shape (P,).
        second: Rows of the same frames, shape (P,).
    """
    can_hide = np.zeros((len(first), 2), dtype=bool)
    separated = np.zeros(len(first), dtype=bool)
    part_of, member_of = _places(outlines)
    kinds = part_of[first] * len(outlines.parts) + part_of[second]
    for kind in np.unique(kinds):
        a, b = (outlines.parts[part] for part in divmod(int(kind), len(outlines.parts)))
        for chosen in _in_turns(np.flatnonzero(kinds == kind), a.solid, b.solid):
            vertices_a = a.vertices_camera[member_of[first[chosen]]]
            vertices_b = b.vertices_camera[member_of[second[chosen]]]
            directions_a, directions_b = directions_of(vertices_a, a.solid), directions_of(vertices_b, b.solid)
            axes = candidate_axes(directions_a, directions_b)
            can_hide[chosen], separated[chosen] = _who_can_hide(vertices_a, vertices_b, axes)
    return Order(first, second, can_hide[:, 0], can_hide[:, 1], intersecting=~separated)


def _pairs_that_matter(outlines: Outlines) -> tuple[Indices, Indices]:
    """Pairs of rows that overlap in the image, of vessels and of what overlaps a vessel there; see `Order`.

    Pieces of one obstacle are no pair: it does not matter which of them hides a vessel.
    """
    with_vessel = np.concatenate(overlapping_pairs(outlines.frame, outlines.boxes_px, outlines.boxed))
    kept = np.union1d(np.flatnonzero(outlines.boxed), with_vessel)
    first, second = overlapping_pairs(outlines.frame[kept], outlines.boxes_px[kept])
    others = outlines.occluder[kept[first]] != outlines.occluder[kept[second]]
    return kept[first[others]], kept[second[others]]


def _in_turns(pairs: Indices, a: Solid, b: Solid) -> list[Indices]:
    """Pairs of two kinds of solid in turns whose axes and coordinates along them fit into memory."""
    (normals_a, edges_a), (normals_b, edges_b) = distinct_directions(a), distinct_directions(b)
    axes = len(normals_a) + len(normals_b) + len(edges_a) * len(edges_b)
    most = max(1, MOST_COORDINATES // (axes * (len(a.vertices) + len(b.vertices))))
    return np.array_split(pairs, -(-len(pairs) // most))


def _places(outlines: Outlines) -> tuple[Indices, Indices]:
    """The part that each row belongs to, and its place there; both of shape (n,)."""
    part_of, member_of = np.zeros((2, len(outlines)), dtype=np.int64)
    for index, part in enumerate(outlines.parts):
        part_of[part.rows] = index
        member_of[part.rows] = np.arange(len(part.rows))
    return part_of, member_of


def _who_can_hide(vertices_a: Array, vertices_b: Array, axes: Array) -> tuple[Mask, Mask]:
    """Whether the first can hide the second and the second the first, shape (P, 2); whether a plane separates them."""
    low_a, high_a = extents_along(vertices_a, axes)
    low_b, high_b = extents_along(vertices_b, axes)
    # The camera is at zero. A plane may be put anywhere between the two; the camera is on the side of the first if
    # it is nearer to it than the second is, or between them, in which case it is on either side as one likes.
    a_below, b_below = high_a <= low_b + TOUCHING_M, high_b <= low_a + TOUCHING_M
    first_is_safe = (a_below & (low_b >= 0)) | (b_below & (high_b <= 0))
    second_is_safe = (b_below & (low_a >= 0)) | (a_below & (high_a <= 0))
    separated: Mask = np.any(a_below | b_below, axis=1)
    safe = np.stack([np.any(second_is_safe, axis=1), np.any(first_is_safe, axis=1)], axis=1)
    return separated[:, None] & ~safe, separated


@dataclass(frozen=True, eq=False)
class Directions:
    """Unit vectors of n convex solids with the same faces.

    Attributes:
        normals: Of faces that are not parallel, shape (n, N, 3).
        edges: Along edges that are not parallel, shape (n, E, 3).
    """

    normals: Array
    edges: Array


def directions_of(vertices: Array, solid: Solid) -> Directions:
    """Face normals and edge directions of convex solids.

    Args:
        vertices: Of n of them, shape (n, K, 3).
        solid: Their faces.
    """
    faces, ends = distinct_directions(solid)
    a, b, c = np.moveaxis(vertices[:, faces], 2, 0)
    return Directions(_unit(np.cross(b - a, c - a)), _unit(vertices[:, ends[:, 1]] - vertices[:, ends[:, 0]]))


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


@cache
def distinct_directions(solid: Solid) -> tuple[Indices, Indices]:
    """Faces with normals, and edges with directions, of which no two are parallel; diagonals of flat sides are none.

    Which are parallel is a matter of the solid's own vertices: a stretched or turned copy has the same.

    Returns:
        Vertex indices, shapes (N, 3) and (E, 2).
    """
    corners = solid.vertices[solid.faces]
    normals = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    beside: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(solid.faces.tolist()):
        for start, end in ((a, b), (b, c), (c, a)):
            beside.setdefault((min(start, end), max(start, end)), []).append(face)
    sharp = [edge for edge, (one, *other) in beside.items() if not other or normals[one] @ normals[other[0]] < 1 - 1e-9]
    ends = np.array(sharp, dtype=np.int64)
    along = _unit(solid.vertices[ends[:, 1]] - solid.vertices[ends[:, 0]])
    return solid.faces[_not_parallel(normals)], ends[_not_parallel(along)]


def _not_parallel(unit: Array) -> list[int]:
    """The first of each set of parallel unit vectors."""
    chosen: list[int] = []
    for i, vector in enumerate(unit):
        if all(abs(vector @ unit[j]) < 1 - 1e-9 for j in chosen):
            chosen.append(i)
    return chosen


def candidate_axes(a: Directions, b: Directions) -> Array:
    """Directions along which two convex solids may be apart: face normals of each, cross products of their edges.

    Args:
        a: Of P solids.
        b: Of the others.

    Returns:
        Unit vectors, shape (P, A, 3); zero where two edges are parallel.
    """
    crosses = np.cross(a.edges[:, :, None, :], b.edges[:, None, :, :]).reshape(len(a.edges), -1, 3)
    length = np.linalg.norm(crosses, axis=-1, keepdims=True)
    crosses = np.where(length > 1e-6, crosses / np.where(length > 1e-6, length, 1.0), 0.0)
    return np.concatenate([a.normals, b.normals, crosses], axis=1)


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
