"""Triangles cut by a half-space, in any number of dimensions (Sutherland & Hodgman, 1974)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array, Indices

HalfSpace = tuple[Array, float]
"""A normal n, shape (D,), and an offset d: inside is n · p >= d."""


def cut(triangles: Array, half_spaces: Sequence[HalfSpace]) -> tuple[Array, Indices]:
    """The parts of triangles, shape (T, 3, D), inside all half-spaces, in order, with the triangle of each."""
    source = np.arange(len(triangles))
    for normal, offset in half_spaces:
        height = triangles @ normal - offset
        if not (height >= 0).all():
            triangles, of = _cut(triangles, height)
            source = source[of]
    return triangles, source


def _cut(triangles: Array, height: Array) -> tuple[Array, Indices]:
    """The parts of triangles (T, 3, D) where their corners' heights (T, 3), a linear function, are not negative."""
    inside = height >= 0
    corners_inside = inside.sum(axis=1)
    whole = np.flatnonzero(corners_inside == 3)
    parts, sources = [triangles[whole]], [whole]
    for count in (1, 2):
        rows = np.flatnonzero(corners_inside == count)
        # First comes the corner that is alone on its side.
        alone = inside[rows].argmax(axis=1) if count == 1 else inside[rows].argmin(axis=1)
        turn = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(triangles[rows], turn[..., None], axis=1), 1, 0)
        at_a, at_b, at_c = np.take_along_axis(height[rows], turn, axis=1).T[..., None]
        if count == 1:
            pieces = [(a, _crossing(a, at_a, b, at_b), _crossing(a, at_a, c, at_c))]
        else:
            to_b, to_c = _crossing(b, at_b, a, at_a), _crossing(c, at_c, a, at_a)
            pieces = [(to_b, b, c), (to_b, c, to_c)]
        parts += [np.stack(piece, axis=1) for piece in pieces]
        sources += [rows] * len(pieces)
    source = np.concatenate(sources)
    order = np.argsort(source, kind="stable")
    return np.concatenate(parts)[order], source[order]


def _crossing(inner: Array, at_inner: Array, outer: Array, at_outer: Array) -> Array:
    """Where edges leave the half-space, from the inner corner on: the same point for both triangles at an edge."""
    point: Array = inner + (outer - inner) * (at_inner / (at_inner - at_outer))
    return point
