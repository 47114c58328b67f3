"""What a camera sees of a scene, as shapes to be painted over each other, and the order to paint them in."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth.occlusion_order import order_of_pairs
from modsim3d.truth.outlines import Outlines, Part
from modsim3d.truth.overlaps import overlapping_pairs
from modsim3d.truth.triangles import triangles_of
from modsim3d.vessels.vessel import shoebox
from modsim3d.view.report.contours import contours
from modsim3d.view.report.recording import NONE

MOST_FACES = 300_000
"""Number of faces whose outlines are computed together: few calls, little memory."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A silhouette, or the pieces of an obstacle between which nothing else is painted.

    Attributes:
        frame: Number of the outlines' frame.
        occluder: Index into the scene's occluder names.
        corners: Corners of its closed lines, line after line, as multiples of the quantum, shape (k, 2).
        count: Number of corners of each line, shape (l,).
    """

    frame: int
    occluder: int
    corners: NDArray[np.uint16]
    count: NDArray[np.uint32]


def shapes(
    outlines: Outlines, intrinsics: Intrinsics, quantum_px: float, occluder_count: int, hides: Indices
) -> Iterator[Shape]:
    """The silhouettes of all frames, frame by frame and from back to front.

    Args:
        outlines: What is before the camera.
        intrinsics: Intrinsics of the camera.
        quantum_px: The unit of lengths in the image.
        occluder_count: Number of the scene's occluder names.
        hides: What hides what in the truth, see `in_front`.
    """
    hidden, hider = in_front(outlines, occluder_count, hides)
    order = painting_order(outlines.frame, outlines.depth_m, outlines.occluder, hidden, hider)
    frame, occluder = outlines.frame[order], outlines.occluder[order]
    begins = np.flatnonzero((np.diff(frame, prepend=-1) != 0) | (np.diff(occluder, prepend=-1) != 0))
    shape_of_row = np.empty(len(order), dtype=np.int64)
    shape_of_row[order] = np.searchsorted(begins, np.arange(len(order)), side="right") - 1
    for rows in _in_turns(outlines):
        some = outlines.take(rows)
        triangles = triangles_of(some, intrinsics, guard_px=0.0)
        corners = np.clip(np.rint(triangles.corners_px / quantum_px), 0, NONE - 1).astype(np.int64)
        kept, corners = _one_way_round(triangles.corners_px, corners, _closed(some)[triangles.row])
        found = contours(shape_of_row[rows[triangles.row[kept]]], corners)
        first_line = np.flatnonzero(np.diff(found.shape, prepend=-1))
        first_corner = (np.cumsum(found.count) - found.count)[first_line]
        pieces = np.split(found.corners.astype(np.uint16), first_corner)[1:]
        counts = np.split(found.count.astype(np.uint32), first_line)[1:]
        for begin, piece, count in zip(begins[found.shape[first_line]].tolist(), pieces, counts, strict=True):
            yield Shape(int(frame[begin]), int(occluder[begin]), piece, count)


def _in_turns(outlines: Outlines) -> list[Indices]:
    """Rows of whole frames, so that their faces fit into memory."""
    if not len(outlines):
        return []
    faces = np.zeros(len(outlines))
    for part in outlines.parts:
        faces[part.rows] = len(part.solid.faces)
    _, frame = np.unique(outlines.frame, return_inverse=True)
    turn = np.cumsum(np.bincount(frame, faces)) // MOST_FACES
    return np.split(np.arange(len(outlines)), np.flatnonzero(np.diff(turn[frame])) + 1)


def _closed(outlines: Outlines) -> Mask:
    """Whether the solid of each row is closed, shape (n,)."""
    closed = np.zeros(len(outlines), dtype=bool)
    for part in outlines.parts:
        closed[part.rows] = part.solid.closed
    return closed


def _one_way_round(corners_px: Array, corners: Indices, closed: Mask) -> tuple[Mask, Indices]:
    """Which triangles are needed, shape (T,), and their corners in one sense of rotation, shape (T', 3, 2).

    Of a closed solid only the triangles that face the camera are needed.
    """
    a, b, c = np.moveaxis(corners_px, 1, 0)
    # Rows run downwards: the area of a face turned to the camera is positive this way round.
    doubled = (b - a)[:, 1] * (c - a)[:, 0] - (b - a)[:, 0] * (c - a)[:, 1]
    kept = np.where(closed, doubled, np.abs(doubled)) > 0
    turned = np.where((doubled < 0)[:, None, None], corners[:, ::-1], corners)
    return kept, turned[kept]


def in_front(outlines: Outlines, occluder_count: int, hides: Indices) -> tuple[Indices, Indices]:
    """Rows that may be hidden in part, and the rows of the same frame that may hide them.

    A plane between two solids, or between the boxes around them, tells which one is in front. Without such a plane the
    truth decides, if one of the two hides the other and not the other way round. It does not say what vessels hide of
    obstacles.

    Args:
        outlines: What is before the camera.
        occluder_count: Number of the scene's occluder names.
        hides: Keys (frame · occluder_count + hidden) · occluder_count + hider of what hides what in the truth.
    """
    boxes = replace(outlines, parts=tuple(map(_in_a_box, outlines.parts)))
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    others = outlines.occluder[first] != outlines.occluder[second]
    order = order_of_pairs(boxes, first[others], second[others])
    one, other = order.first[order.intersecting], order.second[order.intersecting]
    one_hides = np.isin(_keys(outlines, other, one, occluder_count), hides)
    other_hides = np.isin(_keys(outlines, one, other, occluder_count), hides)
    by_one, by_other = one_hides & ~other_hides, other_hides & ~one_hides
    hidden = (order.second[order.first_can_hide], order.first[order.second_can_hide], other[by_one], one[by_other])
    hider = (order.first[order.first_can_hide], order.second[order.second_can_hide], one[by_one], other[by_other])
    return np.concatenate(hidden), np.concatenate(hider)


def _in_a_box(part: Part) -> Part:
    """Solids that are not convex as boxes around them. Their vertices are those of one solid, stretched and placed."""
    if part.solid.convex:
        return part
    unit = part.solid.vertices
    low, high = unit.min(axis=0), unit.max(axis=0)
    corners = low + (high - low) * (shoebox().vertices + np.array([0.5, 0.5, 0.0]))
    placed = np.linalg.pinv(np.column_stack([unit, np.ones(len(unit))])) @ part.vertices_camera
    boxes = np.column_stack([corners, np.ones(len(corners))]) @ placed
    return Part(shoebox(), part.rows, boxes, np.full((*boxes.shape[:2], 2), np.nan))


def _keys(outlines: Outlines, hidden: Indices, hider: Indices, occluder_count: int) -> Indices:
    """Keys of pairs of rows, as `in_front` describes them, shape (p,)."""
    keys: Indices = (
        outlines.frame[hidden] * occluder_count + outlines.occluder[hidden]
    ) * occluder_count + outlines.occluder[hider]
    return keys


def painting_order(frame: Indices, depth_m: Array, occluder: Indices, hidden: Indices, hider: Indices) -> Indices:
    """Sort rows so that each is painted after what it hides, and otherwise the farthest first.

    Sorting by depth alone could paint a long ship over the boat that lies in front of its stern.

    Args:
        frame: Frame of each row, ascending, shape (n,).
        depth_m: Depth of each row, shape (n,).
        occluder: Occluder of each row, shape (n,). The pieces of one are painted together where possible.
        hidden: Rows that may be hidden in part, shape (p,).
        hider: For each of them, the row of the same frame that may hide it, shape (p,).

    Returns:
        A permutation of the rows, in order of frame, shape (n,).
    """
    order = np.lexsort((-depth_m, frame))
    place = np.argsort(order)
    wrong = frame[hidden[place[hidden] > place[hider]]]
    frame_and_occluder = frame * (int(occluder.max(initial=0)) + 1) + occluder
    _, first, pieces = np.unique(frame_and_occluder, return_index=True, return_counts=True)
    wrong = np.union1d(wrong, frame[first[pieces > 1]])
    in_question = np.isin(frame[hidden], wrong)
    before: dict[int, list[int]] = defaultdict(list)
    for back, front in zip(hidden[in_question].tolist(), hider[in_question].tolist(), strict=True):
        before[back].append(front)
    for crowded in wrong:
        rows = slice(*np.searchsorted(frame, (crowded, crowded + 1)))
        order[rows] = _behind_first(order[rows].tolist(), occluder, before)
    return order


def _behind_first(far_to_near: list[int], occluder: Indices, before: dict[int, list[int]]) -> list[int]:
    """Sort the rows of a frame so that each comes before those in front of it.

    Rows of the occluder painted last come next if they may, then farther ones before nearer ones. Where three hide each
    other in a ring, the farthest comes first.

    Args:
        far_to_near: Rows of a frame.
        occluder: Occluder of each row of all frames, shape (n,).
        before: Row → rows in front of it.
    """
    behind = Counter(front for row in far_to_near for front in before.get(row, ()))
    free = _FreeRows(far_to_near, occluder)
    for row in far_to_near:
        if not behind[row]:
            free.add(row)
    while len(free.painted) < len(far_to_near):
        for front in before.get(free.paint_next(), ()):
            behind[front] -= 1
            if not behind[front]:
                free.add(front)
    return list(free.painted)


class _FreeRows:
    """The rows of a frame that nothing unpainted is behind of, and what was painted so far."""

    def __init__(self, far_to_near: list[int], occluder: Indices) -> None:
        """Begin with no free row."""
        self.painted: dict[int, None] = {}
        self._rows, self._occluder = far_to_near, occluder
        self._place = {row: place for place, row in enumerate(far_to_near)}
        self._free: list[int] = []
        self._free_of: dict[int, list[int]] = defaultdict(list)
        self._last_occluder = -1

    def add(self, row: int) -> None:
        """A row may be painted."""
        heapq.heappush(self._free, self._place[row])
        heapq.heappush(self._free_of[int(self._occluder[row])], self._place[row])

    def paint_next(self) -> int:
        """Take the next row; the farthest one that is left if none is free."""
        for queue in (self._free_of[self._last_occluder], self._free):
            while queue:
                row = self._rows[heapq.heappop(queue)]
                if row not in self.painted:
                    return self._paint(row)
        return self._paint(next(row for row in self._rows if row not in self.painted))

    def _paint(self, row: int) -> int:
        self.painted[row] = None
        self._last_occluder = int(self._occluder[row])
        return row
