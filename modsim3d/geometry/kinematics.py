"""Velocities, accelerations and angular rates from poses at a sequence of times, by central differences.
A motion has a slope between neighbouring times. In the middle of the sequence the two slopes are weighted so that a
parabola through three points gets its exact derivative, for any intervals. At an end the derivative is the one slope,
and the acceleration is that of the neighbouring time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Mask
from modsim3d.geometry.camera_poses import rotation_vector

NAUTICAL_MILE_M = 1852.0
KNOT_M_S = NAUTICAL_MILE_M / 3600


def slopes(times_s: Array, values: Array) -> Array:
    """Change per second from each of n ascending times, shape (n,), to the next, shape (n, ...) to (n − 1, ...)."""
    return np.diff(values, axis=0) / _along(np.diff(times_s), values.ndim)


def first_derivative(times_s: Array, between: Array) -> Array:
    """The derivative at n ascending times, shape (n,), from the slopes between them, shape (n − 1, ...) to (n, ...). It
    has the unit of the slopes, and is zero if there is only one time."""
    derivative = np.zeros((len(times_s), *between.shape[1:]))
    if len(between):
        derivative[0], derivative[-1] = between[0], between[-1]
    before, after = _intervals(times_s, between.ndim)
    derivative[1:-1] = (after * between[:-1] + before * between[1:]) / (before + after)
    return derivative


def second_derivative(times_s: Array, between: Array) -> Array:
    """The second derivative at n ascending times, shape (n,), from the slopes between, shape (n − 1, ...) to (n, ...).
    It has the unit of the slopes a second, and is zero if there are fewer than three times."""
    derivative = np.zeros((len(times_s), *between.shape[1:]))
    if len(between) < 2:
        return derivative
    before, after = _intervals(times_s, between.ndim)
    derivative[1:-1] = 2 * np.diff(between, axis=0) / (before + after)
    derivative[0], derivative[-1] = derivative[1], derivative[-2]
    return derivative


def velocities(times_s: Array, positions_m: Array, present: Mask) -> Array:
    """Velocities of V vessels that come and go, in metres per second, from positions; both of shape (n, V, 3). A vessel
    that appears or leaves is at an end of its sequence. Zero where a vessel is not `present` (n, V), or once only."""
    between = slopes(times_s, positions_m)
    known = present[:-1] & present[1:]
    central = first_derivative(times_s, between)
    none = np.zeros((1, *between.shape[1:]))
    one_sided = np.concatenate([none, np.where(known[..., None], between, 0.0)])
    one_sided[:-1] += np.where(known[..., None], between, 0.0)
    both = np.zeros(present.shape, dtype=bool)
    both[1:-1] = known[:-1] & known[1:]
    return np.where(both[..., None], central, one_sided)


def turning(times_s: Array, world_R_body: Array) -> Array:
    """Angular velocity of the smallest turn from each time (n,), ascending, to the next, right-handed, in body axes.
    Rotations to WCF of shape (n, ..., 3, 3) give radians per second of shape (n − 1, ..., 3)."""
    vectors = rotation_vector(np.swapaxes(world_R_body[:-1], -1, -2) @ world_R_body[1:])
    return vectors / _along(np.diff(times_s), vectors.ndim)


def _intervals(times_s: Array, dimensions: int) -> tuple[Array, Array]:
    """Intervals before and after each inner time, with extra axes to broadcast."""
    intervals = np.diff(times_s)
    return _along(intervals[:-1], dimensions), _along(intervals[1:], dimensions)


def _along(values: Array, dimensions: int) -> Array:
    return values.reshape(-1, *[1] * (dimensions - 1))


# ---- How near two vessels come ----


@dataclass(frozen=True, eq=False)
class HullTracks:
    """Rectangles under way: n vessels at the same S times, straight and evenly turning between them."""

    times_s: Array  # ascending, shape (S,)
    centres_m: Array  # in WCF, w1 and w2, shape (S, n, 2); NaN where a vessel is absent
    headings_rad: Array  # counter-clockwise from w1, shape (S, n); NaN where a vessel is absent
    half_sizes_m: Array  # half lengths and half beams, shape (n, 2)


def closest_approach(times_s: Array, one_m: Array, other_m: Array) -> tuple[float, float]:
    """Least distance of two points that move straight between S times, and the first time of it (CPA and TCPA).

    Args:
        times_s: Ascending, shape (S,).
        one_m: Places, shape (S, 2); NaN where there is none.
        other_m: Places of the other, shape (S, 2).

    Returns:
        The distance in metres and the time in seconds; infinite and NaN if the two are never there together.
    """
    apart = other_m - one_m
    finite = np.isfinite(apart[:, 0] + apart[:, 1])
    if not finite.any():
        return np.inf, np.nan
    distance = np.where(finite, np.hypot(apart[:, 0], apart[:, 1]), np.inf)
    moved = np.diff(apart, axis=0)
    length2 = (moved**2).sum(axis=1)
    share = np.clip(-(apart[:-1] * moved).sum(axis=1) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    nearest = apart[:-1] + share[:, None] * moved
    between = np.where(finite[:-1] & finite[1:], np.hypot(nearest[:, 0], nearest[:, 1]), np.inf)
    at, leg = int(np.argmin(distance)), int(np.argmin(between)) if len(between) else 0
    if not len(between) or distance[at] <= between[leg]:
        return float(distance[at]), float(times_s[at])
    return float(between[leg]), float(times_s[leg] + share[leg] * (times_s[leg + 1] - times_s[leg]))


# ---- Unions of polygons ----

SNAPPED = 1e-9  # grid to which corners move where the exact way fails: pixels or metres, below what any result shows


def union_of(polygons: Sequence[shapely.Geometry] | NDArray[np.object_]) -> shapely.Geometry:
    """The region that polygons cover together. Slivers among hundreds of triangles can defeat the overlay of GEOS in
    floating point ("side location conflict"). The overlay on a grid cannot fail so, but it is slower."""
    try:
        return shapely.union_all(polygons)
    except shapely.GEOSException:
        return shapely.union_all(polygons, grid_size=SNAPPED)
