"""A patch of the Earth between two corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.arrays import Array, Mask


def wrapped_deg(angle_deg: ArrayLike) -> Array:
    """Angles in [−180, 180)."""
    return np.mod(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0


@dataclass(frozen=True)
class Region:
    """All places between two corners, the short way round the Earth.

    Attributes:
        south_deg: Least latitude.
        north_deg: Greatest latitude.
        west_deg: Longitude of the western side.
        width_deg: From there eastward.
    """

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
