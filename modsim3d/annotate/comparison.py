"""Does the rendered truth agree with the analytic one, and if not, why not.

Two independent computations look at the same outlines: an ID buffer with a depth buffer, and polygons cut by polygons
in an order that comes from separating planes. Pixels sample regions at their centres, so the two may differ by what
that sampling loses and by nothing else. Where a difference is larger than a pixel, every pixel of the vessel is looked
at: each one whose centre is inside the exact region must be set and each one outside must not be, but for a band along
the boundary that is as wide as the rasteriser's rounding of corners; and the box and the count in question must be
those of these pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.annotate.analytic import Regions, occlusion_of_regions, visible_regions
from modsim3d.annotate.occlusion import Occlusion
from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.separating_planes import overlapping_pairs
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.camera import Intrinsics

ROUNDING_PX = 1 / 128
"""Corners are rounded to 1/256 of a buffer pixel on each axis; half of that, along both, moves an edge by less."""


class Agreement(IntEnum):
    """Why two boxes differ, or that they do not; the worst of several is the greatest."""

    AGREE = 0
    SHARP_TIP = 1
    SLIVER = 2
    BOUNDARY_ROUNDING = 3
    INTERSECTING = 4
    NOT_COMPARABLE = 5
    UNEXPLAINED = 6


EXPLANATIONS = {
    Agreement.AGREE: "agree within a pixel",
    Agreement.SHARP_TIP: "sharp tip without a pixel centre",
    Agreement.SLIVER: "sliver thinner than a pixel",
    Agreement.BOUNDARY_ROUNDING: "boundary rounding",
    Agreement.INTERSECTING: "intersecting boxes: only the rendered source decides",
    Agreement.NOT_COMPARABLE: "not comparable: a mesh is there, or before it",
    Agreement.UNEXPLAINED: "unexplained",
}


@dataclass(frozen=True, eq=False)
class PixelMasks:
    """The pixels of one vessel.

    Attributes:
        x: Column of the masks' left edge, in buffer pixels.
        y: Row of their top edge.
        silhouette: Of the vessel alone, shape (h, w).
        visible: Those that are seen, shape (h, w).
    """

    x: int
    y: int
    silhouette: Mask
    visible: Mask


LookAgain = Callable[[int], PixelMasks]
"""Draws a row of the outlines once more."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """How two sources differ on n outlines.

    Attributes:
        full_side_px: Rendered less analytic, side by side, shape (n, 4).
        visible_side_px: The same of the visible boxes; NaN where either has none, shape (n, 4).
        fraction: Rendered less analytic visible fraction; NaN where either has none, shape (n,).
        fraction_bound: What the boundary pixels of the silhouette and of its visible part can explain, shape (n,).
        seen_differs: Whether one sees the vessel and the other does not, shape (n,).
        full: `Agreement` of the full boxes, shape (n,).
        visible: `Agreement` of visible boxes, visible fractions and visibility, shape (n,).
        pixels_looked_at: Rows of which every pixel was checked, shape (n,).
    """

    full_side_px: Array
    visible_side_px: Array
    fraction: Array
    fraction_bound: Array
    seen_differs: Mask
    full: Indices
    visible: Indices
    pixels_looked_at: Mask

    def take(self, rows: Indices) -> Comparison:
        """The rows chosen."""
        return Comparison(*(getattr(self, field.name)[rows] for field in fields(self)))

    @property
    def worst(self) -> Indices:
        """The greater of a row's two verdicts, shape (n,)."""
        return np.maximum(self.full, self.visible)


def compare_with_analytic(
    outlines: Outlines,
    intrinsics: Intrinsics,
    rendered: Occlusion,
    look_again: LookAgain,
    supersample: int = 1,
) -> Comparison:
    """Compare rendered truth with the analytic one, vessel by vessel.

    The analytic source knows convex solids only: of a mesh, and of what is visible of a vessel in front of or behind
    one, it can say nothing.

    Args:
        outlines: What both looked at; n of its rows get a box.
        intrinsics: Of the camera.
        rendered: What the pixels said.
        look_again: Gives the masks of a row of `outlines`, where its boxes differ by more than a pixel.
        supersample: Buffer pixels for each image pixel and axis.
    """
    known = np.flatnonzero(outlines.convex)
    found = _compare_convex(
        outlines.take(known), intrinsics, rendered.take(known), lambda row: look_again(int(known[row])), supersample
    )
    if len(known) == len(outlines):
        return found.take(np.flatnonzero(outlines.boxed))
    return _with_meshes(found, known, outlines).take(np.flatnonzero(outlines.boxed))


def _with_meshes(found: Comparison, known: Indices, outlines: Outlines) -> Comparison:
    """The comparison of some rows as one of all; the others, and what is seen of those beside them, are not known."""
    count, unknown = len(outlines), ~outlines.convex
    columns = {}
    for field in fields(Comparison):
        column = getattr(found, field.name)
        nothing = np.nan if column.dtype == np.float64 else 0
        whole = np.full((count, *column.shape[1:]), nothing, dtype=column.dtype)
        whole[known] = column
        columns[field.name] = whole
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    beside = np.zeros(count, dtype=bool)
    beside[first[unknown[second]]] = beside[second[unknown[first]]] = True
    columns["full"][unknown] = columns["visible"][unknown | beside] = Agreement.NOT_COMPARABLE
    columns["seen_differs"] &= ~beside
    columns["visible_side_px"][beside] = columns["fraction"][beside] = np.nan
    return Comparison(**columns)


def _compare_convex(
    outlines: Outlines, intrinsics: Intrinsics, rendered: Occlusion, look_again: LookAgain, supersample: int
) -> Comparison:
    regions = visible_regions(outlines, intrinsics)
    analytic = occlusion_of_regions(outlines, regions)
    full_side = rendered.full_boxes_px - analytic.full_boxes_px
    visible_side = rendered.visible_boxes_px - analytic.visible_boxes_px
    fraction = rendered.visible_fraction() - analytic.visible_fraction()
    bound = fraction_bound(regions, analytic, supersample)
    seen_differs = (rendered.visible_px > 0) != (analytic.visible_px > 0)
    unordered = np.zeros(len(outlines), dtype=bool)
    unordered[analytic.intersecting.ravel()] = True
    pixel = 1 / supersample
    full_off = np.any(np.abs(full_side) > pixel, axis=1)
    full_off |= np.abs(rendered.silhouette_px - analytic.silhouette_px) > (
        boundary_pixels(regions.silhouettes, supersample) / supersample**2
    )
    visible_off = np.any(np.abs(visible_side) > pixel, axis=1) | seen_differs | (np.abs(fraction) > bound)
    visible_off &= ~unordered
    full_off, visible_off = full_off & outlines.boxed, visible_off & outlines.boxed
    full = np.zeros(len(outlines), dtype=np.int64)
    visible = np.where(unordered, int(Agreement.INTERSECTING), 0)
    nobody = regions.silhouettes[:0]
    for row in np.flatnonzero(full_off | visible_off):
        masks = look_again(int(row))
        same = counted_from(
            masks.silhouette, masks, rendered.full_boxes_px[row], rendered.silhouette_px[row], supersample
        )
        if full_off[row]:
            fits = same and mask_fits(masks.silhouette, masks, regions.silhouettes[row], nobody, supersample)
            full[row] = _agreement(fits, rendered.full_boxes_px[row], analytic.full_boxes_px[row], Agreement.SHARP_TIP)
        if visible_off[row]:
            covers = regions.silhouettes[regions.hiding.hiders_of(int(row))]
            same &= counted_from(
                masks.visible, masks, rendered.visible_boxes_px[row], rendered.visible_px[row], supersample
            )
            fits = same and mask_fits(masks.visible, masks, regions.silhouettes[row], covers, supersample)
            # A box that is short of what the silhouette's own tip takes is short by that tip.
            kind = Agreement.SHARP_TIP if np.array_equal(visible_side[row], full_side[row]) else Agreement.SLIVER
            visible[row] = _agreement(fits, rendered.visible_boxes_px[row], analytic.visible_boxes_px[row], kind)
    return Comparison(full_side, visible_side, fraction, bound, seen_differs, full, visible, full_off | visible_off)


def _agreement(fits: bool, rendered_box: Array, analytic_box: Array, smaller: Agreement) -> int:
    """Why a box differs although, or because, its pixels do (not) fit the exact region."""
    if not fits:
        return Agreement.UNEXPLAINED
    nothing_drawn, nothing_exact = bool(np.isnan(rendered_box[0])), bool(np.isnan(analytic_box[0]))
    outside = np.concatenate([analytic_box[:2] - rendered_box[:2], rendered_box[2:] - analytic_box[2:]])
    larger = (nothing_exact and not nothing_drawn) or bool(np.any(outside > 1))
    return Agreement.BOUNDARY_ROUNDING if larger else smaller


def counted_from(mask: Mask, place: PixelMasks, box_px: Array, count_px: float, supersample: int) -> bool:
    """Whether a box and a count are those of a mask: pixels that are right explain nothing if other ones were counted.

    Args:
        mask: Shape (h, w), in buffer pixels.
        place: Where the mask lies.
        box_px: x_min, y_min, x_max, y_max in image pixels; not looked at if the mask is empty.
        count_px: In image pixels.
        supersample: Buffer pixels for each image pixel and axis.
    """
    if np.count_nonzero(mask) != round(count_px * supersample**2):
        return False
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return True
    columns, rows = columns + place.x, rows + place.y
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1])
    return bool(np.array_equal(box / supersample, box_px))


def mask_fits(
    mask: Mask, place: PixelMasks, silhouette: shapely.Geometry, covers: NDArray[np.object_], supersample: int
) -> bool:
    """Whether every pixel is set or not as its centre says, outside a narrow band along every boundary.

    Args:
        mask: Shape (h, w), in buffer pixels.
        place: Where the mask lies.
        silhouette: Exact, in image pixels.
        covers: Exact silhouettes of what can hide it, in image pixels, shape (k,).
        supersample: Buffer pixels for each image pixel and axis.
    """
    height, width = mask.shape
    columns, rows = np.arange(width) + place.x + 0.5, np.arange(height) + place.y + 0.5
    x, y = np.meshgrid(columns / supersample, rows / supersample)
    band = ROUNDING_PX / supersample
    surely = _within(silhouette, -band, x, y)
    perhaps = _within(silhouette, band, x, y)
    for cover in covers:
        surely &= ~_within(cover, band, x, y)
        perhaps &= ~_within(cover, -band, x, y)
    return not ((surely & ~mask).any() or (mask & ~perhaps).any())


def _within(polygon: shapely.Geometry, band_px: float, x: Array, y: Array) -> Mask:
    """Whether points are in a polygon that was grown by a band (or shrunk, if it is negative)."""
    grown = shapely.buffer(polygon, band_px)
    shapely.prepare(grown)
    inside: Mask = shapely.contains_xy(grown, x, y)
    return inside


def boundary_pixels(regions: NDArray[np.object_], supersample: int) -> Array:
    """How many pixels the boundary of each region can cross: |dx| + |dy| + 2 for each edge, shape (n,).

    Only these can be counted otherwise than their share of the area, each by less than one.

    Args:
        regions: Polygons in image pixels, shape (n,).
        supersample: Buffer pixels for each image pixel and axis.
    """
    boundaries = shapely.boundary(regions)
    points, row = shapely.get_coordinates(boundaries, return_index=True)
    steps = np.abs(np.diff(points, axis=0)).sum(axis=1) * supersample + 2
    steps[row[1:] != row[:-1]] = 0.0
    crossed: Array = np.bincount(row[1:], steps, minlength=len(regions)).astype(np.float64)
    return crossed


def fraction_bound(regions: Regions, analytic: Occlusion, supersample: int) -> Array:
    """The greatest difference of visible fractions that boundary pixels can explain, shape (n,).

    With N pixels counted for an area of A, |N − A| is less than the number B of pixels on the boundary. The fraction
    then lies between (V − Bv) / (S + Bs) and (V + Bv) / (S − Bs).
    """
    scale = supersample**2
    whole, seen = analytic.silhouette_px * scale, analytic.visible_px * scale
    edge, seen_edge = (boundary_pixels(r, supersample) for r in (regions.silhouettes, regions.visible))
    fraction = analytic.visible_fraction()
    least = np.maximum(seen - seen_edge, 0) / (whole + edge)
    greatest = np.where(whole > edge, (seen + seen_edge) / np.maximum(whole - edge, 1e-9), 1.0)
    return np.maximum(fraction - least, np.minimum(greatest, 1.0) - fraction)
