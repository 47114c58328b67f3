"""Whether the rendered truth agrees with the analytic truth of the same outlines, and if it does not, why. The rendered
source counts pixels of exact spans, and of ID buffers with a depth test. The analytic source cuts polygons by polygons,
in an order that comes from separating planes. They may differ only because pixels sample regions at their centres.
Where they differ by more than a pixel, all pixels of the vessel are drawn again and checked. A pixel must be set where
its centre is inside the exact region, and nowhere else, except in a band along the boundary as wide as the rasteriser's
rounding of corners. The box and the count of the truth must be those of these pixels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth.analytic import (
    PixelMasks,
    VisibleRegions,
    boundary_pixels,
    counted_from,
    mask_fits,
    occlusion_of_regions,
    visible_regions,
)
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines


class Agreement(IntEnum):
    """Whether two sources agree on a vessel, or why they do not. The greater, the worse."""

    AGREE = 0
    SHARP_TIP = 1
    SLIVER = 2
    BOUNDARY_ROUNDING = 3
    INTERSECTING = 4
    UNEXPLAINED = 5


EXPLANATIONS = {
    Agreement.AGREE: "agree within a pixel",
    Agreement.SHARP_TIP: "sharp tip without a pixel centre",
    Agreement.SLIVER: "sliver thinner than a pixel",
    Agreement.BOUNDARY_ROUNDING: "boundary rounding",
    Agreement.INTERSECTING: "left to pixels: no plane between two hulls",
    Agreement.UNEXPLAINED: "unexplained",
}

DrawMasks = Callable[[int], PixelMasks]  # draws the masks of a row of the outlines


@dataclass(frozen=True, eq=False)
class Comparison(Columns):
    """Differences of two sources on n outlines, rendered minus analytic."""

    full_side_px: Array  # sides of full boxes, shape (n, 4)
    visible_side_px: Array  # sides of visible boxes; NaN where either has none, shape (n, 4)
    fraction: Array  # visible fraction; NaN where either has none, shape (n,)
    fraction_bound: Array  # largest difference of fractions that pixels on the boundary can explain, shape (n,)
    seen_differs: Mask  # whether the vessel is visible to one source only, shape (n,)
    full: Indices  # `Agreement` of the full boxes, shape (n,)
    visible: Indices  # `Agreement` of visible boxes, visible fractions and visibility, shape (n,)
    pixels_looked_at: Mask  # whether all pixels of the row were checked, shape (n,)

    @property
    def worst(self) -> Indices:
        """The worse `Agreement` of full and visible, shape (n,)."""
        return np.maximum(self.full, self.visible)


def concatenate_comparisons(parts: Sequence[Comparison]) -> Comparison:
    """The rows of several comparisons, one after another."""
    empty, empty_sides, none = np.empty(0), np.empty((0, 4)), np.empty(0, dtype=np.int64)
    nothing = Comparison(empty_sides, empty_sides, empty, empty, none > 0, none, none, none > 0)
    return Comparison.join([nothing, *parts])


def compare_with_analytic(
    outlines: Outlines, intrinsics: Intrinsics, rendered: Occlusion, draw_masks: DrawMasks, supersample: int = 1
) -> Comparison:
    """Compare rendered with analytic truth, with a row for each vessel in the outlines. `rendered` has all rows of
    `outlines`, which both sources start from; `draw_masks` is called with rows where they differ by more than a pixel;
    `supersample` are buffer pixels per image pixel and axis."""
    regions = visible_regions(outlines, intrinsics)
    analytic = occlusion_of_regions(outlines, regions)
    full_side = rendered.full_boxes_px - analytic.full_boxes_px
    visible_side = rendered.visible_boxes_px - analytic.visible_boxes_px
    fraction = rendered.visible_fraction() - analytic.visible_fraction()
    bound = fraction_bound(regions, analytic, supersample)
    seen_differs = (rendered.visible_px > 0) != (analytic.visible_px > 0)
    intersecting = np.zeros(len(outlines), dtype=bool)
    intersecting[analytic.intersecting.ravel()] = True
    explained_px = boundary_pixels(regions.silhouettes, supersample) / supersample**2
    full_off = _off(full_side, supersample) | (np.abs(rendered.silhouette_px - analytic.silhouette_px) > explained_px)
    visible_off = _off(visible_side, supersample) | seen_differs | (np.abs(fraction) > bound)
    full_off, visible_off = full_off & outlines.boxed, visible_off & ~intersecting & outlines.boxed
    full = np.zeros(len(outlines), dtype=np.int64)
    visible = np.where(intersecting, int(Agreement.INTERSECTING), 0)
    check = _PixelCheck(regions, rendered, analytic, supersample)
    for row in np.flatnonzero(full_off | visible_off).tolist():
        masks = draw_masks(row)
        if full_off[row]:
            full[row] = check.full(row, masks)
        if visible_off[row]:
            # A visible box that is short by what the full box is short by misses the silhouette's own tip.
            tip = np.array_equal(visible_side[row], full_side[row])
            visible[row] = check.visible(row, masks, Agreement.SHARP_TIP if tip else Agreement.SLIVER)
    looked_at = full_off | visible_off
    found = Comparison(full_side, visible_side, fraction, bound, seen_differs, full, visible, looked_at)
    return found.take(np.flatnonzero(outlines.boxed))


def _off(sides_px: Array, supersample: int) -> Mask:
    """Whether a side (n, 4) is off by more than a buffer pixel, shape (n,)."""
    return np.asarray(np.any(np.abs(sides_px) > 1 / supersample, axis=1))


@dataclass(frozen=True, eq=False)
class _PixelCheck:
    """Explains the differences of a row from its pixels."""

    regions: VisibleRegions
    rendered: Occlusion
    analytic: Occlusion
    supersample: int

    def full(self, row: int, masks: PixelMasks) -> Agreement:
        """Reason why the full boxes differ."""
        silhouettes = self.regions.silhouettes
        mask = masks.silhouette, masks.region
        fits = self._full_counted(row, masks) and mask_fits(*mask, silhouettes[row], silhouettes[:0], self.supersample)
        boxes = self.rendered.full_boxes_px[row], self.analytic.full_boxes_px[row]
        return _agreement(fits, *boxes, if_smaller=Agreement.SHARP_TIP)

    def visible(self, row: int, masks: PixelMasks, if_smaller: Agreement) -> Agreement:
        """Reason why the visible boxes or fractions differ."""
        silhouettes, box, px = self.regions.silhouettes, self.rendered.visible_boxes_px[row], self.rendered.visible_px
        covers = silhouettes[self.regions.hiding.hiders_of(row)]
        mask = masks.visible, masks.region
        counted = self._full_counted(row, masks) and counted_from(*mask, box, px[row], self.supersample)
        fits = counted and mask_fits(*mask, silhouettes[row], covers, self.supersample)
        return _agreement(fits, box, self.analytic.visible_boxes_px[row], if_smaller)

    def _full_counted(self, row: int, masks: PixelMasks) -> bool:
        box, px = self.rendered.full_boxes_px[row], self.rendered.silhouette_px[row]
        return counted_from(masks.silhouette, masks.region, box, px, self.supersample)


def _agreement(fits: bool, rendered_px: Array, analytic_px: Array, if_smaller: Agreement) -> Agreement:
    """Reason why two boxes (4,) differ, given whether the pixels fit the exact region. `if_smaller` is the reason if
    the box from pixels lies inside the exact one."""
    if not fits:
        return Agreement.UNEXPLAINED
    nothing_drawn, nothing_exact = bool(np.isnan(rendered_px[0])), bool(np.isnan(analytic_px[0]))
    outside = np.concatenate([analytic_px[:2] - rendered_px[:2], rendered_px[2:] - analytic_px[2:]])
    larger = (nothing_exact and not nothing_drawn) or bool(np.any(outside > 1))
    return Agreement.BOUNDARY_ROUNDING if larger else if_smaller


def fraction_bound(regions: VisibleRegions, analytic: Occlusion, supersample: int) -> Array:
    """The greatest difference of visible fractions that boundary pixels can explain, shape (n,). A region of area A is
    counted as N pixels, and |N − A| is less than the number B of pixels on its boundary. With areas S of the silhouette
    and V of its visible part, the fraction from pixels therefore lies between (V − B_V) / (S + B_S) and (V + B_V) /
    (S − B_S)."""
    scale = supersample**2
    whole, seen = analytic.silhouette_px * scale, analytic.visible_px * scale
    edge, seen_edge = (boundary_pixels(r, supersample) for r in (regions.silhouettes, regions.visible))
    fraction = analytic.visible_fraction()
    least = np.maximum(seen - seen_edge, 0) / (whole + edge)
    greatest = np.where(whole > edge, (seen + seen_edge) / np.maximum(whole - edge, 1e-9), 1.0)
    return np.maximum(fraction - least, np.minimum(greatest, 1.0) - fraction)
