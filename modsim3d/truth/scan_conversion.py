"""Exact scan conversion: the pixels that OpenGL would fill for convex solids, found without drawing them.

OpenGL rounds corners to a grid of 1/256 pixel and fills each pixel whose centre is inside. On that grid, corners and
pixel centres are whole numbers. A pixel centre is at 256 y + 128, and an edge from (x0, y0) to (x1, y1) crosses the
scan line through it at

    x = x0 + (256 y + 128 − y0) (x1 − x0) / (y1 − y0),

so the first pixel centre at or to the right of the edge follows from one integer division, without rounding errors.
The outline of a convex solid crosses each scan line twice: a left edge begins the span of pixels, a right edge ends it.

A centre exactly on an edge belongs to the side that OpenGL's fill rule gives it to: left and upper edges are inside,
right and lower edges are not (OpenGL 4.5 core specification, section 14.6.1, leaves the side open but demands that a
common edge of two triangles fills each pixel once; Mesa uses this one). tests/test_regions_against_full.py compares
the result with drawn buffers.
"""

from __future__ import annotations

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
    width, height = image_size_px
    row, upper, lower, is_start = _outline_edges(vertices_px, solid)
    # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
    first = np.clip(-((HALF - upper[:, 1]) // SUBPIXELS), 0, height)
    stop = np.clip(-((HALF - lower[:, 1]) // SUBPIXELS), 0, height)
    lines = stop - first
    which, y = np.repeat(np.arange(len(lines)), lines), ranges(first, lines)
    dx, dy = (lower - upper)[which].T
    # 256 dy times the crossing, counted from the centre of column 0; the quotient is rounded up.
    crossing = (SUBPIXELS * y + HALF - upper[which, 1]) * dx + (upper[which, 0] - HALF) * dy
    column = np.clip(-(-crossing // (SUBPIXELS * dy)), 0, width)
    return _join(row[which], y, column, is_start[which], height)


def _on_grid(points_px: Array) -> Indices:
    """Points rounded to multiples of 1/256 px, same shape."""
    return np.rint(points_px * SUBPIXELS).astype(np.int64)


def _outline_edges(vertices_px: Array, solid: Solid) -> tuple[Indices, Indices, Indices, Mask]:
    """The edges between a face turned to the camera and one turned away.

    Returns:
        Silhouette of each edge, shape (e,); its upper and lower end on the grid, both of shape (e, 2); whether it
        bounds the silhouette on the left, shape (e,).
    """
    (start_vertex, end_vertex, left, right), grid = _edges_of(solid), _on_grid(vertices_px)
    # A face seen edge-on is taken to be turned away: the outline then runs around it.
    towards = facing(vertices_px[:, solid.faces]) > 0
    turn = towards[:, left].astype(np.int8) - towards[:, right]
    row, edge = np.nonzero(turn)
    start, end = grid[row, start_vertex[edge]], grid[row, end_vertex[edge]]
    # Walked with the face that is turned to the camera on the left, an edge that runs down is a left edge.
    forward = turn[row, edge, None] > 0
    tail, head = np.where(forward, start, end), np.where(forward, end, start)
    is_left = head[:, 1] > tail[:, 1]
    return row, np.where(is_left[:, None], tail, head), np.where(is_left[:, None], head, tail), is_left


def _join(row: Indices, y: Indices, column: Indices, is_start: Mask, height: int) -> tuple[Spans, Indices]:
    """Spans from the one start to the one end in each scan line of a silhouette; and silhouettes with other counts."""
    line = row * height + y
    starts, ends = np.flatnonzero(is_start), np.flatnonzero(~is_start)
    starts, ends = starts[np.argsort(line[starts])], ends[np.argsort(line[ends])]
    odd = np.empty(0, dtype=np.int64)
    if not (np.array_equal(line[starts], line[ends]) and (np.diff(line[starts]) > 0).all()):
        odd = _odd(line[starts], line[ends], height)
        starts, ends = starts[~np.isin(row[starts], odd)], ends[~np.isin(row[ends], odd)]
    filled = column[ends] > column[starts]
    starts, ends = starts[filled], ends[filled]
    return Spans(row[starts], y[starts], column[starts], column[ends]), odd


def _odd(starts: Indices, ends: Indices, height: int) -> Indices:
    """Silhouettes with a scan line that has not exactly one start and one end."""
    lines, inverse = np.unique(np.concatenate([starts, ends]), return_inverse=True)
    is_start = np.arange(len(inverse)) < len(starts)
    n_starts = np.bincount(inverse[is_start], minlength=len(lines))
    n_ends = np.bincount(inverse[~is_start], minlength=len(lines))
    return np.unique(lines[(n_starts != 1) | (n_ends != 1)] // height)
