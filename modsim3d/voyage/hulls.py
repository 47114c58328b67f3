"""The vertices of a solid that can make the edges of its box."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
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


def stacked(hulls: Sequence[Array]) -> Array:
    """Hulls of V vessels side by side, the last vertex of each repeated, shape (V, K, 3)."""
    most = max(map(len, hulls))
    return np.stack([np.concatenate([hull, np.repeat(hull[-1:], most - len(hull), axis=0)]) for hull in hulls])
