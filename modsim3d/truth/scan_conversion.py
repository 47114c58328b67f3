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
common edge of two triangles fills each pixel once; Mesa uses this one). tests/truth/test_regions_against_full.py
compares the result with drawn buffers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, ranges
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.truth.silhouettes import Spans
from modsim3d.world.vessels import Solid, once_a_solid

HALF = SUBPIXELS // 2


@once_a_solid
def _edges_of(solid: Solid) -> Indices:
    """Start, end, left and right of each edge of a closed solid, shape (4, E). The face on the left is the one that
    runs from start to end; the face on the right runs from end to start."""
    faces = {
        (a, b): face
        for face, corners in enumerate(solid.faces.tolist())
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    }
    pairs = [(a, b, face, faces[b, a]) for (a, b), face in faces.items() if a < b]
    return np.array(pairs, dtype=np.int64).T


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of the outlines of n silhouettes that cross scan lines of the image. The left edges of all silhouettes come
    first, ordered by silhouette and from top to bottom, and then the right ones."""

    side: Indices  # silhouette of each edge; for right edges n is added, shape (e,)
    upper: Array  # column and row of the upper end on the grid, shape (2, e)
    lower: Array  # those of the lower end, shape (2, e)
    first: Indices  # first scan line of the image that the edge crosses, shape (e,)
    stop: Indices  # the scan line after the last, shape (e,)

    @classmethod
    def of(cls, vertices_px: Array, solid: Solid, height: int) -> _Edges:
        """The edges between a face turned to the camera and one turned away, in an image of some height."""
        x, y = _on_grid(vertices_px.T.copy())  # rows of a vertex each: they are taken faster than columns
        (a, b, c), (start, end, left, right) = solid.faces.T, _edges_of(solid)
        # As its doubled area says. A face seen edge-on is taken to be turned away: the outline then runs around it.
        towards = (y[b] - y[a]) * (x[c] - x[a]) > (x[b] - x[a]) * (y[c] - y[a])
        edge, row = np.nonzero(towards[left] != towards[right])
        one, other = start[edge], end[edge]
        falls = y[one, row] < y[other, row]
        above, below = np.where(falls, one, other), np.where(falls, other, one)
        # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
        first, stop = (
            np.clip(np.ceil((y[vertex, row] - HALF) / SUBPIXELS), 0, height).astype(np.int64)
            for vertex in (above, below)
        )
        # Walked with the face that is turned to the camera on the left, an edge that runs down is a left edge.
        side = row + len(vertices_px) * (towards[left[edge], row] != falls)
        some = np.flatnonzero(first < stop)
        some = some[np.argsort(side[some] * height + first[some])]
        above, below, row = above[some], below[some], row[some]
        upper, lower = np.stack([x[above, row], y[above, row]]), np.stack([x[below, row], y[below, row]])
        return cls(side[some], upper, lower, first[some], stop[some])

    def broken(self, count: int) -> Mask:
        """Mask of n = `count` silhouettes without one left and one right edge in each of their lines, shape (n,). The
        edges of a side must follow each other without a gap, and both sides must have the same lines."""
        same = self.side[1:] == self.side[:-1]
        ends = np.full((2, 2 * count), -1)  # the first line of each side, and the one after its last
        ends[0, self.side[::-1]], ends[1, self.side] = self.first[::-1], self.stop
        broken: Mask = (ends[:, :count] != ends[:, count:]).any(axis=0)
        broken[self.side[1:][same & (self.first[1:] != self.stop[:-1])] % count] = True
        return broken

    def take(self, chosen: Mask) -> _Edges:
        """The chosen edges, by a mask of shape (e,)."""
        side, first, stop = self.side[chosen], self.first[chosen], self.stop[chosen]
        return _Edges(side, self.upper[:, chosen], self.lower[:, chosen], first, stop)

    def lines(self, count: int) -> tuple[Indices, Indices]:
        """Silhouette and scan line of each line of n = `count` silhouettes, none of which is broken, shapes (m,)."""
        left = slice(0, int(np.searchsorted(self.side, count)))
        first, lines = self.first[left], (self.stop - self.first)[left]
        return self.side[left].repeat(lines), ranges(first, lines)

    def columns(self, y: Indices, width: int) -> Indices:
        """First column at or to the right of the left and of the right edge in each line, shape (2, m). `y` are the
        scan lines of silhouettes of which none is broken, shape (m,)."""
        (x0, y0), (dx, dy) = self.upper, self.lower - self.upper
        # 256 dy times the crossing, counted from the centre of column 0, at line 0 and from one line to the next.
        at_zero, step, scale = (HALF - y0) * dx + (x0 - HALF) * dy, SUBPIXELS * dx, SUBPIXELS * dy
        lines = self.stop - self.first
        crossing = step.repeat(lines).reshape(2, -1)
        crossing *= y.astype(np.float64)
        crossing += at_zero.repeat(lines).reshape(2, -1)
        crossing /= scale.repeat(lines).reshape(2, -1)
        np.ceil(crossing, out=crossing)
        columns: Indices = np.clip(crossing, 0, width, out=crossing).astype(np.int64)
        return columns


def scan_convert(vertices_px: Array, solid: Solid, image_size_px: tuple[int, int]) -> tuple[Spans, Indices]:
    """The spans of n convex solids inside an image, and the silhouettes, shape (k,), that have to be drawn instead,
    because their rounded corners make no convex outline. Projected vertices are all in front of the near plane, in
    buffer pixels like the size of the image, shape (n, K, 2)."""
    (width, height), count = image_size_px, len(vertices_px)
    edges = _Edges.of(vertices_px, solid, height)
    broken = edges.broken(count)
    if broken.any():
        edges = edges.take(~broken[edges.side % count])
    row, y = edges.lines(count)
    start, stop = edges.columns(y, width)
    return Spans(row, y, start, stop).take(np.flatnonzero(start < stop)), np.flatnonzero(broken)


def _on_grid(points_px: Array) -> Array:
    """Points in units of 1/256 px, rounded to whole numbers, same shape."""
    return np.rint(points_px * SUBPIXELS)
