"""The pixels of closed solids that need not be convex, found without drawing them.

The faces that are turned to the camera cover the silhouette, here and there more than once. On a scan line, the number
of them at a pixel is the number of their edges on its left that begin a face, less those that end one. An edge between
two such faces does both, so only the edges between a face turned to the camera and one turned away are counted. Edges
cross scan lines where `scan_conversion` says.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, ranges
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.truth.pixel_spans import Spans, joined_spans
from modsim3d.truth.silhouettes import doubled_face_areas
from modsim3d.vessels.vessel import Solid, once_a_solid

HALF = SUBPIXELS // 2
MOST_CROSSINGS = 200_000
"""Edges times scan lines that are computed at once; it bounds the memory."""


@once_a_solid
def edges_of(solid: Solid) -> Indices:
    """Start, end, left and right face of each edge of a closed solid, shape (4, E).

    The face on the left runs from start to end, that on the right from end to start. Where more than two faces meet, an
    edge comes more than once.
    """
    ways: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(solid.faces.tolist()):
        for way in ((a, b), (b, c), (c, a)):
            ways.setdefault(way, []).append(face)
    edges = [
        (a, b, left, right)
        for (a, b), faces in ways.items()
        if a < b
        for left, right in zip(faces, ways[b, a], strict=True)
    ]
    return np.array(edges, dtype=np.int64).reshape(-1, 4).T


def faces_towards(vertices_px: Array, solid: Solid) -> Mask:
    """Which faces of n solids with rounded corners are turned to the camera, shape (n, F).

    The vertices are in buffer pixels, shape (n, K, 2).
    """
    towards: Mask = doubled_face_areas(np.rint(vertices_px * SUBPIXELS), solid.faces) > 0
    return towards


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges between faces turned to the camera and faces turned away, ordered by silhouette.

    Attributes:
        row: Silhouette of each edge, shape (e,).
        upper: Upper end on the grid, shape (e, 2).
        lower: Lower end on the grid, shape (e, 2).
        step: 1 if a face begins on its right, −1 if one ends there, shape (e,).
        first: First scan line that it crosses, shape (e,).
        lines: Number of scan lines that it crosses, shape (e,).
    """

    row: Indices
    upper: Array
    lower: Array
    step: Indices
    first: Indices
    lines: Indices

    @classmethod
    def of(cls, vertices_px: Array, solid: Solid, height: int) -> _Edges:
        """Those of n solids in an image of some height; the vertices are in buffer pixels, shape (n, K, 2)."""
        (start, end, left, right), grid = edges_of(solid), np.rint(vertices_px * SUBPIXELS)
        towards = faces_towards(vertices_px, solid)
        turn = towards[:, left].astype(np.int64) - towards[:, right]
        row, edge = np.nonzero(turn)
        tail, head, turn = grid[row, start[edge]], grid[row, end[edge]], turn[row, edge]
        down = head[:, 1] > tail[:, 1]
        upper, lower = np.where(down[:, None], tail, head), np.where(down[:, None], head, tail)
        # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
        first, stop = (
            np.clip(np.ceil((end[:, 1] - HALF) / SUBPIXELS), 0, height).astype(np.int64) for end in (upper, lower)
        )
        return cls(row, upper, lower, np.where(down, turn, -turn), first, stop - first)

    def portions(self) -> list[_Edges]:
        """The edges of some silhouettes after the others."""
        if self.lines.sum() < MOST_CROSSINGS:
            return [self]
        crossings = np.cumsum(np.bincount(self.row, self.lines))
        limits = np.searchsorted(self.row, np.flatnonzero(np.diff(crossings // MOST_CROSSINGS)) + 1)
        columns = [np.split(getattr(self, field.name), limits) for field in fields(self)]
        return [_Edges(*some) for some in zip(*columns, strict=True)]

    def spans(self, width: int, height: int) -> Spans:
        """The spans between the edges in an image of some size."""
        which, y = np.repeat(np.arange(len(self.row)), self.lines), ranges(self.first, self.lines)
        (dx, dy), (x0, y0) = (self.lower - self.upper).T, self.upper.T
        # 256 dy times the crossing, counted from the centre of column 0, at line 0 and from one line to the next.
        at_zero, slope, scale = (HALF - y0) * dx + (x0 - HALF) * dy, SUBPIXELS * dx, SUBPIXELS * dy
        column = np.ceil((at_zero[which] + slope[which] * y) / scale[which])
        column = np.clip(column, 0, width).astype(np.int64)
        line = self.row[which] * height + y
        order = np.argsort(line * (width + 1) + column)
        line, column = line[order], column[order]
        covered = np.cumsum(self.step[which][order]) > 0  # the number is zero after the last edge of each line
        last = np.ones(len(line), dtype=bool)  # of the edges that cross a line in the same column
        last[:-1] = (np.diff(line) != 0) | (np.diff(column) != 0)
        line, column, covered = line[last], column[last], covered[last]
        border = np.diff(covered, prepend=False)
        row, y = np.divmod(line[border][::2], height)
        return Spans(row, y, column[border][::2], column[border][1::2])


def winding_spans(vertices_px: Array, solid: Solid, image_size_px: tuple[int, int]) -> Spans:
    """The spans of n closed solids inside an image.

    Args:
        vertices_px: Projected vertices, all in front of the near plane, in buffer pixels, shape (n, K, 2).
        solid: Has the faces that the vertices span.
        image_size_px: Width and height of the buffer.
    """
    width, height = image_size_px
    return joined_spans([some.spans(width, height) for some in _Edges.of(vertices_px, solid, height).portions()])
