"""Truth from geometry alone, without a renderer: exact occlusion of solids whose hulls do not intersect. The visible
region of a vessel is its silhouette minus the silhouettes of the solids that can hide it. Areas and boxes are exact,
not rounded to pixels. Where no plane is between the convex hulls of two solids, they have no order, and what is visible
of them is unknown (NaN)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.kinematics import union_of
from modsim3d.render.id_pass import Region
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.occlusion_order import Order, order_of, overlapping_pairs
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.silhouettes import in_image, silhouette_polygons

NOTHING_PX2 = 1e-6  # smaller regions are rounding errors of cutting one polygon by another

Polygons = NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class Hiders:
    """Pairs of rows of which one may hide the other, ordered by the hidden row; shapes (m,)."""

    hidden: Indices  # row that may be hidden, non-decreasing
    hiders: Indices  # row that may hide it

    @classmethod
    def of(cls, hidden: Indices, hiders: Indices) -> Hiders:
        """Sort pairs: `hiders[k]` may hide `hidden[k]`; both of shape (m,)."""
        ascending = np.lexsort((hiders, hidden))
        return cls(hidden[ascending], hiders[ascending])

    def hiders_of(self, row: int) -> Indices:
        """Rows that may hide a row, ascending, shape (k,)."""
        return self.hiders[slice(*np.searchsorted(self.hidden, (row, row + 1)))]


def subtract(polygons: Polygons, rows: Indices, covers: Polygons) -> Polygons:
    """Polygons, shape (n,), minus all that covers them, shape (n,). Cover k of the m `covers` is subtracted from
    polygon rows[k]; `rows`, shape (m,), do not decrease. Each round subtracts one cover from every polygon."""
    left = polygons.copy()
    turn = np.arange(len(rows)) - np.searchsorted(rows, rows)
    for k in range(int(turn.max(initial=-1)) + 1):
        now = turn == k
        left[rows[now]] = shapely.difference(left[rows[now]], covers[now])
    return left


def visible_of(silhouettes: Polygons, hiding: Hiders) -> Polygons:
    """Visible part of each silhouette (n,), shape (n,)."""
    return subtract(silhouettes, hiding.hidden, silhouettes[hiding.hiders])


def boxes_and_areas(visible: Polygons, full_boxes_px: Array, full_areas_px: Array) -> tuple[Array, Array]:
    """Bounding boxes (NaN where nothing is) and areas of visible regions (n,), shapes (n, 4) and (n,). Where nothing is
    hidden, they are the boxes and areas given for the whole silhouettes."""
    areas: Array = shapely.area(visible)
    seen, whole = areas > NOTHING_PX2, areas >= full_areas_px - NOTHING_PX2
    boxes = np.where(whole[:, None], full_boxes_px, np.where(seen[:, None], shapely.bounds(visible), np.nan))
    return boxes, np.where(whole, full_areas_px, np.where(seen, areas, 0.0))


def hidden_areas(silhouettes: Polygons, hiding: Hiders, occluder: Indices, ties: Hiders | None = None) -> Array:
    """Area that each hider hides of each hidden row, in square pixels, for the m pairs of `hiding`, shape (m,). Every
    hidden point is counted for the front-most solid there. A hider's part is therefore what the two silhouettes share,
    minus the silhouettes of everything that may hide the hider. What several pieces of an obstacle, of one index in
    `occluder` (n,), hide together is entered for the first of them; the others get zero. `ties` are pairs that overlap
    but have no order: the hider of a pair counts as the one in front, so that what both hide of a third row is counted
    once."""
    shared = shapely.intersection(silhouettes[hiding.hidden], silhouettes[hiding.hiders])
    rows: list[int] = []
    covers: list[int] = []
    for k, (hidden, hider) in enumerate(zip(hiding.hidden.tolist(), hiding.hiders.tolist(), strict=True)):
        in_front = [row for row in hiding.hiders_of(hider).tolist() if row != hidden]
        if ties is not None:
            in_front += sorted(set(ties.hiders_of(hider).tolist()) & set(hiding.hiders_of(hidden).tolist()))
        rows += [k] * len(in_front)
        covers += in_front
    parts = subtract(shared, np.array(rows, dtype=np.int64), silhouettes[covers])
    pairs = np.stack([hiding.hidden, occluder[hiding.hiders]], axis=1)
    _, first, piece_of, pieces = np.unique(pairs, axis=0, return_index=True, return_inverse=True, return_counts=True)
    piece_of = piece_of.reshape(-1)
    areas: Array = np.where(pieces[piece_of] == 1, shapely.area(parts), 0.0)
    for group in np.flatnonzero(pieces > 1).tolist():
        areas[first[group]] = shapely.area(union_of(parts[piece_of == group]))
    return areas


def hidden_by(hiding: Hiders, areas_px: Array, occluder: Indices) -> HiddenPixels:
    """Pixels of each row that others hide, from the areas of `hidden_areas`, shape (m,), without rounding errors."""
    real = areas_px > NOTHING_PX2
    return HiddenPixels.of(hiding.hidden[real], occluder[hiding.hiders[real]], areas_px[real])


def boundary_pixels(regions: Polygons, supersample: int) -> Array:
    """Number of buffer pixels that the boundary of each region can cross: |dx| + |dy| + 2 for each edge, shape (n,).
    Only these pixels can be counted otherwise than by their share of the area, each by less than one. Regions are
    polygons in image pixels, shape (n,)."""
    rings, row = shapely.get_parts(shapely.boundary(regions), return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    steps = np.abs(np.diff(points, axis=0)).sum(axis=1) * supersample + 2
    steps[ring[1:] != ring[:-1]] = 0.0
    return np.bincount(row[ring[1:]], steps, minlength=len(regions)).astype(np.float64)


@dataclass(frozen=True, eq=False)
class VisibleRegions:
    """Silhouettes in the image and what is visible of them, as polygons."""

    silhouettes: Polygons  # whole ones, cut at the image edge, shape (n,)
    visible: Polygons  # their visible parts, shape (n,)
    hiding: Hiders  # which rows can hide which
    order: Order  # of solids, which `hiding` follows from


def visible_regions(outlines: Outlines, intrinsics: Intrinsics) -> VisibleRegions:
    """Visible part of each solid: its silhouette minus those of the solids that can hide it."""
    silhouettes = image_silhouettes(outlines, intrinsics)
    order = order_of(outlines)
    one, other = order.first_can_hide, order.second_can_hide
    hidden = np.concatenate([order.second[one], order.first[other]])
    hiding = Hiders.of(hidden, np.concatenate([order.first[one], order.second[other]]))
    return VisibleRegions(silhouettes, visible_of(silhouettes, hiding), hiding, order)


def analytic_occlusion(outlines: Outlines, intrinsics: Intrinsics) -> Occlusion:
    """Full and visible boxes, areas and occluders of solids."""
    return occlusion_of_regions(outlines, visible_regions(outlines, intrinsics))


def occlusion_of_regions(outlines: Outlines, regions: VisibleRegions) -> Occlusion:
    """Boxes, areas and occluders of regions that are already cut; see `analytic_occlusion`."""
    order, finite = regions.order, ~np.isnan(outlines.areas_px)
    areas_px = np.where(finite, outlines.areas_px, shapely.area(regions.silhouettes))
    boxes, visible_px = boxes_and_areas(regions.visible, outlines.boxes_px, areas_px)
    touching = np.column_stack([order.first, order.second])[order.intersecting]
    farther = touching[np.arange(len(touching)), np.argmax(outlines.depth_m[touching], axis=1)]
    ties = Hiders.of(farther, touching.sum(axis=1) - farther) if len(touching) else None
    pairs = touching[outlines.boxed[touching].any(axis=1)]  # a bridge may stand on a quay
    boxes[pairs.ravel()], visible_px[pairs.ravel()] = np.nan, np.nan
    areas = hidden_areas(regions.silhouettes, regions.hiding, outlines.occluder, ties)
    return Occlusion(
        full_boxes_px=outlines.boxes_px,
        visible_boxes_px=boxes,
        silhouette_px=areas_px,
        visible_px=visible_px,
        hidden=hidden_by(regions.hiding, areas, outlines.occluder),
        intersecting=pairs,
    )


def image_silhouettes(outlines: Outlines, intrinsics: Intrinsics) -> Polygons:
    """The silhouette of each row as a polygon, cut at the image edge, shape (n,)."""
    silhouettes = np.empty(len(outlines), dtype=object)
    for part in outlines.parts:
        corners, crosses = (part.vertices_camera, part.vertices_px), outlines.crosses_near[part.rows]
        silhouettes[part.rows] = silhouette_polygons(intrinsics.pinhole, *corners, crosses, part.solid)
    cut = ~(outlines.in_frame_fraction == 1.0) | (intrinsics.distortion is not None)
    silhouettes[cut] = in_image(silhouettes[cut], intrinsics)
    return silhouettes


def rectangle_occlusion(outlines: Outlines) -> Occlusion:
    """Occlusion of vessels' boxes by vessels' boxes; pixel counts are areas of rectangles."""
    rectangles = shapely.box(*outlines.boxes_px.T)
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    both = outlines.boxed[first] & outlines.boxed[second]
    first, second = first[both], second[both]
    nearer = outlines.depth_m[first] < outlines.depth_m[second]
    farther = outlines.depth_m[first] > outlines.depth_m[second]  # of equal depth, neither hides the other
    hidden, hiders = (np.concatenate([a[nearer], b[farther]]) for a, b in ((second, first), (first, second)))
    hiding = Hiders.of(hidden, hiders)
    equal = ~(nearer | farther)
    ties = Hiders.of(second[equal], first[equal]) if equal.any() else None
    areas = shapely.area(rectangles)
    boxes, visible_px = boxes_and_areas(visible_of(rectangles, hiding), outlines.boxes_px, areas)
    return Occlusion(
        full_boxes_px=outlines.boxes_px,
        visible_boxes_px=boxes,
        silhouette_px=areas,
        visible_px=visible_px,
        hidden=hidden_by(hiding, hidden_areas(rectangles, hiding, outlines.occluder, ties), outlines.occluder),
    )


ROUNDING_PX = 1 / 128  # corners are rounded to 1/256 of a buffer pixel on each axis; half of that moves an edge by less


@dataclass(frozen=True, eq=False)
class PixelMasks:
    """The buffer pixels of one vessel."""

    region: Region  # where the masks lie in the buffer; h and w are its height and width
    silhouette: Mask  # pixels of the vessel drawn alone, shape (h, w)
    visible: Mask  # pixels of the vessel drawn with everything else, shape (h, w)


def mask_box(mask: Mask, region: Region) -> Array:
    """Box x_min, y_min, x_max, y_max, shape (4,), around the true pixels of a mask that lies at a region. It is
    half-open: x_max is the column after the last. At least one pixel of the mask must be true."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    left, top = columns[0] + region.x, rows[0] + region.y
    right, bottom = columns[-1] + 1 + region.x, rows[-1] + 1 + region.y
    return np.array([left, top, right, bottom], dtype=np.float64)


def counted_from(mask: Mask, region: Region, box_px: Array, count_px: float, supersample: int) -> bool:
    """Whether a box and a count, in image pixels, are those of a mask, shape (h, w), at a region of the buffer. A
    difference is not explained by pixels that are right if the truth was counted from other pixels. The box is x_min,
    y_min, x_max, y_max, shape (4,), and any if the mask is empty."""
    count = np.count_nonzero(mask)
    if count != round(count_px * supersample**2):
        return False
    return not count or bool(np.array_equal(mask_box(mask, region) / supersample, box_px))


def mask_fits(mask: Mask, region: Region, silhouette: shapely.Geometry, covers: Polygons, supersample: int) -> bool:
    """Whether each pixel of a mask (h, w) at a region of the buffer is set if its centre is inside the exact region,
    and only then. Pixels in a band along the boundary, as wide as the rounding of corners, may be set or not. The exact
    silhouette and those (k,) of what may hide it are in image pixels, each of `supersample` buffer pixels per axis."""
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


def visible_areas(outlines: Outlines, intrinsics: Intrinsics, supersample: int) -> tuple[Array, Array]:
    """The area of the visible part of each row, and by how much its pixels may differ, both (n,) in image pixels. NaN
    where geometry does not tell: meshes, what overlaps one in the image, and solids that intersect. Only pixels on a
    boundary, of the silhouette or of its visible part, may count otherwise than by their share of the area."""
    areas, bounds = np.full((2, len(outlines)), np.nan)
    convex = np.flatnonzero(outlines.convex)
    some = outlines.take(convex)
    regions = visible_regions(some, intrinsics)
    areas[convex] = occlusion_of_regions(some, regions).visible_px
    boundaries = (boundary_pixels(shapes, supersample) for shapes in (regions.silhouettes, regions.visible))
    bounds[convex] = sum(boundaries) / supersample**2
    first, second = overlapping_pairs(outlines.frame, outlines.boxes_px)
    mesh = ~outlines.convex
    areas[first[mesh[second]]] = areas[second[mesh[first]]] = np.nan
    return areas, bounds
