"""How far counts of pixels can differ from exact areas only because pixels sample regions at their centres."""

from __future__ import annotations

import numpy as np
import shapely

from modsim3d.arrays import Array
from modsim3d.truth.analytic import VisibleRegions
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.polygon_occlusion import Polygons


def boundary_pixels(regions: Polygons, supersample: int) -> Array:
    """How many buffer pixels the boundary of each region can cross: |dx| + |dy| + 2 for each edge, shape (n,).

    Only the count of these pixels can differ from their share of the area, each by less than one.

    Args:
        regions: Polygons in image pixels, shape (n,).
        supersample: Buffer pixels per image pixel and axis.
    """
    boundaries = shapely.boundary(regions)
    points, row = shapely.get_coordinates(boundaries, return_index=True)
    steps = np.abs(np.diff(points, axis=0)).sum(axis=1) * supersample + 2
    steps[row[1:] != row[:-1]] = 0.0
    crossed: Array = np.bincount(row[1:], steps, minlength=len(regions)).astype(np.float64)
    return crossed


def fraction_bound(regions: VisibleRegions, analytic: Occlusion, supersample: int) -> Array:
    """The greatest difference of visible fractions that boundary pixels can explain, shape (n,).

    A region of area A is counted as N pixels, and |N − A| is less than the number B of pixels on its boundary. With
    areas S of the silhouette and V of its visible part, the fraction from pixels therefore lies between
    (V − B_V) / (S + B_S) and (V + B_V) / (S − B_S).

    Args:
        regions: Polygons of silhouettes and visible parts.
        analytic: Their areas.
        supersample: Buffer pixels per image pixel and axis.
    """
    scale = supersample**2
    whole, seen = analytic.silhouette_px * scale, analytic.visible_px * scale
    edge, seen_edge = (boundary_pixels(r, supersample) for r in (regions.silhouettes, regions.visible))
    fraction = analytic.visible_fraction()
    least = np.maximum(seen - seen_edge, 0) / (whole + edge)
    greatest = np.where(whole > edge, (seen + seen_edge) / np.maximum(whole - edge, 1e-9), 1.0)
    return np.maximum(fraction - least, np.minimum(greatest, 1.0) - fraction)
