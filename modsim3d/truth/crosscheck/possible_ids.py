"""What may be seen at pixels, from rays through their centres; a tie is a pixel at which that is not one thing.

OpenGL rounds corners to 1/256 pixel and depths to 24 bits. A pixel whose centre is that near to an edge may belong to
either side of it, and of two faces that are as near to the camera either may be in front. Such pixels are ties: two
drawings may differ there, if both show what may be seen. Everywhere else there is one answer.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, occurring
from modsim3d.truth.crosscheck.drawing import Drawing

EDGE_PX = 1 / 128
"""Buffer pixels by which rounding may move an edge: half of 1/256 along both axes, and as much for the corners of what
it is compared with."""
LENS_EDGE_PX = 1 / 32
"""The same with a lens, whose curves are drawn as chords."""
DEPTH_SHARE = 2.0**-20
"""Depths that differ by a smaller share of the nearest corner's are equal, beside what moved corners change."""
MOST_PAIRS = 2_000_000
"""Most pixels times triangles that are looked at together; it bounds the memory."""


def undecided(drawing: Drawing, x: Indices, y: Indices, wanted: int) -> Mask:
    """At which of k pixels rounding decides whether an ID is seen, or anything else or nothing, shape (k,)."""
    ids, possible = possible_ids(drawing, x, y)
    this = ids == wanted
    return np.asarray(possible[:, this].any(axis=1) & possible[:, ~this].any(axis=1))


def possible_ids(drawing: Drawing, x: Indices, y: Indices) -> tuple[Indices, Mask]:
    """The m IDs of a drawing, 0 first, ascending, and whether each may be seen at k pixels, shapes (m,) and (k, m)."""
    solids, solid = occurring(drawing.occluder, int(drawing.occluder.max(initial=-1)) + 1)
    points = _straight(drawing, x, y)
    step = max(1, MOST_PAIRS // max(len(solid), 1))
    parts = [
        _possible(drawing, solid, len(solids), points[first : first + step]) for first in range(0, len(points), step)
    ]
    nothing = np.empty((0, len(solids) + 1), dtype=bool)
    return np.concatenate([[0], solids + 1]), np.concatenate([nothing, *parts])


def _straight(drawing: Drawing, x: Indices, y: Indices) -> Array:
    """The centres of pixels in the image of the pinhole, shape (k, 2)."""
    centres: Array = np.stack([x, y], axis=-1).astype(np.float64) + 0.5
    if drawing.intrinsics.distortion is None:
        return centres
    ray = drawing.intrinsics.unproject(centres / drawing.supersample, np.full(len(centres), 1.0))
    pinhole = drawing.intrinsics.pinhole
    straight: Array = (ray @ pinhole.matrix.T)[..., :2] * drawing.supersample
    return straight


def _possible(drawing: Drawing, solid: Indices, count: int, points: Array) -> Mask:
    """Whether nothing, and each of `count` solids, may be seen at points (k, 2), shape (k, count + 1)."""
    band = EDGE_PX if drawing.intrinsics.distortion is None else LENS_EDGE_PX
    corners, depth = drawing.straight_px, drawing.inverse_depth
    near = (
        (corners.min(axis=1) <= points.max(axis=0) + band) & (corners.max(axis=1) >= points.min(axis=0) - band)
    ).all(axis=1)
    corners, depth, solid = corners[near], depth[near], solid[near]
    low, high = corners.min(axis=1) - band, corners.max(axis=1) + band
    perhaps = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=-1)
    surely = perhaps.copy()
    edges = np.roll(corners, -1, axis=1) - corners
    doubled = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    lengths = np.linalg.norm(edges, axis=-1)
    sign = np.where(doubled < 0, -1.0, 1.0)
    for i in range(3):
        away = points[:, None] - corners[:, i]
        inside = (edges[:, i, 0] * away[..., 1] - edges[:, i, 1] * away[..., 0]) * sign
        perhaps &= inside >= -band * lengths[:, i]
        surely &= inside > band * lengths[:, i]
    nearest, farthest = depth.max(axis=1) * (1 + DEPTH_SHARE), depth.min(axis=1) * (1 - DEPTH_SHARE)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = _slope(edges, depth, doubled)
        here = depth[:, 0] + ((points[:, None] - corners[:, 0]) * slope).sum(axis=-1)
        spread = np.abs(slope).sum(axis=-1) * band + DEPTH_SHARE * nearest
        at_most = np.fmin(here + spread, nearest)
        at_least = np.fmax(here - spread, farthest)
    possible = np.zeros((len(points), count + 1), dtype=bool)
    most, least = np.zeros((2, len(points), count))
    for each in np.flatnonzero(np.bincount(solid, minlength=count)).tolist():
        own = solid == each
        most[:, each] = np.where(perhaps[:, own], at_most[:, own], 0.0).max(axis=1)
        least[:, each] = np.where(surely[:, own], at_least[:, own], 0.0).max(axis=1)
    possible[:, 0] = ~(least > 0).any(axis=1)
    for each in range(count):
        others = np.delete(least, each, axis=1).max(axis=1, initial=0.0)
        possible[:, each + 1] = (most[:, each] > 0) & (most[:, each] >= others)
    return possible


def _slope(edges: Array, depth: Array, doubled: Array) -> Array:
    """How near / c3 changes for a pixel to the right and a pixel down in T triangles, shape (T, 2)."""
    to_b, to_c = edges[:, 0], -edges[:, 2]
    by_b, by_c = depth[:, 1] - depth[:, 0], depth[:, 2] - depth[:, 0]
    right, down = by_b * to_c[:, 1] - by_c * to_b[:, 1], by_c * to_b[:, 0] - by_b * to_c[:, 0]
    return np.stack([right, down], axis=-1) / doubled[:, None]
