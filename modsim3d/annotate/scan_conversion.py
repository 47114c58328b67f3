"""Silhouettes as spans of pixels, scan line by scan line: what the rasteriser would fill, found without it.

Corners are rounded to the 1/256 px grid that the rasteriser works on, so the edges are lines through whole numbers and
all that follows is exact integer arithmetic: a pixel is in a silhouette if its centre is, and a centre exactly on an
edge belongs to the side that OpenGL's fill rule gives it to (the left edge, and the edge of the lower row, are in).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.vessels import Solid

HALF = SUBPIXELS // 2


@dataclass(frozen=True, eq=False)
class Spans:
    """Runs of pixels of n silhouettes, ordered by silhouette, scan line and column.

    Attributes:
        row: Silhouette, shape (m,).
        y: Pixel row, shape (m,).
        start: First column, shape (m,).
        stop: The column after the last, greater than `start`, shape (m,).
    """

    row: Indices
    y: Indices
    start: Indices
    stop: Indices

    @classmethod
    def none(cls) -> Spans:
        """No spans."""
        empty = np.empty(0, dtype=np.int64)
        return cls(empty, empty, empty, empty)

    def take(self, chosen: Mask | Indices) -> Spans:
        """The spans chosen."""
        return Spans(self.row[chosen], self.y[chosen], self.start[chosen], self.stop[chosen])


def counts_and_boxes(spans: Spans, count: int) -> tuple[Array, Array]:
    """Pixels and half-open boxes of silhouettes; (inf, inf, −inf, −inf) for one without a pixel.

    Args:
        spans: Ordered by silhouette.
        count: Number of silhouettes n.

    Returns:
        Shapes (n,) and (n, 4).
    """
    pixels: Array = np.bincount(spans.row, spans.stop - spans.start, minlength=count).astype(np.float64)
    boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (count, 1))
    if len(spans.row):
        first = np.flatnonzero(np.diff(spans.row, prepend=-1))
        rows = spans.row[first]
        boxes[rows, 0] = np.minimum.reduceat(spans.start, first)
        boxes[rows, 1] = np.minimum.reduceat(spans.y, first)
        boxes[rows, 2] = np.maximum.reduceat(spans.stop, first)
        boxes[rows, 3] = np.maximum.reduceat(spans.y, first) + 1
    return pixels, boxes


@dataclass(frozen=True, eq=False)
class Edges:
    """Undirected edges of a closed mesh and the two faces beside each; faces are oriented alike.

    Attributes:
        start: Vertex, shape (E,).
        end: Vertex; the face `left` runs from start to end, shape (E,).
        left: Face, shape (E,).
        right: Face that runs from end to start, shape (E,).
    """

    start: Indices
    end: Indices
    left: Indices
    right: Indices

    @classmethod
    def of(cls, solid: Solid) -> Edges:
        """The edges of a solid."""
        faces = {
            (a, b): f
            for f, face in enumerate(solid.faces.tolist())
            for a, b in zip(face, face[1:] + face[:1], strict=True)
        }
        pairs = [(a, b, f, faces[b, a]) for (a, b), f in faces.items() if a < b]
        return cls(*np.array(pairs, dtype=np.int64).T)


def facing(corners_px: Array) -> Indices:
    """Whether triangles with rounded corners are turned to the camera (> 0), away from it (< 0), or have no area.

    Args:
        corners_px: In buffer pixels, in an order that is counter-clockwise seen from outside, shape (..., 3, 2).

    Returns:
        Twice the area with its sign, in units of 1/256 px squared, shape (...).
    """
    grid = np.rint(corners_px * SUBPIXELS).astype(np.int64)
    (ax, ay), (bx, by) = (np.moveaxis(grid[..., i, :] - grid[..., 0, :], -1, 0) for i in (1, 2))
    area: Indices = ay * bx - ax * by  # rows run downwards: counter-clockwise has its sign turned
    return area


def scan_convert(vertices_px: Array, solid: Solid, edges: Edges, image_size: tuple[int, int]) -> tuple[Spans, Indices]:
    """The spans of convex solids inside an image.

    An edge is on the outline if one of its faces is turned to the camera and the other away. Its crossings with scan
    lines bound the silhouette: those on one side start a span, those on the other end it.

    Args:
        vertices_px: Projected vertices, all in front of the near plane, in buffer pixels, shape (n, K, 2).
        solid: Their faces.
        edges: Of the solid.
        image_size: Width and height of the buffer.

    Returns:
        The spans; and silhouettes whose rounded corners make no convex outline, which must be drawn to be known.
    """
    grid = np.rint(vertices_px * SUBPIXELS).astype(np.int64)
    # A face seen edge-on is taken to be turned away: the outline then runs around it.
    towards = facing(vertices_px[:, solid.faces]) > 0
    turn = towards[:, edges.left].astype(np.int8) - towards[:, edges.right]
    row, edge = np.nonzero(turn)
    start, end = grid[row, edges.start[edge]], grid[row, edges.end[edge]]
    # Walk every outline edge with the face that is turned to the camera on the left: downwards it is a left edge.
    forward = turn[row, edge] > 0
    tail, head = np.where(forward[:, None], start, end), np.where(forward[:, None], end, start)
    is_start = head[:, 1] > tail[:, 1]
    upper, lower = np.where(is_start[:, None], tail, head), np.where(is_start[:, None], head, tail)
    width, height = image_size
    # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
    first = np.clip(-((HALF - upper[:, 1]) // SUBPIXELS), 0, height)
    stop = np.clip(-((HALF - lower[:, 1]) // SUBPIXELS), 0, height)
    lines = stop - first
    which = np.repeat(np.arange(len(lines)), lines)
    y = np.arange(len(which)) - np.repeat(np.cumsum(lines) - lines - first, lines)
    dy = (lower - upper)[which, 1]
    # Crossing at x = upper.x + (256 y + 128 − upper.y) · dx / dy; its first pixel centre at or right of it.
    rise = (SUBPIXELS * y + HALF - upper[which, 1]) * (lower - upper)[which, 0] + (upper[which, 0] - HALF) * dy
    column = np.clip(-(-rise // (SUBPIXELS * dy)), 0, width)
    return _join(row[which], y, column, is_start[which], len(vertices_px), height)


def _join(row: Indices, y: Indices, column: Indices, is_start: Mask, count: int, height: int) -> tuple[Spans, Indices]:
    """Pair the one start and the one end of each silhouette's scan lines."""
    line = row * height + y
    starts, ends = np.flatnonzero(is_start), np.flatnonzero(~is_start)
    starts, ends = starts[np.argsort(line[starts])], ends[np.argsort(line[ends])]
    if len(starts) == len(ends) and np.array_equal(line[starts], line[ends]) and (np.diff(line[starts]) > 0).all():
        odd = np.empty(0, dtype=np.int64)
    else:
        odd = _odd(line[starts], line[ends], height)
        good_start, good_end = ~np.isin(row[starts], odd), ~np.isin(row[ends], odd)
        starts, ends = starts[good_start], ends[good_end]
    filled = column[ends] > column[starts]
    starts, ends = starts[filled], ends[filled]
    return Spans(row[starts], y[starts], column[starts], column[ends]), odd


def _odd(starts: Indices, ends: Indices, height: int) -> Indices:
    """Silhouettes with a scan line that does not have exactly one start and one end."""
    lines, inverse = np.unique(np.concatenate([starts, ends]), return_inverse=True)
    is_start = np.arange(len(inverse)) < len(starts)
    n_starts = np.bincount(inverse[is_start], minlength=len(lines))
    n_ends = np.bincount(inverse[~is_start], minlength=len(lines))
    return np.unique(lines[(n_starts != 1) | (n_ends != 1)] // height)


def spans_of_runs(ids: NDArray[np.uint32]) -> tuple[Indices, Indices]:
    """Runs of equal IDs in an ID image read row by row; a run never goes on into the next row.

    Args:
        ids: Shape (h, w).

    Returns:
        Where each run begins in the flattened image, and its ID; both of shape (k,).
    """
    flat = ids.reshape(-1)
    begins = np.empty(flat.shape, dtype=bool)
    np.not_equal(flat[1:], flat[:-1], out=begins[1:])
    begins[:: ids.shape[1]] = True
    starts = np.flatnonzero(begins)
    return starts, flat[starts].astype(np.int64)


def spans_of_ids(ids: NDArray[np.uint32]) -> Spans:
    """The spans of the silhouettes in an ID image in which none hides another; unordered.

    Args:
        ids: Silhouette + 1, zero where there is none, shape (h, w).
    """
    starts, values = spans_of_runs(ids)
    stops = np.append(starts[1:], ids.size)
    filled = values > 0
    lines, first = np.divmod(starts[filled], ids.shape[1])
    return Spans(values[filled] - 1, lines, first, first + (stops - starts)[filled])


def concatenate_spans(parts: list[Spans]) -> Spans:
    """Spans of several sets, put in order."""
    joined = Spans(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("row", "y", "start", "stop")))
    return joined.take(np.lexsort((joined.start, joined.y, joined.row)))
