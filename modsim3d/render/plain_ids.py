"""ID buffers without OpenGL: slow and obvious, for pictures where there is no renderer."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array
from modsim3d.render.id_pass import Ids, Region


class AnyIdRenderer(Protocol):
    """Renderer of ID buffers: `IdRenderer` by OpenGL, or `PlainIds` without it."""

    def draw(self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], region: Region) -> Ids:
        """The ID at each pixel of a region, shape (height, width); zero where nothing is. See `IdRenderer.draw`."""


class PlainIds:
    """Draws triangle by triangle with a depth buffer, in NumPy.

    A pixel whose centre is exactly on an edge belongs to the triangles on both sides; OpenGL gives it to one of them.
    """

    def draw(self, corners_px: Array, inverse_depth: Array, ids: NDArray[np.integer], region: Region) -> Ids:
        """The ID at each pixel of a region, shape (height, width); zero where nothing is. See `IdRenderer.draw`."""
        out = np.zeros((region.height, region.width), dtype=np.uint32)
        depth = np.zeros(out.shape)
        corners = corners_px - (region.x, region.y)
        low = np.clip(np.floor(corners.min(axis=1, initial=np.inf)), 0, (region.width, region.height)).astype(int)
        high = np.clip(np.ceil(corners.max(axis=1, initial=-np.inf)), 0, (region.width, region.height)).astype(int)
        for i in np.flatnonzero((high > low).all(axis=1)).tolist():
            (x0, y0), (x1, y1) = low[i], high[i]
            here = np.s_[y0:y1, x0:x1]
            centres = np.arange(x0, x1) + 0.5, np.arange(y0, y1)[:, None] + 0.5
            weights = _barycentric(corners[i], *centres)
            if weights is None:
                continue
            inverse = sum(w * d for w, d in zip(weights, inverse_depth[i], strict=True))
            front = (np.minimum.reduce(weights) >= 0) & (inverse > depth[here])
            out[here][front] = ids[i]
            depth[here][front] = inverse[front]
        return out


def _barycentric(triangle: Array, x: Array, y: Array) -> tuple[Array, Array, Array] | None:
    """Barycentric coordinates of points in a triangle (3, 2); None if the triangle is seen edge-on."""
    (ax, ay), (bx, by), (cx, cy) = triangle
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if doubled == 0:
        return None
    first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / doubled
    second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / doubled
    return first, second, 1 - first - second
