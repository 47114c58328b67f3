"""Which edges of a vessel's box something else hides: rays from the camera against convex solids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.scene.scene import Scene
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.parameters import Values

NEARLY = 0.999
"""A ray is hidden before this share of its way: the end is on the vessel itself."""


@dataclass(frozen=True, eq=False)
class Hiding:
    """What can hide vessels from a camera.

    Attributes:
        model: The vessels, each of which hides others with the box around it.
        obstacles: Planes of convex solids, n · p + d <= 0 inside, each of shape (F, 4).
        extents_m: Length, beam and air draft of the vessels, shape (V, 3).
    """

    model: BoxModel
    obstacles: tuple[Array, ...]
    extents_m: Array

    @classmethod
    def of(cls, scene: Scene, model: BoxModel) -> Hiding:
        """The vessels and obstacles of a scene; own ship's hull is left out."""
        solids = [planes_of(vertices) for obstacle in scene.obstacles for _, vertices in obstacle.solids]
        extents = np.array([vessel.extents_m for vessel in scene.vessels])
        return cls(model, tuple(planes for planes in solids if planes is not None), extents)

    def hidden(self, values: Values, times_s: Array, vessel: Indices, corners_m: Array, group: Indices) -> Mask:
        """Whether the vertices that make the edges of boxes are hidden, shape (n, 4).

        Args:
            values: The parameters.
            times_s: Times of the detector's clock, shape (n,).
            vessel: The vessels, shape (n,).
            corners_m: Vertices in VCF, shape (n, 4, 3).
            group: The frame of each row, ascending: only vessels of the same frame hide each other, shape (n,).
        """
        ends = self.model.points_world(values, times_s, vessel, corners_m)
        starts = self.model.camera_poses(values, times_s).positions_m[:, None]
        hidden = np.zeros(ends.shape[:2], dtype=bool)
        for planes in self.obstacles:
            hidden |= crosses(starts, ends, planes)
        row, other = _pairs(group)
        delay = values.vessels[vessel[other], 2]
        places, rotations = self.model.traffic.at(times_s[other] + values["clock_s"] + delay, vessel[other])
        begin, stop = ((points - places[:, None]) @ rotations for points in (starts[row], ends[row]))
        inside = crosses_box(begin, stop, self.extents_m[vessel[other]])
        np.logical_or.at(hidden, row, inside)
        return hidden


def planes_of(vertices_m: Array) -> Array | None:
    """The planes around the convex hull of vertices (K, 3), shape (F, 4); None if they lie in one plane."""
    try:
        planes: Array = np.unique(ConvexHull(vertices_m).equations.round(9), axis=0)
    except QhullError:
        return None
    return planes


def crosses(starts_m: Array, ends_m: Array, planes: Array) -> Mask:
    """Whether the way from starts to ends goes through a convex solid, shapes (..., 3) to (...).

    The part of the way inside all half-spaces is found by cutting it at each plane in turn.
    """
    at_start = starts_m @ planes[:, :3].T + planes[:, 3]
    at_end = ends_m @ planes[:, :3].T + planes[:, 3]
    return _stays(np.broadcast_to(at_start, at_end.shape), at_end)


def crosses_box(starts_m: Array, ends_m: Array, extents_m: Array) -> Mask:
    """The same of boxes in their own VCF, with extents of shape (n, 3), for ways of shapes (n, ..., 3)."""
    half = extents_m / 2 * (1, 1, 0) + extents_m * (0, 0, 1)
    low = -half * (1, 1, 0)
    upper, lower = half[:, None], low[:, None]
    at_start = np.concatenate([starts_m - upper, lower - starts_m], axis=-1)
    at_end = np.concatenate([ends_m - upper, lower - ends_m], axis=-1)
    return _stays(np.broadcast_to(at_start, at_end.shape), at_end)


def _stays(at_start: Array, at_end: Array) -> Mask:
    """Whether some part of a way is on the inner side of all planes; values at its ends, shape (..., F)."""
    change = at_end - at_start
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = -at_start / change
    enters = np.where(change < 0, cut, np.where((change == 0) & (at_start > 0), np.inf, 0.0)).max(axis=-1)
    leaves = np.where(change > 0, cut, 1.0).min(axis=-1)
    found: Mask = np.maximum(enters, 0.0) < np.minimum(leaves, NEARLY)
    return found


def _pairs(group: Indices) -> tuple[Indices, Indices]:
    """All ordered pairs of different rows of the same group, which ascends."""
    first, count = np.searchsorted(group, group, side="left"), np.searchsorted(group, group, side="right")
    sizes = count - first
    row = np.repeat(np.arange(len(group)), sizes)
    before = np.repeat(np.cumsum(sizes) - sizes, sizes)
    other = np.repeat(first, sizes) + np.arange(len(row)) - before
    apart = row != other
    return row[apart], other[apart]
