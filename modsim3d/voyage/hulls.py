"""The vertices of a solid that can make the edges of its box."""

from __future__ import annotations

from functools import lru_cache

from scipy.spatial import ConvexHull, QhullError

from modsim3d.arrays import Array
from modsim3d.vessels.vessel import Solid

_FEW = 8
"""A shoebox has no vertex to spare."""


@lru_cache(maxsize=256)
def hull_of(solid: Solid) -> Array:
    """The vertices of a solid on its convex hull, in the unit box of VCF, shape (K, 3): no other makes an edge."""
    if len(solid.vertices) <= _FEW:
        return solid.vertices
    try:
        hull: Array = solid.vertices[ConvexHull(solid.vertices).vertices]
    except QhullError:  # a flat mesh
        return solid.vertices
    return hull
