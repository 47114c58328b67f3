"""The order in which silhouettes are painted over each other, so that each pixel shows what is in front."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.truth.occlusion_order import in_boxes, order_of_pairs
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.overlaps import overlapping_pairs


def in_front(outlines: Outlines, occluder_count: int, hides: Indices) -> tuple[Indices, Indices]:
    """Which rows of the outlines may hide which others of their frame in part.

    Of two solids at depths that do not overlap the nearer one is in front. Otherwise a plane between them, or between
    the boxes around them, tells which one is. Without such a plane the truth decides, if one of the two hides the other
    and not the other way round. It does not say what vessels hide of obstacles.

    Args:
        outlines: The solids before the camera.
        occluder_count: Number of the scene's occluder names.
        hides: Keys (frame · occluder_count + hidden) · occluder_count + hider of what hides what in the truth,
            shape (m,).

    Returns:
        The rows that may be hidden, shape (p,), and for each of them the one that may hide it, shape (p,).
    """
    boxes = in_boxes(outlines)
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    others = outlines.occluder[first] != outlines.occluder[second]
    first, second = first[others], second[others]
    nearest_m, farthest_m = _depths_m(boxes)
    first_nearer, second_nearer = farthest_m[first] <= nearest_m[second], farthest_m[second] <= nearest_m[first]
    apart = first_nearer | second_nearer
    order = order_of_pairs(boxes, first[~apart], second[~apart])
    one, other = order.first[order.intersecting], order.second[order.intersecting]
    one_hides = np.isin(_keys(outlines, other, one, occluder_count), hides)
    other_hides = np.isin(_keys(outlines, one, other, occluder_count), hides)
    by_one, by_other = one_hides & ~other_hides, other_hides & ~one_hides
    hidden = (order.second[order.first_can_hide], order.first[order.second_can_hide], other[by_one], one[by_other])
    hider = (order.first[order.first_can_hide], order.second[order.second_can_hide], one[by_one], other[by_other])
    farther = second[first_nearer], first[second_nearer & ~first_nearer]
    nearer = first[first_nearer], second[second_nearer & ~first_nearer]
    return np.concatenate([*hidden, *farther]), np.concatenate([*hider, *nearer])


def _depths_m(outlines: Outlines) -> tuple[Array, Array]:
    """The least and the greatest depth of each row's vertices, two arrays of shape (n,)."""
    nearest_m, farthest_m = np.zeros((2, len(outlines)))
    for part in outlines.parts:
        depths_m = part.vertices_camera[..., 2]
        nearest_m[part.rows], farthest_m[part.rows] = depths_m.min(axis=1), depths_m.max(axis=1)
    return nearest_m, farthest_m


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
    _, occluder_in_frame = np.unique(frame * (int(occluder.max(initial=0)) + 1) + occluder, return_inverse=True)
    farthest_m = np.full(len(frame), -np.inf)
    np.maximum.at(farthest_m, occluder_in_frame, depth_m)
    order = np.lexsort((-depth_m, occluder_in_frame, -farthest_m[occluder_in_frame], frame))
    place = np.argsort(order)
    wrong = np.unique(frame[hidden[place[hidden] > place[hider]]])
    by_row = np.lexsort((hider, hidden))
    hidden, hider = hidden[by_row], hider[by_row]
    known: dict[tuple[bytes, ...], Indices] = {}
    for crowded in wrong:
        first, stop = np.searchsorted(frame, (crowded, crowded + 1)).tolist()
        pairs = slice(*np.searchsorted(hidden, (first, stop)))
        far_to_near, of, back, front = order[first:stop] - first, occluder[first:stop], hidden[pairs], hider[pairs]
        same = far_to_near.tobytes(), of.tobytes(), (back - first).tobytes(), (front - first).tobytes()
        if same not in known:  # little changes from frame to frame
            before: dict[int, list[int]] = defaultdict(list)
            for behind, nearer in zip((back - first).tolist(), (front - first).tolist(), strict=True):
                before[behind].append(nearer)
            known[same] = np.array(_behind_first(far_to_near.tolist(), of, before))
        order[first:stop] = first + known[same]
    return order


def _behind_first(far_to_near: list[int], occluder: Indices, before: dict[int, list[int]]) -> list[int]:
    """Sort the rows of a frame so that each comes before those in front of it.

    Rows of the occluder painted last come next if they may, then farther ones before nearer ones. Where three hide each
    other in a ring, the farthest comes first. `before` holds the rows in front of each row.
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
    """The rows of a frame that may be painted, as nothing unpainted is behind them, and what was painted so far."""

    def __init__(self, far_to_near: list[int], occluder: Indices) -> None:
        """Begin with no free row of a frame."""
        self.painted: dict[int, None] = {}
        self._rows, self._occluder = far_to_near, occluder
        self._place = {row: place for place, row in enumerate(far_to_near)}
        self._free: list[int] = []
        self._free_of: dict[int, list[int]] = defaultdict(list)
        self._last_occluder = -1

    def add(self, row: int) -> None:
        """Let a row be painted."""
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
