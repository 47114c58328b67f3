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

from modsim3d.arrays import Array, Indices, ranges
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.truth.pixel_spans import Spans
from modsim3d.truth.silhouettes import doubled_areas, doubled_face_areas
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


def facing(corners_px: Array) -> Array:
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
        first: First scan line of the image that the edge crosses, shape (e,).
        lines: Number of scan lines that it crosses, shape (e,).
    """

    row: Indices
    upper: Array
    lower: Array
    first: Indices
    lines: Indices

    @classmethod
    def of(cls, row: Indices, upper: Array, lower: Array, height: int) -> _Edges:
        """Those edges that cross a scan line of an image of some height."""
        # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
        first, stop = (
            np.clip(np.ceil((end[:, 1] - HALF) / SUBPIXELS), 0, height).astype(np.int64) for end in (upper, lower)
        )
        some = first < stop
        return cls(row[some], upper[some], lower[some], first[some], (stop - first)[some])

    def columns(self, width: int) -> Indices:
        """First column at or to the right of each edge in each of its lines, one edge after another, shape (c,)."""
        (x, y), (dx, dy) = self.upper.T, (self.lower - self.upper).T
        # 256 dy times the crossing, counted from the centre of column 0, at line 0 and from one line to the next.
        at_zero, step, scale = (
            np.repeat(values, self.lines)
            for values in ((HALF - y) * dx + (x - HALF) * dy, SUBPIXELS * dx, SUBPIXELS * dy)
        )
        crossing = (at_zero + step * ranges(self.first, self.lines)) / scale
        columns: Indices = np.clip(np.ceil(crossing), 0, width).astype(np.int64)
        return columns


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
    (width, height), count = image_size_px, len(vertices_px)
    sides = _outline_edges(vertices_px, solid, height)
    # Each scan line from the first to the last of a silhouette has a place of its own.
    top, bottom = np.full(count, height), np.zeros(count, dtype=np.int64)
    for edges in sides:
        np.minimum.at(top, edges.row, edges.first)
        np.maximum.at(bottom, edges.row, edges.first + edges.lines)
    heights = np.maximum(bottom - top, 0)
    row, y = np.repeat(np.arange(count), heights), ranges(top, heights)
    to_place = np.cumsum(heights) - heights - top
    columns, crossings = [], []
    for edges in sides:
        place = ranges(to_place[edges.row] + edges.first, edges.lines)
        columns.append(np.zeros(len(row), dtype=np.int64))
        columns[-1][place] = edges.columns(width)
        crossings.append(np.bincount(place, minlength=len(row)))
    odd = np.unique(row[(crossings[0] != crossings[1]) | (crossings[0] > 1)])
    filled = (columns[0] < columns[1]) & (crossings[0] == 1)
    if len(odd):
        filled &= ~np.isin(row, odd)
    return Spans(row, y, *columns).take(filled), odd


def _on_grid(points_px: Array) -> Array:
    """Points in units of 1/256 px, rounded to whole numbers, same shape."""
    return np.rint(points_px * SUBPIXELS)


def _outline_edges(vertices_px: Array, solid: Solid, height: int) -> tuple[_Edges, _Edges]:
    """The edges between a face turned to the camera and one turned away: those on the left, and those on the right."""
    (start, end, left, right), grid = _edges_of(solid), _on_grid(vertices_px)
    # A face seen edge-on is taken to be turned away: the outline then runs around it.
    towards = doubled_face_areas(grid, solid.faces) > 0
    row, edge = np.nonzero(towards[:, left] != towards[:, right])
    # Walked with the face that is turned to the camera on the left, an edge that runs down is a left edge.
    forward = towards[row, left[edge]]
    tail = grid[row, np.where(forward, start[edge], end[edge])]
    head = grid[row, np.where(forward, end[edge], start[edge])]
    down, up = head[:, 1] > tail[:, 1], head[:, 1] < tail[:, 1]
    return _Edges.of(row[down], tail[down], head[down], height), _Edges.of(row[up], head[up], tail[up], height)
