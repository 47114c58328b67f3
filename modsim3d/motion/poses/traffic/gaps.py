"""Water between hulls, and between hulls and land, over a whole drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.unions import union_of
from modsim3d.motion.poses.traffic.tracks import Sweep
from modsim3d.vessels.obstacles import Obstacle

BETWEEN = np.array([-0.375, -0.125, 0.125, 0.375])
"""Times within an interval, around the step, at which hulls that are close are compared."""
STRIDE = 8
"""One step in so many is looked at to find those at which two hulls are near each other."""
SWING = 1.4
"""A bow in a turn moves faster than the hull's centre, by no more than this factor: no radius is below 3/4 length."""


def rectangle_gaps(
    offset: Array, axes: Array, half: tuple[float, float], other_axes: Array, other_half: tuple[float, float]
) -> Array:
    """Widest gap between n pairs of rectangles along the normals of their sides in metres, shape (..., n).

    It is never more than their distance, and negative if they overlap.

    Args:
        offset: From the centres of the first rectangles to those of the others, shape (..., n, 2).
        axes: Unit vectors along the lengths of the first, shape (n, 2).
        half: Half length and half beam of the first.
        other_axes: Unit vectors along the lengths of the others, shape (n, 2).
        other_half: Half length and half beam of the others.
    """
    cosine = np.abs(axes[:, 0] * other_axes[:, 0] + axes[:, 1] * other_axes[:, 1])
    sine = np.abs(axes[:, 0] * other_axes[:, 1] - axes[:, 1] * other_axes[:, 0])
    gaps = []
    for axis, mine, theirs in ((axes, half, other_half), (other_axes, other_half, half)):
        ahead = np.abs(offset[..., 0] * axis[:, 0] + offset[..., 1] * axis[:, 1])
        abeam = np.abs(offset[..., 0] * axis[:, 1] - offset[..., 1] * axis[:, 0])
        gaps += [
            ahead - mine[0] - cosine * theirs[0] - sine * theirs[1],
            abeam - mine[1] - sine * theirs[0] - cosine * theirs[1],
        ]
    widest: Array = np.maximum.reduce(gaps)
    return widest


def least_gaps(sweep: Sweep, other: Sweep, interval_s: float, within_m: float) -> tuple[Array, Indices]:
    """Least gap between each of C tracks and one other over all times, and the step of it, both of shape (C,).

    A gap is a lower bound of the distance of the hulls at any time, between the steps too. Gaps of more than `within_m`
    are infinite, with step 0.

    Args:
        sweep: C tracks.
        other: One track.
        interval_s: Interval between the steps.
        within_m: Gaps of more than this are of no interest.
    """
    speed = (sweep.speeds_m_s + other.speeds_m_s[0]) * SWING * interval_s
    reach = sweep.hull.reach_m + other.hull.reach_m + within_m
    least, step = np.full(len(sweep.tracks), np.inf), np.zeros(len(sweep.tracks), dtype=np.int64)
    rows, steps = _near_steps(sweep, other, reach, speed)
    if not len(rows):
        return least, step
    axes, other_axes = sweep.axes[rows, steps], other.axes[0, steps]
    drift = other_axes * other.speeds_m_s[0] - axes * sweep.speeds_m_s[rows, None]
    offsets = other.places_m[0, steps] - sweep.places_m[rows, steps] + (BETWEEN * interval_s)[:, None, None] * drift
    found = rectangle_gaps(offsets, axes, sweep.hull.half_m, other_axes, other.hull.half_m).min(axis=0)
    found -= speed[rows] / 8
    found[found > within_m] = np.inf
    order = np.lexsort((steps, found, rows))
    first = order[np.unique(rows[order], return_index=True)[1]]
    least[rows[first]], step[rows[first]] = found[first], steps[first]
    return least, step


def _near_steps(sweep: Sweep, other: Sweep, reach_m: float, speed_m: Array) -> tuple[Indices, Indices]:
    """Tracks and steps at which two hulls could come within reach during the interval around the step.

    `speed_m` is how far they can move against each other in an interval, shape (C,). Few steps are looked at first.
    """
    middles = np.minimum(
        np.arange(STRIDE // 2, sweep.present.shape[1] + STRIDE // 2, STRIDE), sweep.present.shape[1] - 1
    )
    offset = sweep.places_m[:, middles] - other.places_m[:, middles]
    around = (reach_m + speed_m * (STRIDE + 1) / 2)[:, None] ** 2
    coarse = offset[..., 0] ** 2 + offset[..., 1] ** 2 < around
    if not coarse.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    near = np.repeat(coarse, STRIDE, axis=1)[:, : sweep.present.shape[1]]
    rows, steps = np.nonzero(near & sweep.present & other.present)
    offset = sweep.places_m[rows, steps] - other.places_m[0, steps]
    close = offset[:, 0] ** 2 + offset[:, 1] ** 2 < (reach_m + speed_m[rows] / 2) ** 2
    return rows[close], steps[close]


@dataclass(frozen=True, eq=False)
class Land:
    """What vessels must keep clear of on a map, by the height of its lower side: (height, footprint), rising."""

    levels: tuple[tuple[float, shapely.Geometry], ...]

    @classmethod
    def of(cls, obstacles: Sequence[Obstacle]) -> Land:
        """The footprints of all solids that reach above the sea."""
        found: dict[float, list[shapely.Geometry]] = {}
        for obstacle in obstacles:
            for solid, vertices in obstacle.solids:
                if vertices[:, 2].max() > 0:
                    base = max(float(vertices[:, 2].min()), 0.0)
                    found.setdefault(base, []).append(_footprint(vertices, None if solid.convex else solid.faces))
        levels, so_far = [], shapely.Polygon()
        for base in sorted(found):
            so_far = union_of([so_far, *found[base]])
            shapely.prepare(so_far)
            levels.append((base, so_far))
        return cls(tuple(levels))

    def below(self, air_draft_m: float) -> shapely.Geometry:
        """Footprint of all that stands in the way of a vessel of an air draft; bridges above her mast do not."""
        return next((area for base, area in reversed(self.levels) if base < air_draft_m), self._open)

    @cached_property
    def _open(self) -> shapely.Geometry:
        return shapely.Polygon()

    def gaps(self, sweep: Sweep, interval_s: float, within_m: float) -> Array:
        """Least distance of each of C tracks to land in metres, shape (C,); more than `within_m` is infinite."""
        area = self.below(sweep.hull.air_draft_m)
        least = np.full(len(sweep.tracks), np.inf)
        if area.is_empty:
            return least
        for row, (places, axes) in enumerate(zip(sweep.places_m, sweep.axes, strict=True)):
            there = sweep.present[row]
            margin = float(sweep.speeds_m_s[row]) * SWING * interval_s / 2
            limit = sweep.hull.reach_m + within_m + margin
            line = np.repeat(places[there], 2, axis=0)  # twice, so that one place alone is a line too
            if not there.any() or shapely.distance(shapely.LineString(line), area) > limit:
                continue
            close = np.flatnonzero(there)[shapely.dwithin(shapely.points(places[there]), area, limit)]
            hulls = shapely.polygons(corners(places[close], axes[close], sweep.hull.half_m))
            least[row] = shapely.distance(hulls, area).min(initial=np.inf) - margin
        least[least > within_m] = np.inf
        return least


def corners(places: Array, axes: Array, half: tuple[float, float]) -> Array:
    """Corners of n rectangles, shape (n, 4, 2)."""
    along, across = axes * half[0], np.stack([-axes[:, 1], axes[:, 0]], axis=-1) * half[1]
    return places[:, None] + np.stack([along + across, along - across, -along - across, across - along], axis=1)


def _footprint(vertices: Array, faces: Indices | None) -> shapely.Geometry:
    if faces is None:
        return shapely.MultiPoint(vertices[:, :2]).convex_hull
    triangles = shapely.polygons(vertices[:, :2][faces])
    return union_of(triangles[shapely.area(triangles) > 0])
