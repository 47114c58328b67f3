"""Half-spaces that bound what a camera shows, and triangles cut by them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from modsim3d.core.arrays import Array, Indices, read_only
from modsim3d.geometry.camera import Intrinsics


def near_plane(intrinsics: Intrinsics) -> Array:
    """The half-space c3 >= near_clip_m as rows (n, d) with n · p >= d, shape (1, 4)."""
    return np.array([[0.0, 0.0, 1.0, intrinsics.near_clip_m]])


@lru_cache(maxsize=64)
def guard_planes(intrinsics: Intrinsics, guard_px: float) -> Array:
    """The half-spaces that project to the image and a band of `guard_px` around it, shape (4, 4).

    Each row is (n, d) with n · p >= d, read-only. The left one, x >= −guard, is (f1, s, a1 + guard) · p >= 0 in camera
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
    return read_only(np.column_stack([np.array(normals), np.zeros(4)]))


def clip_triangles(triangles_camera: Array, half_spaces: Array) -> tuple[Array, Indices]:
    """The parts of triangles that lie inside half-spaces, as triangles (Sutherland & Hodgman, 1974).

    Args:
        triangles_camera: In CCF, shape (T, 3, 3).
        half_spaces: Rows (n, d), shape (P, 4): inside is n · p >= d.

    Returns:
        The parts, in the order and with the orientation of the triangles, shape (T', 3, 3); the triangle that each is a
        part of, shape (T',).
    """
    kept, source = triangles_camera, np.arange(len(triangles_camera))
    for plane in half_spaces:
        height = kept @ plane[:3] - plane[3]
        if not (height >= 0).all():
            kept, cut = _clip_by(kept, height)
            source = source[cut]
    return kept, source


def _clip_by(triangles: Array, height: Array) -> tuple[Array, Indices]:
    """The parts of triangles (T, 3, 3) where a linear function, `height` (T, 3) at the corners, is not negative.

    With the parts comes the triangle of each.
    """
    inside = height >= 0
    count = inside.sum(axis=1)
    whole, one, two = (np.flatnonzero(count == k) for k in (3, 1, 2))
    # Turned so that the odd corner, the one inside or the one outside, comes first.
    corners, heights = _turned(triangles, height, one, inside[one].argmax(axis=1))
    tip = np.stack([corners[0], _crossing(corners, heights, 0, 1), _crossing(corners, heights, 0, 2)], axis=1)
    corners, heights = _turned(triangles, height, two, inside[two].argmin(axis=1))
    first, last = _crossing(corners, heights, 1, 0), _crossing(corners, heights, 2, 0)
    near = np.stack([first, corners[1], corners[2]], axis=1)
    far = np.stack([first, corners[2], last], axis=1)
    source = np.concatenate([whole, one, two, two])
    order = np.argsort(source, kind="stable")
    return np.concatenate([triangles[whole], tip, near, far])[order], source[order]


def _turned(triangles: Array, height: Array, rows: Indices, first: Indices) -> tuple[list[Array], list[Array]]:
    """The corners of some triangles, three of shape (k, 3), and their heights, (k, 1), from the corner `first` on."""
    places = [(first + i) % 3 for i in range(3)]
    return [triangles[rows, place] for place in places], [height[rows, place][:, None] for place in places]


def _crossing(corners: list[Array], heights: list[Array], inner: int, outer: int) -> Array:
    """Points where edges leave the half-space, shape (k, 3).

    Computed from the inner corner, so that two triangles with a common edge get exactly the same point.
    """
    share = heights[inner] / (heights[inner] - heights[outer])
    return corners[inner] + share * (corners[outer] - corners[inner])
