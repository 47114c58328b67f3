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
from modsim3d.truth.clusters import ClusteredPairs
from modsim3d.truth.occlusion_order import order_of_pairs
from modsim3d.truth.outlines import Outlines

DEPTH_ERROR = 1e-4
"""Solids that are apart by less than this share of their distance are left to the depth buffer. Its 24 bits hold depths
a thousand times more precisely, but it interpolates them across triangles that may be seen almost edge-on."""
MOST_ROUNDS = 64
"""Solids one behind the other in the longest chain whose order is looked for."""


def ranks_of(
    outlines: Outlines, pairs: ClusteredPairs, candidates: Mask, intrinsics: Intrinsics, supersample: int
) -> tuple[Indices, Mask]:
    """Ranks of solids, in which whatever is in front of another has the lower one.

    Args:
        outlines: The n solids.
        pairs: P pairs of them that may have pixels in common.
        candidates: Which solids are in front of the near plane and drawn without being cut, shape (n,).
        intrinsics: Those of a pinhole camera.
        supersample: Buffer pixels per image pixel and axis.

    Returns:
        Ranks, shape (n,); and whether the order of the pair is known and its ranks agree with it, shape (P,).
    """
    known = candidates[pairs.first] & candidates[pairs.second]
    nearest, farthest = _depths(outlines)
    # A corner is moved by at most 1/512 of a buffer pixel along each axis.
    per_metre = DEPTH_ERROR + 1 / (SUBPIXELS * supersample * min(intrinsics.focal_px))
    gap_m = per_metre * np.maximum(farthest[pairs.first], farthest[pairs.second])
    first_nearer = known & (farthest[pairs.first] + gap_m < nearest[pairs.second])
    second_nearer = known & (farthest[pairs.second] + gap_m < nearest[pairs.first])
    convex = outlines.convex
    asked = np.flatnonzero(known & ~first_nearer & ~second_nearer & convex[pairs.first] & convex[pairs.second])
    order = order_of_pairs(outlines, pairs.first[asked], pairs.second[asked], gap_m[asked])
    first_nearer[asked], second_nearer[asked] = order.first_can_hide, order.second_can_hide
    apart = np.zeros(len(known), dtype=bool)
    apart[asked] = ~(order.intersecting | order.first_can_hide | order.second_can_hide)
    near = np.concatenate([pairs.first[first_nearer], pairs.second[second_nearer]])
    far = np.concatenate([pairs.second[first_nearer], pairs.first[second_nearer]])
    ranks = _ranks(near, far, len(outlines))
    lower, higher = ranks[pairs.first] < ranks[pairs.second], ranks[pairs.first] > ranks[pairs.second]
    agrees = np.where(first_nearer, lower, True) & np.where(second_nearer, higher, True)
    return ranks, agrees & (first_nearer | second_nearer | apart)


def _depths(outlines: Outlines) -> tuple[Array, Array]:
    """Least and greatest c3 of each solid, both of shape (n,)."""
    nearest, farthest = np.empty((2, len(outlines)))
    for part in outlines.parts:
        depths_m = part.vertices_camera[..., 2]
        nearest[part.rows], farthest[part.rows] = depths_m.min(axis=1), depths_m.max(axis=1)
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
