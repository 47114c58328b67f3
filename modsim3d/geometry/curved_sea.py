"""The curved sea: distant things lie lower than on a flat one.

A point of the sea at a horizontal distance d lies d² / (2 R) below the plane that touches the sea under the camera.
This is the first term of R − √(R² − d²); the next, d⁴ / (8 R³), is below a millimetre at 30 km. Light travels straight
here; refraction would lift distant things by about a seventh of the drop.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array

RADIUS_M = 6_371_000.0
"""Mean radius of the Earth (Moritz, 2000, "Geodetic Reference System 1980": R1 = 6 371 008.77 m)."""


def drop_m(places_m: Array, camera_m: Array) -> Array:
    """Drop of the sea below the plane that touches it under a camera, in metres, shape (...).

    Args:
        places_m: w1, w2 and optionally w3, shape (..., 2) or (..., 3).
        camera_m: Camera centres in WCF, a shape that broadcasts against the places.
    """
    away = places_m[..., :2] - camera_m[..., :2]
    drop: Array = (away * away).sum(axis=-1) / (2 * RADIUS_M)
    return drop


def lowered(places_m: Array, camera_m: Array) -> Array:
    """Places in WCF, in metres, as cameras at `camera_m` see them over a curved sea; all shapes are (..., 3)."""
    places: Array = np.array(places_m, dtype=np.float64)
    places[..., 2] -= drop_m(places_m, camera_m)
    return places


def shift_px(depth_m: Array, focal_px: tuple[float, float]) -> Array:
    """Pixels, shape (n,), by which the drop f d / (2 R) shifts things at depths d, shape (n,), down the image.

    The larger focal length counts, as the camera may be rolled.
    """
    return max(focal_px) * depth_m / (2 * RADIUS_M)
