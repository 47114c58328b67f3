"""Order of two disjoint solids of which one can hide the other, from a plane between their convex hulls. Suppose that a
plane has one solid on the camera's side and the other solid beyond. A ray from the camera that has passed through the
plane never comes back, so it can only meet the near solid before the far one. The far solid then hides nothing of the
near one. If the camera itself may be counted to either side of the plane, neither hides the other. The distance of the
centres cannot decide this: that of a long ship may be nearer than that of a boat before its stern."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, distinct, ranges, read_only, run_starts
from modsim3d.truth.outlines import OutlinePart, Outlines
from modsim3d.world.vessels import Solid, once_a_solid, shoebox

PARALLEL = 1 - 1e-9  # unit vectors with a greater dot product count as parallel


def candidate_axes(vertices_a: Array, a: Solid, vertices_b: Array, b: Solid) -> Array:
    """Directions across which convex solids may be apart: face normals of each, cross products of their edges. Vertices
    of P solids with the faces of `a`, shape (P, K, 3), are compared with those of P solids with the faces of `b`, shape
    (P, L, 3). Returns unit vectors, shape (P, A, 3); zero where two edges are parallel."""
    (normals_a, edges_a), (normals_b, edges_b) = _directions(vertices_a, a), _directions(vertices_b, b)
    crosses = np.cross(edges_a[:, :, None, :], edges_b[:, None, :, :]).reshape(len(edges_a), -1, 3)
    length = np.linalg.norm(crosses, axis=-1, keepdims=True)
    crosses = np.where(length > 1e-6, crosses / np.where(length > 1e-6, length, 1.0), 0.0)
    return np.concatenate([normals_a, normals_b, crosses], axis=1)


def axis_count(a: Solid, b: Solid) -> int:
    """Number A of candidate axes of two solids."""
    (normals_a, edges_a), (normals_b, edges_b) = _distinct_directions(a), _distinct_directions(b)
    return len(normals_a) + len(normals_b) + len(edges_a) * len(edges_b)


def _directions(vertices: Array, solid: Solid) -> tuple[Array, Array]:
    """Distinct normals (n, N, 3) and edge directions (n, E, 3) of n solids with vertices (n, K, 3)."""
    faces, ends = _distinct_directions(solid)
    a, b, c = np.moveaxis(vertices[:, faces], 2, 0)
    return _unit(np.cross(b - a, c - a)), _unit(vertices[:, ends[:, 1]] - vertices[:, ends[:, 0]])


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


@once_a_solid
def _distinct_directions(solid: Solid) -> tuple[Indices, Indices]:
    """Faces (N, 3) and edges (E, 2) of which no two are parallel, without edges between triangles of one flat side.
    Stretching and turning a solid keeps parallel lines parallel, so the solid's own vertices decide for all copies."""
    corners = solid.vertices[solid.faces]
    normals = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    faces_at: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(solid.faces.tolist()):
        for start, end in ((a, b), (b, c), (c, a)):
            faces_at.setdefault((min(start, end), max(start, end)), []).append(face)
    sharp = [edge for edge, (one, *two) in faces_at.items() if not two or normals[one] @ normals[two[0]] < PARALLEL]
    ends = np.array(sharp, dtype=np.int64)
    along = _unit(solid.vertices[ends[:, 1]] - solid.vertices[ends[:, 0]])
    return solid.faces[_not_parallel(normals)], ends[_not_parallel(along)]


def _not_parallel(unit: Array) -> list[int]:
    """The first of each set of parallel unit vectors (k, 3)."""
    chosen: list[int] = []
    for i, vector in enumerate(unit):
        if all(abs(vector @ unit[j]) < PARALLEL for j in chosen):
            chosen.append(i)
    return chosen


def extents_along(vertices: Array, axes: Array) -> tuple[Array, Array]:
    """Least and greatest coordinates of vertices (P, K, 3) along axes (P, A, 3), two arrays of shape (P, A). An axis of
    zero length gives −1 and 1 for every solid, so it separates none."""
    along = axes @ np.swapaxes(vertices, 1, 2)
    none = ~axes.any(axis=-1)
    return np.where(none, -1.0, along.min(axis=-1)), np.where(none, 1.0, along.max(axis=-1))


def widest_gap_axis(vertices_a: Array, vertices_b: Array) -> Array:
    """The unit vector across the widest gap between the hulls of vertices (K, 3) and (L, 3); zero if there is none. It
    solves a linear program: the candidate axes of two hulls of many faces are too many to try."""
    from scipy.optimize import linprog  # slow to import, and few scenes need it

    centre = (vertices_a.mean(axis=0) + vertices_b.mean(axis=0)) / 2
    # Along the axis n, a is at most c − t and b at least c + t; t is to be as large as |n1|, |n2|, |n3| ≤ 1 allow.
    a, b = (np.pad(vertices - centre, ((0, 0), (0, 2)), constant_values=1.0) for vertices in (vertices_a, vertices_b))
    rows = np.concatenate([a * (1, 1, 1, -1, 1), b * (-1, -1, -1, 1, 1)])
    bounds = [(-1, 1)] * 3 + [(None, None)] * 2
    solution = linprog([0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds, method="highs-ds")
    axis = np.zeros(3) if solution.x is None else solution.x[:3]
    return _unit(axis) if axis.any() else axis


@once_a_solid
def hull_vertices(solid: Solid) -> Indices:
    """The vertices of a solid that its convex hull has, ascending, shape (k,); all of them if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError  # takes 0.1 s

    try:
        corners: Indices = np.sort(ConvexHull(solid.vertices).vertices).astype(np.int64)
        return corners
    except QhullError:
        return np.arange(len(solid.vertices))


def frame_slices(frame: Indices) -> list[slice]:
    """The rows of each frame that has any; `frame` is that of each row, non-decreasing, shape (n,)."""
    edges = [*run_starts(frame).tolist(), len(frame)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def overlapping_pairs(frame: Indices, boxes_px: Array, some_of: Mask | None = None) -> tuple[Indices, Indices]:
    """Pairs of rows of the same frame whose boxes (n, 4) overlap: first and second rows in ascending order, each of
    shape (P,), first < second. Frames (n,) do not decrease. At least one row of each pair must be set in `some_of`
    (n,), unless it is None. All frames are swept at once from left to right: a box meets those that begin before it
    ends."""
    n, chosen = len(frame), np.ones(len(frame), dtype=bool) if some_of is None else some_of
    if n < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    left, top, right, bottom = np.ascontiguousarray(boxes_px.T)
    # Right sides come before left sides at the same place: boxes that only touch do not overlap.
    is_left = np.arange(2 * n) < n
    side = np.lexsort((is_left, np.concatenate([left, right]), np.concatenate([frame, frame])))
    place = np.empty(2 * n, dtype=np.int64)
    place[side] = np.arange(2 * n)
    begun = side[side < n]
    begun_within = (
        _begins_within(place, side, np.flatnonzero(chosen), begun),
        _begins_within(place, side, np.flatnonzero(~chosen), begun[chosen[begun]]),
    )
    one, other = (np.concatenate(rows) for rows in zip(*begun_within, strict=True))
    overlap = (top[one] < bottom[other]) & (top[other] < bottom[one]) & (left[one] < right[other])
    first, second = np.minimum(one, other)[overlap], np.maximum(one, other)[overlap]
    order = np.argsort(first * n + second)
    return first[order], second[order]


def _begins_within(place: Indices, side: Indices, rows: Indices, others: Indices) -> tuple[Indices, Indices]:
    """Pairs of one of `rows` (k,) and one of `others` whose left side comes between the row's left and right sides.
    `place` is the place in the sweep of the n left sides and then of the n right sides, shape (2n,), `side` its
    inverse; `others` (m,) are in the order of the sweep."""
    if not len(rows):
        return rows, rows
    n = len(place) // 2
    # Numbers of `others` that begin before each place.
    is_other = np.zeros(2 * n + 1, dtype=np.int64)
    is_other[place[others] + 1] = 1
    begun = np.cumsum(is_other)
    first = begun[place[rows] + 1]
    count = np.maximum(begun[place[rows + n]] - first, 0)
    return np.repeat(rows, count), others[ranges(first, count)]


TOUCHING_M = 1e-7  # solids that overlap by less touch: rounding must not turn neighbours at a quay into a collision
MAX_COORDINATES = 4_000_000  # most coordinates of vertices along axes that are computed at once; it bounds the memory


@dataclass(frozen=True, eq=False)
class Order:
    """Relation of pairs of rows of `Outlines`: who can hide whom; shapes (P,)."""

    first: Indices  # row
    second: Indices  # row of the same frame, greater than `first`
    first_can_hide: Mask  # whether the first can hide a part of the second
    second_can_hide: Mask  # whether the second can hide a part of the first
    intersecting: Mask  # whether no plane separates them: then both of the above are false and nothing is known


def order_of(outlines: Outlines) -> Order:
    """The order of every two solids whose boxes overlap in the image and that matter to a vessel. Of a mesh its convex
    hull is put in order. A plane between boxes around two hulls is one between the hulls; only if there is none, a
    plane is looked for between the hulls themselves. Solids that overlap no vessel in the image are left out: of a long
    coast, all but a few pieces."""
    first, second = _pairs_that_matter(outlines)
    order, mesh = order_of_pairs(in_boxes(outlines), first, second), ~outlines.convex
    asked = np.flatnonzero(order.intersecting & (mesh[first] | mesh[second]))
    if not len(asked):
        return order
    can_hide, separated = np.column_stack([order.first_can_hide, order.second_can_hide]), ~order.intersecting
    for pairs, a, b in pairs_by_parts(outlines, first[asked], second[asked]):
        chosen = asked[pairs]
        hulls_a, hulls_b = (
            part.vertices_camera[np.searchsorted(part.rows, rows[chosen])][:, hull_vertices(part.solid)]
            for part, rows in ((a, first), (b, second))
        )
        axes = np.array([[widest_gap_axis(*hulls)] for hulls in zip(hulls_a, hulls_b, strict=True)])
        gap_m = np.full(len(chosen), -TOUCHING_M)
        can_hide[chosen], separated[chosen] = _who_can_hide(hulls_a, hulls_b, axes, gap_m)
    return Order(first, second, can_hide[:, 0], can_hide[:, 1], intersecting=~separated)


def order_of_pairs(outlines: Outlines, first: Indices, second: Indices, gap_m: Array | float = -TOUCHING_M) -> Order:
    """The order of P pairs of convex solids: rows `first` and rows `second` of the same frames, both of shape (P,). A
    plane separates two of them if they are at least `gap_m` apart across it, a number or an array of shape (P,)."""
    gap_m = np.broadcast_to(gap_m, first.shape)
    can_hide = np.zeros((len(first), 2), dtype=bool)
    separated = np.zeros(len(first), dtype=bool)
    for pairs, a, b in pairs_by_parts(outlines, first, second):
        for chosen in _in_turns(pairs, a.solid, b.solid):
            vertices_a = a.vertices_camera[np.searchsorted(a.rows, first[chosen])]
            vertices_b = b.vertices_camera[np.searchsorted(b.rows, second[chosen])]
            axes = candidate_axes(vertices_a, a.solid, vertices_b, b.solid)
            can_hide[chosen], separated[chosen] = _who_can_hide(vertices_a, vertices_b, axes, gap_m[chosen])
    return Order(first, second, can_hide[:, 0], can_hide[:, 1], intersecting=~separated)


def in_boxes(outlines: Outlines) -> Outlines:
    """The solids, with the boxes around them in place of those that are not convex, whose pixels are unknown."""
    parts = list(outlines.parts)
    for index, part in enumerate(parts):
        if not part.solid.convex:
            corners = corners_from_vertices(part.solid) @ part.vertices_camera  # in CCF, shape (m, 8, 3)
            parts[index] = OutlinePart(shoebox(), part.rows, corners, part.vertices_px)
    return replace(outlines, parts=tuple(parts))


@once_a_solid
def corners_from_vertices(solid: Solid) -> Array:
    """Map from a solid's vertices, stretched and placed, to the corners of the box around it, shape (8, K)."""
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    around = low + (high - low) * (shoebox().vertices - shoebox().vertices[0])
    unit, corners = (np.column_stack([points, np.ones(len(points))]) for points in (solid.vertices, around))
    return read_only(corners @ np.linalg.pinv(unit))


def _pairs_that_matter(outlines: Outlines) -> tuple[Indices, Indices]:
    """Pairs that overlap in the image, among vessels and whatever overlaps a vessel there. Two pieces of one obstacle
    are no pair: it does not matter which of them hides a vessel."""
    matters = outlines.boxed.copy()
    matters[np.concatenate(overlapping_pairs(outlines.frame, outlines.boxes_px, outlines.boxed))] = True
    kept = np.flatnonzero(matters)
    first, second = overlapping_pairs(outlines.frame[kept], outlines.boxes_px[kept])
    others = outlines.occluder[kept[first]] != outlines.occluder[kept[second]]
    return kept[first[others]], kept[second[others]]


def _in_turns(pairs: Indices, a: Solid, b: Solid) -> list[Indices]:
    """Pairs of two kinds of solid in portions whose coordinates along the axes fit into memory."""
    most = max(1, MAX_COORDINATES // (axis_count(a, b) * (len(a.vertices) + len(b.vertices))))
    return np.array_split(pairs, -(-len(pairs) // most))


def pairs_by_parts(
    outlines: Outlines, first: Indices, second: Indices
) -> Iterator[tuple[Indices, OutlinePart, OutlinePart]]:
    """P pairs of rows, both of shape (P,), by the parts that they are of: which pairs, and the two parts."""
    part_of = np.zeros(len(outlines), dtype=np.int64)
    for index, part in enumerate(outlines.parts):
        part_of[part.rows] = index
    kinds = part_of[first] * len(outlines.parts) + part_of[second]
    for kind in distinct(kinds).tolist():
        a, b = (outlines.parts[part] for part in divmod(kind, len(outlines.parts)))
        yield np.flatnonzero(kinds == kind), a, b


def _who_can_hide(vertices_a: Array, vertices_b: Array, axes: Array, gap_m: Array) -> tuple[Mask, Mask]:
    """Whether the first can hide the second and the second the first, shape (P, 2), and whether any plane separates
    them, shape (P,), of planes across all axes (P, A, 3) between solids in camera coordinates, shapes (P, K, 3) and
    (P, L, 3), that must be at least `gap_m` (P,) apart."""
    low_a, high_a = extents_along(vertices_a, axes)
    low_b, high_b = extents_along(vertices_b, axes)
    gap_m = gap_m[:, None]
    a_below, b_below = high_a <= low_b - gap_m, high_b <= low_a - gap_m
    # The camera is at zero. If a is below b, a plane may be anywhere from high_a to low_b: one has the camera on the
    # side of a if low_b >= 0, and one has it on the side of b if high_a <= 0.
    first_not_hidden = (a_below & (low_b >= 0)) | (b_below & (high_b <= 0))
    second_not_hidden = (b_below & (low_a >= 0)) | (a_below & (high_a <= 0))
    separated: Mask = np.any(a_below | b_below, axis=1)
    not_hidden = np.stack([np.any(second_not_hidden, axis=1), np.any(first_not_hidden, axis=1)], axis=1)
    return separated[:, None] & ~not_hidden, separated
