"""The vertices of a solid that can make the edges of its box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.truth.separating_axes import hull_vertices
from modsim3d.vessels.vessel import Solid

_FEW = 8
"""A shoebox has no vertex to spare."""


def hull_of(solid: Solid) -> Array:
    """The vertices of a solid on its convex hull, in the unit box of VCF, shape (K, 3): no other makes an edge."""
    return solid.vertices if len(solid.vertices) <= _FEW else solid.vertices[hull_vertices(solid)]


def stacked(hulls: Sequence[Array]) -> Array:
    """Hulls of V vessels side by side, the last vertex of each repeated, shape (V, K, 3)."""
    most = max(map(len, hulls))
    return np.stack([np.concatenate([hull, np.repeat(hull[-1:], most - len(hull), axis=0)]) for hull in hulls])
