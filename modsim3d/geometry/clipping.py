"""Half-spaces that bound what a camera shows, and triangles cut by them."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Intrinsics


def near_plane(intrinsics: Intrinsics) -> Array:
    """The half-space c3 >= near_clip_m as rows (n, d) with n · p >= d, shape (1, 4)."""
    return np.array([[0.0, 0.0, 1.0, intrinsics.near_clip_m]])


def guard_planes(intrinsics: Intrinsics, guard_px: float) -> Array:
    """The half-spaces that project to the image and a band of `guard_px` around it, shape (4, 4).

    Each row is (n, d) with n · p >= d. The left one, x >= −guard, is (f1, s, a1 + guard) · p >= 0 in camera
    coordinates; the others follow alike.
    """
    matrix, (width, height) = intrinsics.matrix, intrinsics.image_size_px
    depth = matrix[2]
    normals = [
        matrix[0] + guard_px * depth,
        (width + guard_px) * depth - matrix[0],
        matrix[1] + guard_px * depth,
        (height + guard_px) * depth - matrix[1],
    ]
    return np.column_stack([np.array(normals), np.zeros(4)])


def clip_triangles(triangles_camera: Array, half_spaces: Array) -> Array:
    """The parts of triangles that lie inside half-spaces, as triangles (Sutherland & Hodgman, 1974).

    Triangles are in CCF, shape (T, 3, 3) to (T', 3, 3), and keep their order and orientation. A half-space is a row
    (n, d), shape (P, 4): inside is n · p >= d.
    """
    kept = triangles_camera
    for plane in half_spaces:
        kept = _clip_by(kept, kept @ plane[:3] - plane[3])
    return kept


def _clip_by(triangles: Array, height: Array) -> Array:
    """The parts of triangles (T, 3, 3) where a linear function, `height` (T, 3) at the corners, is not negative."""
    inside = height >= 0
    if inside.all():
        return triangles
    count = inside.sum(axis=1)
    # Turn each triangle so that its odd corner, the one inside or the one outside, comes first.
    odd = np.where(count == 1, inside.argmax(axis=1), inside.argmin(axis=1))
    turn = (odd[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, turn[:, :, None], axis=1)
    heights = np.take_along_axis(height, turn, axis=1)
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    ends = _crossing(corners, heights, one, 0, 1), _crossing(corners, heights, one, 0, 2)
    tip = np.stack([corners[one, 0], *ends], axis=1)
    first, last = _crossing(corners, heights, two, 1, 0), _crossing(corners, heights, two, 2, 0)
    near = np.stack([first, corners[two, 1], corners[two, 2]], axis=1)
    far = np.stack([first, corners[two, 2], last], axis=1)
    whole = np.flatnonzero(count == 3)
    source = np.concatenate([whole, one, two, two])
    parts = np.concatenate([triangles[whole], tip, near, far])
    return parts[np.argsort(source, kind="stable")]


def _crossing(corners: Array, heights: Array, rows: Indices, inner: int, outer: int) -> Array:
    """Points where edges leave the half-space, shape (k, 3).

    Computed from the inner corner, so that two triangles with a common edge get exactly the same point.
    """
    a, b = corners[rows, inner], corners[rows, outer]
    height_a, height_b = heights[rows, inner, None], heights[rows, outer, None]
    crossing: Array = a + height_a / (height_a - height_b) * (b - a)
    return crossing
