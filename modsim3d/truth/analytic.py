"""Truth from geometry alone, without a renderer: exact occlusion of solids whose hulls do not intersect.

The visible region of a vessel is its silhouette minus the silhouettes of the solids that can hide it. Areas and boxes
are exact, not rounded to pixels. Where no plane is between the convex hulls of two solids, they have no order, and what
is visible of them is unknown (NaN).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.occlusion_order import Order, order_of
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.polygon_occlusion import Hiding, Polygons, boxes_and_areas, hidden_areas, hidden_by, visible_of
from modsim3d.truth.silhouettes import in_image, silhouette_polygons


@dataclass(frozen=True, eq=False)
class VisibleRegions:
    """Silhouettes in the image and what is visible of them, as polygons.

    Attributes:
        silhouettes: Whole silhouettes, cut at the image edge, shape (n,).
        visible: Their visible parts, shape (n,).
        hiding: Which rows can hide which.
        order: The order of solids that `hiding` follows from.
    """

    silhouettes: Polygons
    visible: Polygons
    hiding: Hiding
    order: Order


def visible_regions(outlines: Outlines, intrinsics: Intrinsics) -> VisibleRegions:
    """What is visible of each solid: its silhouette minus those of the solids that can hide it."""
    silhouettes = image_silhouettes(outlines, intrinsics)
    order = order_of(outlines)
    hiding = Hiding.of(
        np.concatenate([order.second[order.first_can_hide], order.first[order.second_can_hide]]),
        np.concatenate([order.first[order.first_can_hide], order.second[order.second_can_hide]]),
    )
    return VisibleRegions(silhouettes, visible_of(silhouettes, hiding), hiding, order)


def analytic_occlusion(outlines: Outlines, intrinsics: Intrinsics) -> Occlusion:
    """Full and visible boxes, areas and occluders of solids."""
    return occlusion_of_regions(outlines, visible_regions(outlines, intrinsics))


def occlusion_of_regions(outlines: Outlines, regions: VisibleRegions) -> Occlusion:
    """Boxes, areas and occluders of regions that are already cut; see `analytic_occlusion`."""
    order, known = regions.order, ~np.isnan(outlines.areas_px)
    areas_px = np.where(known, outlines.areas_px, shapely.area(regions.silhouettes))
    boxes, visible_px = boxes_and_areas(regions.visible, outlines.boxes_px, areas_px)
    touching = np.column_stack([order.first, order.second])[order.intersecting]
    farther = touching[np.arange(len(touching)), np.argmax(outlines.depth_m[touching], axis=1)]
    ties = Hiding.of(farther, touching.sum(axis=1) - farther) if len(touching) else None
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
        crosses = outlines.crosses_near[part.rows]
        silhouettes[part.rows] = silhouette_polygons(
            intrinsics.pinhole, part.vertices_camera, part.vertices_px, crosses, part.solid
        )
    cut = ~(outlines.in_frame_fraction == 1.0) | (intrinsics.distortion is not None)
    silhouettes[cut] = in_image(silhouettes[cut], intrinsics)
    return silhouettes
