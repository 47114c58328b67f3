"""Which of two disjoint solids can hide the other, from a plane between their convex hulls.

Suppose that a plane has one solid on the camera's side and the other solid beyond. A ray from the camera that has
passed through the plane never comes back, so it can only meet the near solid before the far one. The far solid then
hides nothing of the near one. If the camera itself may be counted to either side of the plane, neither hides the other.

The distance of the centres cannot decide this: the centre of a long ship may be nearer than that of a boat which lies
in front of its stern.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, distinct, read_only
from modsim3d.truth.outlines import Outlines, Part
from modsim3d.truth.overlaps import overlapping_pairs
from modsim3d.truth.separating_axes import axis_count, candidate_axes, extents_along, hull_vertices, widest_gap_axis
from modsim3d.vessels.vessel import Solid, once_a_solid, shoebox

TOUCHING_M = 1e-7
"""Solids that overlap by less are taken to touch: rounding must not turn neighbours at a quay into a collision."""

MOST_COORDINATES = 4_000_000
"""Most coordinates of vertices along axes that are computed at once; it bounds the memory."""


@dataclass(frozen=True, eq=False)
class Order:
    """What pairs of rows of `Outlines` can do to each other.

    Attributes:
        first: Row, shape (P,).
        second: Row of the same frame, greater than `first`, shape (P,).
        first_can_hide: Whether the first can hide a part of the second, shape (P,).
        second_can_hide: Whether the second can hide a part of the first, shape (P,).
        intersecting: Whether no plane separates them, shape (P,). Then both of the above are false and nothing is
            known.
    """

    first: Indices
    second: Indices
    first_can_hide: Mask
    second_can_hide: Mask
    intersecting: Mask


def order_of(outlines: Outlines) -> Order:
    """The order of every two solids whose boxes overlap in the image and that matter to a vessel.

    Of a mesh its convex hull is put in order. A plane between boxes around two hulls is one between the hulls; only if
    there is none, a plane is looked for between the hulls themselves. Solids that overlap no vessel in the image are
    left out: of a long coast, all but a few pieces.
    """
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
    """The order of P pairs of convex solids: rows `first` and rows `second` of the same frames, both of shape (P,).

    A plane separates two of them if they are at least `gap_m` apart across it, a number or an array of shape (P,).
    """
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
    parts = [
        part if part.solid.convex else Part(shoebox(), part.rows, _boxes_around(part), part.vertices_px)
        for part in outlines.parts
    ]
    return replace(outlines, parts=tuple(parts))


def _boxes_around(part: Part) -> Array:
    """Corners of the boxes that the solids fill, in CCF, shape (m, 8, 3)."""
    boxes: Array = corners_from_vertices(part.solid) @ part.vertices_camera
    return boxes


@once_a_solid
def corners_from_vertices(solid: Solid) -> Array:
    """What turns a solid's vertices, stretched and placed, into the corners of the box around it, shape (8, K)."""
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    around = low + (high - low) * (shoebox().vertices - shoebox().vertices[0])
    unit, corners = (np.column_stack([each, np.ones(len(each))]) for each in (solid.vertices, around))
    return read_only(corners @ np.linalg.pinv(unit))


def _pairs_that_matter(outlines: Outlines) -> tuple[Indices, Indices]:
    """Pairs that overlap in the image, among vessels and whatever overlaps a vessel there.

    Two pieces of one obstacle are no pair: it does not matter which of them hides a vessel.
    """
    matters = outlines.boxed.copy()
    matters[np.concatenate(overlapping_pairs(outlines.frame, outlines.boxes_px, outlines.boxed))] = True
    kept = np.flatnonzero(matters)
    first, second = overlapping_pairs(outlines.frame[kept], outlines.boxes_px[kept])
    others = outlines.occluder[kept[first]] != outlines.occluder[kept[second]]
    return kept[first[others]], kept[second[others]]


def _in_turns(pairs: Indices, a: Solid, b: Solid) -> list[Indices]:
    """Pairs of two kinds of solid in portions whose coordinates along the axes fit into memory."""
    most = max(1, MOST_COORDINATES // (axis_count(a, b) * (len(a.vertices) + len(b.vertices))))
    return np.array_split(pairs, -(-len(pairs) // most))


def pairs_by_parts(outlines: Outlines, first: Indices, second: Indices) -> Iterator[tuple[Indices, Part, Part]]:
    """P pairs of rows, both of shape (P,), by the parts that they are of: which pairs, and the two parts."""
    part_of = np.zeros(len(outlines), dtype=np.int64)
    for index, part in enumerate(outlines.parts):
        part_of[part.rows] = index
    kinds = part_of[first] * len(outlines.parts) + part_of[second]
    for kind in distinct(kinds).tolist():
        a, b = (outlines.parts[part] for part in divmod(kind, len(outlines.parts)))
        yield np.flatnonzero(kinds == kind), a, b


def _who_can_hide(vertices_a: Array, vertices_b: Array, axes: Array, gap_m: Array) -> tuple[Mask, Mask]:
    """Try the planes across all axes (P, A, 3) between solids in camera coordinates, shapes (P, K, 3) and (P, L, 3).

    The solids must be at least `gap_m` (P,) apart.

    Returns:
        Whether the first can hide the second and the second the first, shape (P, 2); whether any plane separates them,
        shape (P,).
    """
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
