"""Silhouettes as polygons, not yet cut at the image edge: hulls of convex solids, unions of faces of other solids."""

from __future__ import annotations

from functools import cache
from typing import TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.unions import union_of
from modsim3d.truth.cutting import cut_near
from modsim3d.vessels.vessel import Solid

NO_AREA_PX2 = 1e-9
"""A face with a smaller area is seen edge-on. It adds nothing to a silhouette, and its polygon would be invalid."""
Number = TypeVar("Number", np.float64, np.int64)


def silhouette_polygons(
    intrinsics: Intrinsics, vertices: Array, pixels: Array, crosses: Mask, solid: Solid
) -> NDArray[np.object_]:
    """Whole silhouettes of n solids as polygons, cut at the near plane, shape (n,).

    Args:
        intrinsics: Intrinsics of the camera.
        vertices: In CCF, shape (n, K, 3).
        pixels: The same vertices projected, shape (n, K, 2).
        crosses: Whether the near plane cuts each solid, shape (n,).
        solid: Has the faces that the vertices span.
    """
    polygons = np.empty(len(pixels), dtype=object)
    if solid.convex:
        polygons[~crosses] = shapely.convex_hull(shapely.linestrings(pixels[~crosses]))
    else:
        for row in np.flatnonzero(~crosses).tolist():
            polygons[row] = faces_union(pixels[row][solid.faces], both_sides=not solid.closed)
    if not crosses.any():
        return polygons
    triangles, member = cut_near(vertices[crosses][:, solid.faces], intrinsics, solid)
    rows, clipped = np.flatnonzero(crosses).tolist(), intrinsics.project(triangles)
    for row, own in zip(rows, np.split(clipped, np.searchsorted(member, np.arange(1, len(rows)))), strict=False):
        if solid.convex:
            polygons[row] = shapely.convex_hull(shapely.multipoints(own.reshape(-1, 2)))
        else:
            polygons[row] = faces_union(own)
    return polygons


def in_image(silhouettes: NDArray[np.object_], intrinsics: Intrinsics) -> NDArray[np.object_]:
    """The parts of silhouettes, polygons in the pinhole's image, that are in the image, both of shape (n,).

    They are seen through the lens if it distorts.
    """
    seen: NDArray[np.object_] = shapely.intersection(silhouettes, _image(intrinsics.pinhole.image_size_px))
    if intrinsics.distortion is None:
        return seen

    def _bend(points_px: Array) -> Array:
        # Each distinct point is computed once: the first and the last of a ring must stay exactly equal.
        points, which = np.unique(points_px, axis=0, return_inverse=True)
        return intrinsics.through_lens(points)[which.reshape(-1)]

    bent = shapely.transform(shapely.segmentize(seen, intrinsics.chord_px), _bend)
    return np.asarray(shapely.intersection(shapely.make_valid(bent), _image(intrinsics.image_size_px)))


def share_in_image(silhouettes: NDArray[np.object_], inside: NDArray[np.object_], intrinsics: Intrinsics) -> Array:
    """Share of each silhouette's area that is in the image, measured before the lens distorts it, shape (n,).

    `inside` are the parts of the silhouettes (n,) that `in_image` gives.
    """
    if intrinsics.distortion is not None:
        border = intrinsics.image_border()
        seen = intrinsics.unproject(border, np.full(len(border), intrinsics.near_clip_m))
        inside = shapely.intersection(silhouettes, shapely.Polygon(intrinsics.pinhole.project(seen)))
    share: Array = shapely.area(inside) / shapely.area(silhouettes)
    return share


@cache
def _image(size_px: tuple[int, int]) -> shapely.Polygon:
    return shapely.box(0, 0, *map(float, size_px))


def doubled_areas(triangles_px: NDArray[Number]) -> NDArray[Number]:
    """Twice the signed areas of projected triangles, shape (..., 3, 2) to (...), in square units of the corners.

    They are positive if a triangle is turned to the camera, so that its corners run counter-clockwise seen from there.
    """
    (ax, ay), (bx, by) = (np.moveaxis(triangles_px[..., i, :] - triangles_px[..., 0, :], -1, 0) for i in (1, 2))
    areas: NDArray[Number] = ay * bx - ax * by  # pixel rows run downwards, which turns the sign
    return areas


def doubled_face_areas(vertices_px: Array, faces: Indices) -> Array:
    """`doubled_areas` of the faces (F, 3) of n solids from their projected vertices (n, K, 2), shape (n, F)."""
    (x, y), (a, b, c) = vertices_px.T.copy(), faces.T  # rows of a vertex each: they are taken faster than columns
    areas: Array = (y[b] - y[a]) * (x[c] - x[a]) - (x[b] - x[a]) * (y[c] - y[a])
    return areas.T


def faces_union(triangles_px: Array, *, both_sides: bool = True) -> shapely.Geometry:
    """The region that projected triangles, shape (T, 3, 2), cover together.

    Without `both_sides`, triangles turned away from the camera are left out; those of a closed solid add nothing.
    """
    doubled = doubled_areas(triangles_px)
    return union_of(shapely.polygons(triangles_px[(np.abs(doubled) if both_sides else doubled) > NO_AREA_PX2]))
