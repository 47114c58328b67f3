"""Triangles cut into small ones, so that a lens can be applied to their corners alone."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.camera import Intrinsics


def subdivided(triangles_camera: Array, intrinsics: Intrinsics, longest_px: float) -> Array:
    """The same surface as triangles whose edges are short in the image.

    Whether an edge is halved depends on its own length only. Both triangles at an edge are therefore cut alike, and no
    gap opens between them.

    Args:
        triangles_camera: Triangles in front of the near plane, in CCF, shape (T, 3, 3).
        intrinsics: Intrinsics of a pinhole camera.
        longest_px: Greatest length of an edge in its image.

    Returns:
        Triangles in CCF with the orientation of the given ones, shape (T', 3, 3).
    """
    waiting, done = triangles_camera, [triangles_camera[:0]]
    while len(waiting):
        pixels = intrinsics.project(np.maximum(waiting, (-np.inf, -np.inf, intrinsics.near_clip_m)))
        # Edge i runs from corner i to corner i + 1.
        long = np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1) > longest_px
        count = long.sum(axis=1)
        done.append(waiting[count == 0])
        waiting = np.concatenate([_cut(waiting[count == k], long[count == k], k) for k in (1, 2, 3)])
    return np.concatenate(done)


def _cut(triangles: Array, long: Array, count: int) -> Array:
    """Triangles with `count` long edges each, cut at the middles of these edges."""
    # Turn each so that its edge 0 is the one long edge, or its edge 2 the one short edge.
    first = np.zeros(len(long), dtype=np.int64)
    if count == 1:
        first = long.argmax(axis=1)
    elif count == 2:
        first = (long.argmin(axis=1) + 1) % 3
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, turn[:, :, None], axis=1), 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = {
        1: ((a, ab, c), (ab, b, c)),
        2: ((ab, b, bc), (a, ab, bc), (a, bc, c)),
        3: ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)),
    }[count]
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])
