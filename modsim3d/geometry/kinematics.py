"""Velocities, accelerations and angular rates from poses at a sequence of times, by central differences.

A motion has a slope between neighbouring times. In the middle of the sequence the two slopes are weighted so that a
parabola through three points gets its exact derivative, for any intervals. At an end the derivative is the one slope,
and the acceleration is that of the neighbouring time.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.geometry.rotations import rotation_vector


def slopes(times_s: Array, values: Array) -> Array:
    """Change per second from each of n ascending times, shape (n,), to the next, shape (n, ...) to (n − 1, ...)."""
    return np.diff(values, axis=0) / _along(np.diff(times_s), values.ndim)


def first_derivative(times_s: Array, between: Array) -> Array:
    """The derivative at n ascending times, shape (n,), from the slopes between them, shape (n − 1, ...) to (n, ...).

    It has the unit of the slopes, and is zero if there is only one time.
    """
    derivative = np.zeros((len(times_s), *between.shape[1:]))
    if len(between):
        derivative[0], derivative[-1] = between[0], between[-1]
    before, after = _intervals(times_s, between.ndim)
    derivative[1:-1] = (after * between[:-1] + before * between[1:]) / (before + after)
    return derivative


def second_derivative(times_s: Array, between: Array) -> Array:
    """The second derivative at n ascending times, shape (n,), from the slopes between, shape (n − 1, ...) to (n, ...).

    It has the unit of the slopes a second, and is zero if there are fewer than three times.
    """
    derivative = np.zeros((len(times_s), *between.shape[1:]))
    if len(between) < 2:
        return derivative
    before, after = _intervals(times_s, between.ndim)
    derivative[1:-1] = 2 * np.diff(between, axis=0) / (before + after)
    derivative[0], derivative[-1] = derivative[1], derivative[-2]
    return derivative


def velocities(times_s: Array, positions_m: Array, present: Mask) -> Array:
    """Velocities of V vessels that come and go. A vessel that appears or leaves is at an end of its sequence.

    Args:
        times_s: Ascending, shape (n,).
        positions_m: Shape (n, V, 3).
        present: Whether each vessel is present, shape (n, V).

    Returns:
        Metres per second, shape (n, V, 3); zero where a vessel is absent, or present at one time only.
    """
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
    """Angular velocity of the smallest turn from each time to the next, right-handed, in body axes.

    Args:
        times_s: Ascending, shape (n,).
        world_R_body: Rotations to WCF, shape (n, ..., 3, 3).

    Returns:
        Radians per second, shape (n − 1, ..., 3).
    """
    vectors = rotation_vector(np.swapaxes(world_R_body[:-1], -1, -2) @ world_R_body[1:])
    return vectors / _along(np.diff(times_s), vectors.ndim)


def _intervals(times_s: Array, dimensions: int) -> tuple[Array, Array]:
    """Intervals before and after each inner time, with extra axes to broadcast."""
    intervals = np.diff(times_s)
    return _along(intervals[:-1], dimensions), _along(intervals[1:], dimensions)


def _along(values: Array, dimensions: int) -> Array:
    return values.reshape(-1, *[1] * (dimensions - 1))
