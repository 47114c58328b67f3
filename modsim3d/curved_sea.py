"""What a flat sea leaves out: on the round Earth, what is far away lies lower.

A point of the sea at a horizontal distance d lies d² / (2 R) below the plane that touches the sea under the camera:
the first term of R − √(R² − d²); the next, d⁴ / (8 R³), is below a millimetre at 30 km. Light is taken to be straight,
though refraction lifts far things by about a seventh of this.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array

RADIUS_M = 6_371_000.0
"""Mean radius of the Earth (Moritz, 2000, "Geodetic Reference System 1980": R1 = 6 371 008.77 m)."""


def drop_m(places_m: Array, camera_m: Array) -> Array:
    """How far the sea at some places lies below the plane that touches it under a camera.

    Args:
        places_m: In WCF, the last axis w1, w2 and perhaps w3, shape (..., 2) or (..., 3).
        camera_m: Of the same kind; broadcasts against the places.

    Returns:
        Metres, shape (...).
    """
    away = places_m[..., :2] - camera_m[..., :2]
    drop: Array = (away * away).sum(axis=-1) / (2 * RADIUS_M)
    return drop


def lowered(places_m: Array, camera_m: Array) -> Array:
    """Places as a camera sees them over a curved sea, shape (..., 3); see `drop_m`."""
    places: Array = np.array(places_m, dtype=np.float64)
    places[..., 2] -= drop_m(places_m, camera_m)
    return places


def shift_px(depth_m: Array, focal_px: tuple[float, float]) -> Array:
    """How far down the image that drop moves what is at a depth, f d / (2 R), shape (n,).

    Args:
        depth_m: Distance along the viewing direction, shape (n,).
        focal_px: Of the camera; the larger counts, whichever way up it is held.
    """
    return max(focal_px) * depth_m / (2 * RADIUS_M)
