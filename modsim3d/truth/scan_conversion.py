"""Exact scan conversion: the pixels that OpenGL would fill for convex solids, found without drawing them.

OpenGL rounds corners to a grid of 1/256 pixel and fills each pixel whose centre is inside. On that grid, corners and
pixel centres are whole numbers. A pixel centre is at 256 y + 128, and an edge from (x0, y0) to (x1, y1) crosses the
scan line through it at

    x = x0 + (256 y + 128 − y0) (x1 − x0) / (y1 − y0),

so the first pixel centre at or to the right of the edge follows from one division of whole numbers. They are below
2^53, so doubles hold them exactly. A quotient that is no whole number differs from the next by 1 / (256 (y1 − y0)) or
more, which is far more than doubles round off, so rounding it up is exact too. The outline of a convex solid crosses
each scan line twice: a left edge begins the span of pixels, a right edge ends it.

A centre exactly on an edge belongs to the side that OpenGL's fill rule gives it to: left and upper edges are inside,
right and lower edges are not (OpenGL 4.5 core specification, section 14.6.1, leaves the side open but demands that a
common edge of two triangles fills each pixel once; Mesa uses this one). tests/test_regions_against_full.py compares
the result with drawn buffers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, ranges
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.truth.pixel_spans import Spans
from modsim3d.truth.silhouettes import doubled_areas
from modsim3d.vessels.vessel import Solid

HALF = SUBPIXELS // 2


@cache
def _edges_of(solid: Solid) -> Indices:
    """Start, end, left and right of each edge of a closed solid, shape (4, E).

    The face on the left is the one that runs from start to end; the face on the right runs from end to start.
    """
    faces = {
        (a, b): face
        for face, corners in enumerate(solid.faces.tolist())
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    }
    pairs = [(a, b, face, faces[b, a]) for (a, b), face in faces.items() if a < b]
    return np.array(pairs, dtype=np.int64).T


def facing(corners_px: Array) -> Indices:
    """Whether triangles with rounded corners are turned to the camera (> 0), away from it (< 0), or have no area.

    They are in buffer pixels, counter-clockwise seen from outside. Shape (..., 3, 2) to (...).
    """
    return doubled_areas(_on_grid(corners_px))


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of outlines, ordered by silhouette, that all bound their silhouettes on the same side.

    Attributes:
        row: Silhouette of each edge, shape (e,).
        upper: Upper end on the grid, shape (e, 2).
        lower: Lower end, shape (e, 2).
    """

    row: Indices
    upper: Array
    lower: Array

    def crossings(self, image_size_px: tuple[int, int]) -> tuple[Indices, Indices, Indices]:
        """Silhouette, scan line, and first column at or to the right of the edge, for each line that an edge crosses.

        All have shape (c,). Columns and lines are within the image.
        """
        width, height = image_size_px
        # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
        first, stop = (
            np.clip(np.ceil((end[:, 1] - HALF) / SUBPIXELS), 0, height).astype(np.int64)
            for end in (self.upper, self.lower)
        )
        (x, y), (dx, dy) = self.upper.T, (self.lower - self.upper).T
        line = ranges(first, stop - first)
        # 256 dy times the crossing, counted from the centre of column 0, at line 0 and from one line to the next.
        at_zero, step, scale = (
            np.repeat(values, stop - first)
            for values in ((HALF - y) * dx + (x - HALF) * dy, SUBPIXELS * dx, SUBPIXELS * dy)
        )
        column = np.clip(np.ceil((at_zero + step * line) / scale), 0, width).astype(np.int64)
        return np.repeat(self.row, stop - first), line, column


def scan_convert(vertices_px: Array, solid: Solid, image_size_px: tuple[int, int]) -> tuple[Spans, Indices]:
    """The spans of n convex solids inside an image.

    Args:
        vertices_px: Projected vertices, all in front of the near plane, in buffer pixels, shape (n, K, 2).
        solid: Has the faces that the vertices span.
        image_size_px: Width and height of the buffer.

    Returns:
        The spans; and the silhouettes, shape (k,), that have to be drawn instead, because their rounded corners make no
        convex outline.
    """
    left, right = (edges.crossings(image_size_px) for edges in _outline_edges(vertices_px, solid))
    return _join(left, right, len(vertices_px), image_size_px[1])


def _on_grid(points_px: Array) -> Array:
    """Points in units of 1/256 px, rounded to whole numbers, same shape."""
    return np.rint(points_px * SUBPIXELS)


def _outline_edges(vertices_px: Array, solid: Solid) -> tuple[_Edges, _Edges]:
    """The edges between a face turned to the camera and one turned away: those on the left, and those on the right."""
    (start, end, left, right), grid = _edges_of(solid), _on_grid(vertices_px)
    # A face seen edge-on is taken to be turned away: the outline then runs around it.
    towards = facing(vertices_px[:, solid.faces]) > 0
    row, edge = np.nonzero(towards[:, left] != towards[:, right])
    # Walked with the face that is turned to the camera on the left, an edge that runs down is a left edge.
    forward = towards[row, left[edge]]
    tail, head = (grid[row, np.where(forward, one[edge], other[edge])] for one, other in ((start, end), (end, start)))
    down, up = head[:, 1] > tail[:, 1], head[:, 1] < tail[:, 1]
    return _Edges(row[down], tail[down], head[down]), _Edges(row[up], head[up], tail[up])


def _join(
    left: tuple[Indices, Indices, Indices], right: tuple[Indices, Indices, Indices], count: int, height: int
) -> tuple[Spans, Indices]:
    """Spans from the left to the right crossing of each scan line; and silhouettes with other numbers of crossings.

    Args:
        left: Silhouette, scan line and column of each crossing with a left edge.
        right: The same of right edges.
        count: Number of silhouettes.
        height: That of the image.
    """
    # Each scan line from the first to the last of a silhouette has a place of its own.
    rows, lines = np.concatenate([left[0], right[0]]), np.concatenate([left[1], right[1]])
    top, bottom = np.full(count, height), np.zeros(count, dtype=np.int64)
    np.minimum.at(top, rows, lines)
    np.maximum.at(bottom, rows, lines + 1)
    heights = np.maximum(bottom - top, 0)
    base = np.cumsum(heights) - heights - top
    row, y = np.repeat(np.arange(count), heights), ranges(top, heights)
    columns, crossings = np.empty((2, len(row)), dtype=np.int64), np.empty((2, len(row)), dtype=np.int64)
    for side, (of_row, line, column) in enumerate((left, right)):
        place = base[of_row] + line
        columns[side, place] = column
        crossings[side] = np.bincount(place, minlength=len(row))
    wrong = (crossings[0] != crossings[1]) | (crossings[0] > 1)
    odd = np.unique(row[wrong])
    filled = (crossings[0] == 1) & (columns[0] < columns[1])
    filled[np.isin(row, odd)] = False
    return Spans(row[filled], y[filled], columns[0, filled], columns[1, filled]), odd
