"""Horizons and silhouettes of a run's frames: what its page shows and its tables do not hold."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask, ranges, row_before, run_starts
from modsim3d.geometry.camera import Intrinsics
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.truth.occlusion_order import in_boxes, order_of_pairs, overlapping_pairs
from modsim3d.truth.outlines import Outlines, new_numbers
from modsim3d.view.report.overview import PartMotion
from modsim3d.view.report.packing import NONE, OUTLINE_BEFORE, ROW_BEFORE, Codes, Column
from modsim3d.view.report.silhouette_edges import Edges, contours, silhouette_edges, tidy_at_border
from modsim3d.world.vessel_motion import PosesInWaves

# ---- The order in which silhouettes are painted over each other ----


def in_front(outlines: Outlines, occluder_count: int, hides: Indices) -> tuple[Indices, Indices]:
    """Pairs of rows of the outlines of which one may hide the other of its frame in part: the rows that may be hidden,
    shape (p,), and for each of them the one that may hide it, shape (p,).
    Of two solids at depths that do not overlap the nearer one is in front. Otherwise a plane between them, or between
    the boxes around them, tells which one is. Without such a plane the truth decides, if one of the two hides the other
    and not the other way round. It does not say what vessels hide of obstacles. `hides` holds the keys
    (frame · occluder_count + hidden) · occluder_count + hider of what hides what in the truth, shape (m,)."""
    boxes = in_boxes(outlines)
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    others = outlines.occluder[first] != outlines.occluder[second]
    first, second = first[others], second[others]
    nearest_m, farthest_m = boxes.depths_m()
    first_nearer, second_nearer = farthest_m[first] <= nearest_m[second], farthest_m[second] <= nearest_m[first]
    apart = first_nearer | second_nearer
    order = order_of_pairs(boxes, first[~apart], second[~apart])
    one, other = order.first[order.intersecting], order.second[order.intersecting]
    frame, occluder = outlines.frame[one], outlines.occluder
    one_hides = np.isin(_keys(frame, occluder[other], occluder[one], occluder_count), hides)
    other_hides = np.isin(_keys(frame, occluder[one], occluder[other], occluder_count), hides)
    by_one, by_other = one_hides & ~other_hides, other_hides & ~one_hides
    hidden = (order.second[order.first_can_hide], order.first[order.second_can_hide], other[by_one], one[by_other])
    hider = (order.first[order.first_can_hide], order.second[order.second_can_hide], one[by_one], other[by_other])
    farther = second[first_nearer], first[second_nearer & ~first_nearer]
    nearer = first[first_nearer], second[second_nearer & ~first_nearer]
    return np.concatenate([*hidden, *farther]), np.concatenate([*hider, *nearer])


def _keys(frame: Indices, hidden: Indices, hider: Indices, occluder_count: int) -> Indices:
    return (frame * occluder_count + hidden) * occluder_count + hider


def painting_order(frame: Indices, depth_m: Array, occluder: Indices, hidden: Indices, hider: Indices) -> Indices:
    """Permutation of rows, shape (n,), in order of frame: each is painted after what it hides, and otherwise the
    farthest first. Sorting by depth alone could paint a long ship over the boat that lies in front of its stern.
    `frame` (ascending), `depth_m` and `occluder` of each row have shape (n,); the pieces of an occluder are painted
    together where possible. Rows `hidden` may be hidden in part by the rows `hider` of the same frame, shape (p,)."""
    _, occluder_in_frame = np.unique(frame * (int(occluder.max(initial=0)) + 1) + occluder, return_inverse=True)
    farthest_m = np.full(len(frame), -np.inf)
    np.maximum.at(farthest_m, occluder_in_frame, depth_m)
    order = np.lexsort((-depth_m, occluder_in_frame, -farthest_m[occluder_in_frame], frame))
    place = np.argsort(order)
    wrong = np.unique(frame[hidden[place[hidden] > place[hider]]])
    by_row = np.lexsort((hider, hidden))
    hidden, hider = hidden[by_row], hider[by_row]
    orders: dict[tuple[bytes, ...], Indices] = {}
    for crowded in wrong:
        first, stop = np.searchsorted(frame, (crowded, crowded + 1)).tolist()
        pairs = slice(*np.searchsorted(hidden, (first, stop)))
        far_to_near, of, back, front = order[first:stop] - first, occluder[first:stop], hidden[pairs], hider[pairs]
        same = far_to_near.tobytes(), of.tobytes(), (back - first).tobytes(), (front - first).tobytes()
        if same not in orders:  # little changes from frame to frame
            before: dict[int, list[int]] = defaultdict(list)
            for behind, nearer in zip((back - first).tolist(), (front - first).tolist(), strict=True):
                before[behind].append(nearer)
            orders[same] = np.array(_behind_first(far_to_near.tolist(), of, before))
        order[first:stop] = first + orders[same]
    return order


def _behind_first(far_to_near: list[int], occluder: Indices, before: dict[int, list[int]]) -> list[int]:
    """Sort the rows of a frame so that each comes before those in front of it, which `before` holds.
    Rows of the occluder painted last come next if they may, then farther ones before nearer ones. Where three hide each
    other in a ring, the farthest comes first."""
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
        self.painted: dict[int, None] = {}
        self._rows, self._occluder = far_to_near, occluder
        self._place = {row: place for place, row in enumerate(far_to_near)}
        self._free: list[int] = []
        self._free_of: dict[int, list[int]] = defaultdict(list)
        self._last_occluder = -1

    def add(self, row: int) -> None:
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


# ---- Shapes that are painted ----


@dataclass(frozen=True, eq=False)
class Shapes:
    """Silhouettes, or pieces of an obstacle between which nothing else is painted: s shapes of l closed lines."""

    frame: Indices  # of each shape, shape (s,)
    occluder: Indices  # of each shape, shape (s,)
    lines: Indices  # number of lines of each shape, shape (s,)
    count: Indices  # number of corners of each line, shape after shape, shape (l,)
    corners: NDArray[np.uint16]  # of the lines in quanta, line after line, shape (k, 2)

    def __len__(self) -> int:
        """Number of shapes."""
        return len(self.frame)

    @cached_property
    def first_line(self) -> Indices:
        """The first line of each shape, and the number of lines, shape (s + 1,)."""
        return np.concatenate([[0], np.cumsum(self.lines)])

    @cached_property
    def first_corner(self) -> Indices:
        """The first corner of each shape, and the number of corners, shape (s + 1,)."""
        return np.concatenate([[0], np.cumsum(self.count)])[self.first_line]

    def take(self, chosen: Mask) -> Shapes:
        """The shapes that are chosen by a mask, shape (s,)."""
        lines, corners = (np.repeat(chosen, np.diff(first)) for first in (self.first_line, self.first_corner))
        frame, occluder = self.frame[chosen], self.occluder[chosen]
        return Shapes(frame, occluder, self.lines[chosen], self.count[lines], self.corners[corners])

    def pieces(self) -> Iterator[tuple[Indices, NDArray[np.uint16]]]:
        """The counts and the corners of each shape."""
        for shape in range(len(self)):
            lines, corners = (slice(*first[shape : shape + 2]) for first in (self.first_line, self.first_corner))
            yield self.count[lines], self.corners[corners]

    def equal(self, others: Indices) -> Mask:
        """Whether each shape has the same lines as another, by index, −1 for none, shape (s,)."""
        same: Mask = (others >= 0) & (self.lines == self.lines[others])
        size = np.diff(self.first_corner)
        same &= size == size[others]
        for values, first in ((self.count, self.first_line), (self.corners, self.first_corner)):
            rows = np.flatnonzero(same)
            long = np.diff(first)[rows]
            which = np.repeat(np.arange(len(rows)), long)
            mine, other = (values[ranges(first[shapes], long)] for shapes in (rows, others[rows]))
            differ = (mine != other).any(axis=tuple(range(1, mine.ndim)))  # also of no shapes at all
            same[rows[np.unique(which[differ])]] = False
        return same


def concatenated(some: Sequence[Shapes]) -> Shapes:
    """Shapes one after the other."""
    names = ("frame", "occluder", "lines", "count", "corners")
    return Shapes(*(np.concatenate([getattr(part, name) for part in some]) for name in names))


_NONE = np.empty(0, dtype=np.int64)
NO_SHAPES = Shapes(_NONE, _NONE, _NONE, _NONE, np.empty((0, 2), dtype=np.uint16))


STILL = 1 << 31  # the first number of the outlines that all parts share
STEPS_TOGETHER = 250  # whose geometry is computed together: few calls, little memory


class Silhouettes:
    """The horizons and silhouettes of a run that comes in parts. A silhouette refers to an outline, so that what stands
    still is stored once: what an obstacle shows to a camera ashore once for all parts, the rest once in each part."""

    def __init__(self, scene: Scene, quantum_px: float) -> None:
        """Begin with no part of a run of a scene; lengths in the image are in this unit."""
        self._scene, self._quantum_px = scene, quantum_px
        self._still = OutlineStore()

    def columns(
        self, rows: RunRows, frames: Sequence[Indices], motion: PartMotion, horizons: Array
    ) -> tuple[Indices, dict[str, Column | Codes]]:
        """The silhouettes of one part: the frame's number of each, ascending, shape (s,), and their columns.
        The columns are `owner` and `outline` of the silhouettes, shape (s,), `lineCount` of the outlines, `cornerCount`
        of their lines, and `corners` of the lines: column and row, in quanta, shape (k, 2). `rows` has these frames at
        least. `frames` has for each camera the steps of its frames, ascending, shape (F_c,); frames are counted camera
        by camera. `horizons` receives the sea half plane of each frame, shape (F, 3) with F = ΣF_c at least."""
        scene, occluder_count = self._scene, len(self._scene.occluder_names)
        hides = hiding(rows)
        batches: list[Shapes] = [NO_SHAPES]
        still, begin = [np.empty(0, dtype=bool)], 0
        for index, every in enumerate(frames):
            ashore = scene.cameras[index].mount.vessel is None
            still_owner = len(scene.vessels) if ashore else occluder_count
            for first in range(0, len(every), STEPS_TOGETHER):
                steps = every[first : first + STEPS_TOGETHER]
                place = begin + first
                half_planes, drawn = seen(scene, index, steps, motion.at(steps), self._quantum_px, hides)
                horizons[place : place + len(steps)] = half_planes
                batches.append(replace(drawn, frame=place + drawn.frame))
                still.append(drawn.occluder >= still_owner)
            begin += len(every)
        every_shape, stands = concatenated(batches), np.concatenate(still)
        outline = np.empty(len(stands), dtype=np.int64)
        outline[stands] = STILL + self._still.numbers(every_shape.take(stands))
        moving = every_shape.take(~stands)
        camera = np.searchsorted(np.cumsum([len(every) for every in frames]), moving.frame, side="right")
        outline[~stands], new = outline_numbers(moving, camera)
        order = np.argsort(every_shape.frame, kind="stable")
        return every_shape.frame[order], {
            "owner": Codes(every_shape.occluder[order].astype(np.uint16), by=ROW_BEFORE),
            "outline": Codes(outline[order].astype(np.uint32), by="owner"),
            **_outline_columns(moving.take(new)),
        }

    def still_columns(self) -> dict[str, Column | Codes]:
        """The outlines that all parts refer to, numbered from `STILL` on."""
        return _outline_columns(self._still.shapes())


def seen(
    scene: Scene, index: int, steps: Indices, motion: PosesInWaves, quantum_px: float, hides: Indices
) -> tuple[Array, Shapes]:
    """Sea half plane of a camera at each of S ascending steps, shape (S, 3), and the silhouettes that it sees from back
    to front, with the place of their step as their frame. `hides` are the keys from `hiding`, shape (m,)."""
    camera = scene.cameras[index]
    sight, numbers = scene.sight(camera, steps, motion), steps * len(scene.cameras) + index
    half_planes = scene.sea_half_planes(camera, steps)
    before = sight.outlines(measured=False)
    numbered = replace(before, frame=numbers[before.frame])
    drawn = shapes(numbered, camera.intrinsics, quantum_px, len(scene.occluder_names), hides)
    return half_planes, replace(drawn, frame=np.searchsorted(numbers, drawn.frame))


def outline_numbers(moving: Shapes, camera: Indices) -> tuple[Indices, Mask]:
    """The outline of each shape, and which shapes are the first of theirs, both of shape (s,).
    A shape has the outline of the shape before of its occluder in its camera if that is the same."""
    before = row_before(moving.occluder * (int(camera.max(initial=0)) + 1) + camera)
    new = ~moving.equal(before)
    number = np.cumsum(new) - 1
    while len(repeated := np.flatnonzero(~new & (number != number[before]))):
        number[repeated] = number[before[repeated]]
    return number, new


class OutlineStore:
    """Different outlines, numbered in the order in which they come."""

    def __init__(self) -> None:
        """Begin with none."""
        self._numbers: dict[tuple[bytes, bytes], int] = {}
        self._kept: list[Shapes] = [NO_SHAPES]

    def numbers(self, some: Shapes) -> Indices:
        """The number of each shape's outline, shape (s,), a new one if no other has the same lines."""
        numbers, new = np.empty(len(some), dtype=np.int64), np.zeros(len(some), dtype=bool)
        for place, (count, corners) in enumerate(some.pieces()):
            new[place] = (key := (count.tobytes(), corners.tobytes())) not in self._numbers
            numbers[place] = self._numbers.setdefault(key, len(self._numbers))
        self._kept.append(some.take(new))
        return numbers

    def shapes(self) -> Shapes:
        """A shape with each of them."""
        return concatenated(self._kept)


def _outline_columns(different: Shapes) -> dict[str, Column | Codes]:
    return {
        "outlineOwner": Codes(different.occluder.astype(np.uint16), by=ROW_BEFORE),
        "lineCount": Codes(different.lines.astype(np.uint32), by="outlineOwner"),
        "cornerCount": Codes(different.count.astype(np.uint32), by=ROW_BEFORE),
        "corners": Codes(different.corners, by=OUTLINE_BEFORE),
    }


def hiding(rows: RunRows) -> Indices:
    """Keys of what hides what in the truth, see `in_front`, shape (m,)."""
    occluders, occluder_count = rows.occluders(), len(rows.scene.occluder_names)
    frame, hidden = rows.truth_frame[occluders.hidden], rows.truth_vessel[occluders.hidden]
    return _keys(frame, hidden, occluders.name, occluder_count)


def shapes(
    outlines: Outlines, intrinsics: Intrinsics, quantum_px: float, occluder_count: int, hides: Indices
) -> Shapes:
    """The silhouettes of all frames of a camera, frame by frame and from back to front; for `hides` see `in_front`."""
    edges = silhouette_edges(outlines, intrinsics)
    outlines, edges = _seen(outlines, edges)
    hidden, hider = in_front(outlines, occluder_count, hides)
    order = painting_order(outlines.frame, outlines.depth_m, outlines.occluder, hidden, hider)
    frame, occluder = outlines.frame[order], outlines.occluder[order]
    begins = run_starts(frame, occluder)
    shape_of_row = np.empty(len(order), dtype=np.int64)
    shape_of_row[order] = np.searchsorted(begins, np.arange(len(order)), side="right") - 1
    places = np.clip(np.rint(edges.ends_px / quantum_px), 0, NONE - 1).astype(np.int64)
    stays = np.all(places[:, 0] == places[:, 1], axis=1)
    row_of, places = edges.row[~stays], places[~stays]
    column, row = np.rint(np.array(intrinsics.image_size_px) / quantum_px).astype(np.int64).tolist()
    rings = contours(*tidy_at_border(shape_of_row[row_of], places, (column, row)))
    first_line = run_starts(rings.shape)
    begin = begins[rings.shape[first_line]]
    lines = np.diff(first_line, append=len(rings.shape))
    return Shapes(frame[begin], occluder[begin], lines, rings.count, rings.corners.astype(np.uint16))


def _seen(outlines: Outlines, edges: Edges) -> tuple[Outlines, Edges]:
    """The outlines that have edges in the image, with the boxes of these, and the edges."""
    rows = edges.row[run_starts(edges.row)]
    boxes_px = edges.boxes_px(len(outlines))[rows]
    numbered = replace(edges, row=new_numbers(rows, len(outlines))[edges.row])
    return replace(outlines.take(rows), boxes_px=boxes_px), numbered
