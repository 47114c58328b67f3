"""Places on the Earth: a region between two corners, and local metres around an origin.

Local metres are w1 to the east and w2 to the north on the tangent plane of the WGS84 ellipsoid at the origin (pymap3d).
Height above the plane is ignored, because the scene's sea is flat. At 20 km this moves a place 0.1 m towards the
origin, and true north differs from w2 by the convergence of the meridians, 0.3° at 56° latitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.arrays import Array, Mask

SEA_LEVEL_STEPS = 4
"""Each step takes the height above the ellipsoid off the height above the tangent plane."""


def wrapped_deg(angle_deg: ArrayLike) -> Array:
    """Angles of any shape, brought into [−180, 180)."""
    return np.mod(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0


@dataclass(frozen=True)
class Region:
    """All places between two corners, the short way round the Earth: `width_deg` eastward from `west_deg`."""

    south_deg: float
    north_deg: float
    west_deg: float
    width_deg: float

    @classmethod
    def between(cls, latitude1: float, longitude1: float, latitude2: float, longitude2: float) -> Region:
        """From two opposite corners, in any order."""
        width = float(wrapped_deg(longitude2 - longitude1))
        west = longitude1 if width >= 0 else longitude2
        return cls(min(latitude1, latitude2), max(latitude1, latitude2), west, abs(width))

    def holds(self, latitude_deg: Array, longitude_deg: Array) -> Mask:
        """Which places are inside, shape (n,)."""
        between = (latitude_deg >= self.south_deg) & (latitude_deg <= self.north_deg)
        return between & (np.mod(longitude_deg - self.west_deg, 360.0) <= self.width_deg)

    def __str__(self) -> str:
        """Its two corners as they are given on the command line."""
        east = float(wrapped_deg(self.west_deg + self.width_deg))
        return f"{self.south_deg:g},{self.west_deg:g},{self.north_deg:g},{east:g}"


def local_metres(latitude_deg: Array, longitude_deg: Array, origin: tuple[float, float]) -> Array:
    """Metres east and north of an origin (latitude, longitude), shape (n, 2), of places, shape (n,) each."""
    import pymap3d

    east, north, _ = pymap3d.geodetic2enu(latitude_deg, longitude_deg, 0.0, *origin, 0.0)
    return np.stack([np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)], axis=-1)


def places(metres: Array, origin: tuple[float, float]) -> tuple[Array, Array]:
    """Latitude and longitude of places at sea level, shape (n,) each, from metres east and north of an origin, (n, 2).

    The other way round than `local_metres`, to a millimetre within 200 km.
    """
    import pymap3d

    east, north = metres[:, 0], metres[:, 1]
    up = np.zeros(len(metres))
    for _ in range(SEA_LEVEL_STEPS):
        latitude, longitude, height = pymap3d.enu2geodetic(east, north, up, *origin, 0.0)
        up = up - np.asarray(height, dtype=np.float64)
    return np.asarray(latitude, dtype=np.float64), wrapped_deg(longitude)


def median_place(latitude_deg: Array, longitude_deg: Array) -> tuple[float, float]:
    """Median latitude and longitude of places, shape (n,) each, also across the date line."""
    angles = np.deg2rad(longitude_deg)
    about = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    longitude = wrapped_deg(about + np.median(wrapped_deg(longitude_deg - about)))
    return float(np.median(latitude_deg)), float(longitude)
