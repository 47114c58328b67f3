"""Visible parts by exact geometry, where it tells."""

from __future__ import annotations

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth.analytic import boundary_pixels, occlusion_of_regions, visible_regions
from modsim3d.truth.occlusion_order import overlapping_pairs
from modsim3d.truth.outlines import Outlines


def visible_areas(outlines: Outlines, intrinsics: Intrinsics, supersample: int) -> tuple[Array, Array]:
    """The area of the visible part of each row, and by how much its pixels may differ, both (n,) in image pixels.

    NaN where geometry does not tell: meshes, what overlaps one in the image, and solids that intersect. Only pixels on
    a boundary, of the silhouette or of its visible part, may count otherwise than by their share of the area.
    """
    areas, bounds = np.full((2, len(outlines)), np.nan)
    convex = np.flatnonzero(outlines.convex)
    some = outlines.take(convex)
    regions = visible_regions(some, intrinsics)
    areas[convex] = occlusion_of_regions(some, regions).visible_px
    boundaries = (boundary_pixels(each, supersample) for each in (regions.silhouettes, regions.visible))
    bounds[convex] = sum(boundaries) / supersample**2
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    mesh = ~outlines.convex
    areas[first[mesh[second]]] = areas[second[mesh[first]]] = np.nan
    return areas, bounds
