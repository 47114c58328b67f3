"""Separating axes of convex solids: the directions across which a plane between two of them may lie.

Two disjoint convex polyhedra always have a plane between them that is parallel to a face of one, or to an edge of each.
Its normal is then a face normal or the cross product of two edges (Gottschalk, Lin & Manocha (1996), "OBBTree: A
hierarchical structure for rapid interference detection", for boxes). Two shoeboxes have 3 + 3 + 9 such directions.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.vessels.vessel import Solid, once_a_solid

PARALLEL = 1 - 1e-9
"""Unit vectors with a greater dot product count as parallel."""


def candidate_axes(vertices_a: Array, a: Solid, vertices_b: Array, b: Solid) -> Array:
    """Directions across which convex solids may be apart: face normals of each, cross products of their edges.

    Args:
        vertices_a: Vertices of P solids with the faces of `a`, shape (P, K, 3).
        a: Has these faces.
        vertices_b: Vertices of the P solids with the faces of `b` that they are compared with, shape (P, L, 3).
        b: Has these faces.

    Returns:
        Unit vectors, shape (P, A, 3); zero where two edges are parallel.
    """
    (normals_a, edges_a), (normals_b, edges_b) = _directions(vertices_a, a), _directions(vertices_b, b)
    crosses = np.cross(edges_a[:, :, None, :], edges_b[:, None, :, :]).reshape(len(edges_a), -1, 3)
    length = np.linalg.norm(crosses, axis=-1, keepdims=True)
    crosses = np.where(length > 1e-6, crosses / np.where(length > 1e-6, length, 1.0), 0.0)
    return np.concatenate([normals_a, normals_b, crosses], axis=1)


def axis_count(a: Solid, b: Solid) -> int:
    """Number A of candidate axes of two solids."""
    (normals_a, edges_a), (normals_b, edges_b) = _distinct_directions(a), _distinct_directions(b)
    return len(normals_a) + len(normals_b) + len(edges_a) * len(edges_b)


def _directions(vertices: Array, solid: Solid) -> tuple[Array, Array]:
    """Distinct normals (n, N, 3) and edge directions (n, E, 3) of n solids with vertices (n, K, 3)."""
    faces, ends = _distinct_directions(solid)
    a, b, c = np.moveaxis(vertices[:, faces], 2, 0)
    return _unit(np.cross(b - a, c - a)), _unit(vertices[:, ends[:, 1]] - vertices[:, ends[:, 0]])


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


@once_a_solid
def _distinct_directions(solid: Solid) -> tuple[Indices, Indices]:
    """Faces (N, 3) and edges (E, 2) of which no two are parallel, without edges between triangles of one flat side.

    Stretching and turning a solid keeps parallel lines parallel, so the solid's own vertices decide for all copies.
    """
    corners = solid.vertices[solid.faces]
    normals = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    faces_at: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(solid.faces.tolist()):
        for start, end in ((a, b), (b, c), (c, a)):
            faces_at.setdefault((min(start, end), max(start, end)), []).append(face)
    sharp = [
        edge for edge, (one, *other) in faces_at.items() if not other or normals[one] @ normals[other[0]] < PARALLEL
    ]
    ends = np.array(sharp, dtype=np.int64)
    along = _unit(solid.vertices[ends[:, 1]] - solid.vertices[ends[:, 0]])
    return solid.faces[_not_parallel(normals)], ends[_not_parallel(along)]


def _not_parallel(unit: Array) -> list[int]:
    """The first of each set of parallel unit vectors (k, 3)."""
    chosen: list[int] = []
    for i, vector in enumerate(unit):
        if all(abs(vector @ unit[j]) < PARALLEL for j in chosen):
            chosen.append(i)
    return chosen


def extents_along(vertices: Array, axes: Array) -> tuple[Array, Array]:
    """Least and greatest coordinates of vertices (P, K, 3) along axes (P, A, 3), two arrays of shape (P, A).

    An axis of zero length gives −1 and 1 for every solid, so it separates none.
    """
    along = axes @ np.swapaxes(vertices, 1, 2)
    none = ~axes.any(axis=-1)
    return np.where(none, -1.0, along.min(axis=-1)), np.where(none, 1.0, along.max(axis=-1))


def widest_gap_axis(vertices_a: Array, vertices_b: Array) -> Array:
    """The unit vector across the widest gap between the hulls of vertices (K, 3) and (L, 3); zero if there is none.

    It solves a linear program: the candidate axes of two hulls of many faces are too many to try.
    """
    from scipy.optimize import linprog  # slow to import, and few scenes need it

    centre = (vertices_a.mean(axis=0) + vertices_b.mean(axis=0)) / 2
    # Along the axis n, a is at most c − t and b at least c + t; t is to be as large as |n1|, |n2|, |n3| ≤ 1 allow.
    a, b = (np.pad(vertices - centre, ((0, 0), (0, 2)), constant_values=1.0) for vertices in (vertices_a, vertices_b))
    rows = np.concatenate([a * (1, 1, 1, -1, 1), b * (-1, -1, -1, 1, 1)])
    bounds = [(-1, 1)] * 3 + [(None, None)] * 2
    found = linprog([0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds, method="highs-ds")
    axis = np.zeros(3) if found.x is None else found.x[:3]
    return _unit(axis) if axis.any() else axis


@once_a_solid
def hull_vertices(solid: Solid) -> Indices:
    """The vertices of a solid that its convex hull has, ascending, shape (k,); all of them if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError  # takes 0.1 s

    try:
        chosen: Indices = np.sort(ConvexHull(solid.vertices).vertices).astype(np.int64)
        return chosen
    except QhullError:
        return np.arange(len(solid.vertices))
