"""Places on the Earth in local metres, w1 to the east and w2 to the north of an origin, by pymap3d.

East and north are axes of the tangent plane of the WGS84 ellipsoid at the origin. Height above the plane is ignored,
because the scene's sea is flat. At 20 km this moves a place 0.1 m towards the origin, and true north differs from w2 by
the convergence of the meridians, 0.3° at 56° latitude.
"""

from __future__ import annotations

import numpy as np

from modsim3d.ais.region import wrapped_deg
from modsim3d.arrays import Array


def local_metres(latitude_deg: Array, longitude_deg: Array, origin: tuple[float, float]) -> Array:
    """Metres east and north of an origin.

    Args:
        latitude_deg: Shape (n,).
        longitude_deg: Shape (n,).
        origin: Latitude and longitude in degrees.

    Returns:
        w1 and w2, shape (n, 2).
    """
    import pymap3d

    east, north, _ = pymap3d.geodetic2enu(latitude_deg, longitude_deg, 0.0, *origin, 0.0)
    return np.stack([np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)], axis=-1)


def median_place(latitude_deg: Array, longitude_deg: Array) -> tuple[float, float]:
    """Median latitude and longitude of places, shape (n,) each, also across the date line."""
    angles = np.deg2rad(longitude_deg)
    about = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    longitude = wrapped_deg(about + np.median(wrapped_deg(longitude_deg - about)))
    return float(np.median(latitude_deg)), float(longitude)


def heading_rad(compass_deg: Array) -> Array:
    """Headings counter-clockwise from w1 (east), from compass headings clockwise from north, shape (n,)."""
    return np.pi / 2 - np.deg2rad(compass_deg)
