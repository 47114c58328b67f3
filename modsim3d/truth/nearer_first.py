"""Solids in order from near to far, where geometry leaves no doubt what a depth buffer would show.

A depth buffer compares rounded depths of solids with rounded corners. Of two solids that a plane separates by more than
these errors, it shows the one on the camera's side wherever both have a pixel. Most neighbours in an image are far
apart in depth, which is seen without looking for a plane.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.truth.occlusion_order import in_boxes, order_of_pairs, pairs_by_parts
from modsim3d.truth.outlines import Outlines

DEPTH_ERROR = 1e-4
"""Solids that are apart by less than this share of their distance are left to the depth buffer. Its 24 bits hold depths
a thousand times more precisely, but it interpolates them across triangles that may be seen almost edge-on."""
MOST_ROUNDS = 64
"""Solids one behind the other in the longest chain whose order is looked for."""


def ranks_of(
    outlines: Outlines, first: Indices, second: Indices, intrinsics: Intrinsics, supersample: int
) -> tuple[Indices, Mask]:
    """Ranks of solids, in which whatever is in front of another has the lower one.

    Args:
        outlines: The n solids.
        first: Rows of solids that are in front of the near plane, shape (P,).
        second: Those that they may have pixels in common with, shape (P,).
        intrinsics: Those of a pinhole camera.
        supersample: Buffer pixels per image pixel and axis.

    Returns:
        Ranks, shape (n,); and whether the order of the pair is known and its ranks agree with it, shape (P,).
    """
    nearest, farthest = _depths(outlines)
    # A corner is moved by at most 1/512 of a buffer pixel along each axis.
    per_metre = DEPTH_ERROR + 1 / (SUBPIXELS * supersample * min(intrinsics.focal_px))
    gap_m = per_metre * np.maximum(farthest[first], farthest[second])
    first_nearer = farthest[first] + gap_m < nearest[second]
    second_nearer = farthest[second] + gap_m < nearest[first]
    asked, known = np.flatnonzero(~first_nearer & ~second_nearer), np.ones(len(first), dtype=bool)
    if len(asked):
        order = order_of_pairs(in_boxes(outlines), first[asked], second[asked], gap_m[asked])
        first_nearer[asked], second_nearer[asked] = order.first_can_hide, order.second_can_hide
        touching = asked[order.intersecting]
        first_nearer[touching] = _in_front(outlines, first[touching], second[touching], gap_m[touching])
        second_nearer[touching] = _in_front(outlines, second[touching], first[touching], gap_m[touching])
        known[touching] = first_nearer[touching] | second_nearer[touching]
    near = np.concatenate([first[first_nearer], second[second_nearer]])
    far = np.concatenate([second[first_nearer], first[second_nearer]])
    ranks = _ranks(near, far, len(outlines))
    known &= (ranks[first] < ranks[second]) | ~first_nearer
    known &= (ranks[first] > ranks[second]) | ~second_nearer
    return ranks, known


def _in_front(outlines: Outlines, near: Indices, far: Indices, gap_m: Array) -> Mask:
    """Whether solids `far` (P,) are `gap_m` (P,) beyond all faces of solids `near` (P,) that the camera may see.

    A ray meets one of these faces first, even if the solids touch: a hill that stands on an island seen from below is
    behind its shores. If the near solid is not convex, that is not known.
    """
    found = np.zeros(len(near), dtype=bool)
    for pairs, a_part, b_part in pairs_by_parts(outlines, near, far):
        if not a_part.solid.convex:
            continue
        vertices = a_part.vertices_camera[np.searchsorted(a_part.rows, near[pairs])]
        others = b_part.vertices_camera[np.searchsorted(b_part.rows, far[pairs])]
        a, b, c = np.moveaxis(vertices[:, a_part.solid.faces], 2, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        outside_m = -(normal * a).sum(axis=-1)  # how far the camera, which is at zero, is in front of each face
        nearest_m = (normal @ np.swapaxes(others, 1, 2)).max(axis=-1) + outside_m
        gap = gap_m[pairs, None]
        found[pairs] = ((nearest_m < -gap) | (outside_m < -gap)).all(axis=1)
    return found


def _depths(outlines: Outlines) -> tuple[Array, Array]:
    """Least and greatest c3 of each solid, both of shape (n,)."""
    nearest, farthest = np.empty((2, len(outlines)))
    for part in outlines.parts:
        depths_m = part.vertices_camera[..., 2].T.copy()  # many rows at a time are compared faster than few vertices
        nearest[part.rows], farthest[part.rows] = depths_m.min(axis=0), depths_m.max(axis=0)
    return nearest, farthest


def _ranks(near: Indices, far: Indices, count: int) -> Indices:
    """How many solids are in front of each of `count` in the longest chain of pairs from near to far, shape (count,).

    Where pairs run in a circle, there is no such number; then some pair has ranks that do not rise.
    """
    ranks = np.zeros(count, dtype=np.int64)
    for _ in range(MOST_ROUNDS):
        behind = ranks[near] + 1
        if (ranks[far] >= behind).all():
            break
        np.maximum.at(ranks, far, behind)
    return ranks
