"""The pixels of one vessel as masks, and whether they are what exact geometry and the truth say they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from modsim3d.arrays import Array, Mask
from modsim3d.render.id_pass import Region
from modsim3d.truth.polygon_occlusion import Polygons

ROUNDING_PX = 1 / 128
"""Corners are rounded to 1/256 of a buffer pixel on each axis; half of that, along both, moves an edge by less."""


@dataclass(frozen=True, eq=False)
class PixelMasks:
    """The buffer pixels of one vessel.

    Attributes:
        region: Where the masks lie in the buffer; h and w are its height and width.
        silhouette: Pixels of the vessel drawn alone, shape (h, w).
        visible: Pixels of the vessel drawn with everything else, shape (h, w).
    """

    region: Region
    silhouette: Mask
    visible: Mask


def mask_box(mask: Mask, region: Region) -> Array:
    """Box x_min, y_min, x_max, y_max, shape (4,), around the true pixels of a mask that lies at a region.

    It is half-open: x_max is the column after the last. At least one pixel of the mask must be true.
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    left, top = columns[0] + region.x, rows[0] + region.y
    right, bottom = columns[-1] + 1 + region.x, rows[-1] + 1 + region.y
    return np.array([left, top, right, bottom], dtype=np.float64)


def counted_from(mask: Mask, region: Region, box_px: Array, count_px: float, supersample: int) -> bool:
    """Whether a box and a count, in image pixels, are those of a mask, shape (h, w), at a region of the buffer.

    A difference is not explained by pixels that are right if the truth was counted from other pixels. The box is x_min,
    y_min, x_max, y_max, shape (4,), and any if the mask is empty.
    """
    count = np.count_nonzero(mask)
    if count != round(count_px * supersample**2):
        return False
    return not count or bool(np.array_equal(mask_box(mask, region) / supersample, box_px))


def mask_fits(mask: Mask, region: Region, silhouette: shapely.Geometry, covers: Polygons, supersample: int) -> bool:
    """Whether each pixel is set if its centre is inside the exact region, and only then.

    Pixels in a band along the boundary may be set or not. The band is as wide as the rounding of corners.

    Args:
        mask: Pixels of the buffer, shape (h, w).
        region: Where the mask lies.
        silhouette: The exact silhouette, in image pixels.
        covers: The exact silhouettes of what may hide it, in image pixels, shape (k,).
        supersample: Buffer pixels per image pixel and axis.
    """
    columns = np.arange(region.x, region.x + region.width) + 0.5
    rows = np.arange(region.y, region.y + region.height) + 0.5
    x, y = np.meshgrid(columns / supersample, rows / supersample)
    band = ROUNDING_PX / supersample
    surely, perhaps = _within(silhouette, -band, x, y), _within(silhouette, band, x, y)
    for cover in covers:
        surely &= ~_within(cover, band, x, y)
        perhaps &= ~_within(cover, -band, x, y)
    return not ((surely & ~mask).any() or (mask & ~perhaps).any())


def _within(polygon: shapely.Geometry, band_px: float, x: Array, y: Array) -> Mask:
    """Whether points are in a polygon that was grown by a band (or shrunk, if it is negative), same shape."""
    grown = shapely.buffer(polygon, band_px)
    shapely.prepare(grown)
    inside: Mask = shapely.contains_xy(grown, x, y)
    return inside
