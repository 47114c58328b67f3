"""Unions of polygons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

SNAPPED = 1e-9
"""Grid to which corners move where the exact way fails: pixels or metres, far below what any result shows."""


def union_of(polygons: Sequence[shapely.Geometry] | NDArray[np.object_]) -> shapely.Geometry:
    """The region that polygons cover together.

    Slivers among hundreds of triangles can defeat the overlay of GEOS in floating point ("side location conflict").
    The overlay on a grid cannot fail so, but it is slower.
    """
    try:
        return shapely.union_all(polygons)
    except shapely.GEOSException:
        return shapely.union_all(polygons, grid_size=SNAPPED)
