"""Separating axes of convex solids: the directions across which a plane between two of them may lie.

Two disjoint convex polyhedra always have a plane between them that is parallel to a face of one, or to an edge of each.
Its normal is then a face normal or the cross product of two edges (Gottschalk, Lin & Manocha (1996), "OBBTree: A
hierarchical structure for rapid interference detection", for boxes). Two shoeboxes have 3 + 3 + 9 such directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.vessels.vessel import Solid

PARALLEL = 1 - 1e-9
"""Unit vectors with a greater dot product count as parallel."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Unit vectors of n convex solids with the same faces.

    Attributes:
        normals: Normals of faces that are not parallel, shape (n, N, 3).
        edges: Directions of edges that are not parallel, shape (n, E, 3).
    """

    normals: Array
    edges: Array


def directions_of(vertices: Array, solid: Solid) -> Directions:
    """Face normals and edge directions of convex solids.

    Args:
        vertices: Vertices of n solids, shape (n, K, 3).
        solid: Has their faces.
    """
    faces, ends = distinct_directions(solid)
    a, b, c = np.moveaxis(vertices[:, faces], 2, 0)
    return Directions(_unit(np.cross(b - a, c - a)), _unit(vertices[:, ends[:, 1]] - vertices[:, ends[:, 0]]))


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


@cache
def distinct_directions(solid: Solid) -> tuple[Indices, Indices]:
    """Faces and edges of a solid of which no two are parallel, without edges between triangles of one flat side.

    Stretching and turning a solid keeps parallel lines parallel, so the solid's own vertices decide for all copies.

    Returns:
        Vertex indices of N faces, shape (N, 3), and of E edges, shape (E, 2).
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


def candidate_axes(a: Directions, b: Directions) -> Array:
    """Directions across which two convex solids may be apart: face normals of each, cross products of their edges.

    Args:
        a: Directions of P solids.
        b: Directions of the P solids that each of them is compared with.

    Returns:
        Unit vectors, shape (P, A, 3); zero where two edges are parallel.
    """
    crosses = np.cross(a.edges[:, :, None, :], b.edges[:, None, :, :]).reshape(len(a.edges), -1, 3)
    length = np.linalg.norm(crosses, axis=-1, keepdims=True)
    crosses = np.where(length > 1e-6, crosses / np.where(length > 1e-6, length, 1.0), 0.0)
    return np.concatenate([a.normals, b.normals, crosses], axis=1)


def axis_count(a: Solid, b: Solid) -> int:
    """Number A of candidate axes of two solids."""
    (normals_a, edges_a), (normals_b, edges_b) = distinct_directions(a), distinct_directions(b)
    return len(normals_a) + len(normals_b) + len(edges_a) * len(edges_b)


def extents_along(vertices: Array, axes: Array) -> tuple[Array, Array]:
    """Least and greatest coordinate of vertices along axes.

    Args:
        vertices: Shape (P, K, 3).
        axes: Unit vectors or zero vectors, shape (P, A, 3).

    Returns:
        Two arrays of shape (P, A). An axis of zero length gives (−1, 1) for every solid, so it separates none.
    """
    along = axes @ np.swapaxes(vertices, 1, 2)
    none = ~axes.any(axis=-1)
    return np.where(none, -1.0, along.min(axis=-1)), np.where(none, 1.0, along.max(axis=-1))
