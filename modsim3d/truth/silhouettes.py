"""Silhouettes as polygons, not yet cut at the image edge: hulls of convex solids, unions of faces of other solids."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.arrays import Array, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.clipping import clip_triangles, near_plane
from modsim3d.vessels.vessel import Solid

NO_AREA_PX2 = 1e-9
"""A face with a smaller area is seen edge-on. It adds nothing to a silhouette, and its polygon would be invalid."""


def silhouette_polygons(
    intrinsics: Intrinsics, vertices: Array, pixels: Array, crosses: Mask, solid: Solid
) -> NDArray[np.object_]:
    """Whole silhouettes as polygons, cut at the near plane.

    Args:
        intrinsics: Intrinsics of the camera.
        vertices: Vertices of n solids in CCF, shape (n, K, 3).
        pixels: The same vertices projected, shape (n, K, 2).
        crosses: Whether the near plane cuts each solid, shape (n,).
        solid: Has the faces that the vertices span.

    Returns:
        Polygons, shape (n,).
    """
    polygons = np.empty(len(pixels), dtype=object)
    if not solid.convex:
        for row in range(len(pixels)):
            if crosses[row]:
                faces = cut_near(vertices[row][solid.faces], intrinsics, solid)
                polygons[row] = union_of(intrinsics.project(faces))
            else:
                polygons[row] = union_of(pixels[row][solid.faces], both_sides=not solid.closed)
        return polygons
    polygons[~crosses] = shapely.convex_hull(shapely.multipoints(pixels[~crosses]))
    for row in np.flatnonzero(crosses).tolist():
        clipped = cut_near(vertices[row][solid.faces], intrinsics, solid)
        polygons[row] = shapely.convex_hull(shapely.multipoints(intrinsics.project(clipped.reshape(-1, 3))))
    return polygons


def in_image(silhouettes: NDArray[np.object_], intrinsics: Intrinsics) -> NDArray[np.object_]:
    """The parts of silhouettes that are in the image, seen through the lens if it distorts, shape (n,).

    Args:
        silhouettes: Polygons in the image of the camera's pinhole, shape (n,).
        intrinsics: Intrinsics of the camera.
    """
    seen: NDArray[np.object_] = shapely.intersection(silhouettes, _image(intrinsics.pinhole))
    if intrinsics.distortion is None:
        return seen

    def bend(points_px: Array) -> Array:
        # Each distinct point is computed once: the first and the last of a ring must stay exactly equal.
        points, which = np.unique(points_px, axis=0, return_inverse=True)
        return intrinsics.through_lens(points)[which.reshape(-1)]

    bent = shapely.transform(shapely.segmentize(seen, intrinsics.chord_px), bend)
    return np.asarray(shapely.intersection(shapely.make_valid(bent), _image(intrinsics)))


def share_in_image(silhouettes: NDArray[np.object_], intrinsics: Intrinsics) -> Array:
    """Share of each silhouette's area (n,) that is in the image, measured before the lens distorts it, shape (n,)."""
    image = _image(intrinsics)
    if intrinsics.distortion is not None:
        border = intrinsics.image_border()
        seen = intrinsics.unproject(border, np.full(len(border), intrinsics.near_clip_m))
        image = shapely.Polygon(intrinsics.pinhole.project(seen))
    share: Array = shapely.area(shapely.intersection(silhouettes, image)) / shapely.area(silhouettes)
    return share


def _image(intrinsics: Intrinsics) -> shapely.Polygon:
    return shapely.box(0, 0, *map(float, intrinsics.image_size_px))


def union_of(triangles_px: Array, *, both_sides: bool = True) -> shapely.Geometry:
    """The region that triangles cover together.

    Args:
        triangles_px: Projected triangles, shape (T, 3, 2).
        both_sides: Whether triangles turned away from the camera count. Those of a closed solid add nothing.
    """
    a, b, c = np.moveaxis(triangles_px, 1, 0)
    # Rows run downwards: the area of a face turned to the camera is positive this way round.
    doubled = (b - a)[:, 1] * (c - a)[:, 0] - (b - a)[:, 0] * (c - a)[:, 1]
    return shapely.union_all(shapely.polygons(triangles_px[(np.abs(doubled) if both_sides else doubled) > NO_AREA_PX2]))


def cut_near(triangles_camera: Array, intrinsics: Intrinsics, solid: Solid) -> Array:
    """The triangles of a solid beyond the near plane, and the section that closes it there if it was closed.

    Without the section the camera would look into the solid, and see the faces of what touches it from behind.

    Args:
        triangles_camera: Faces of the solid in CCF, shape (T, 3, 3).
        intrinsics: Intrinsics of the camera.
        solid: Says whether it is closed and convex.

    Returns:
        Triangles in CCF, shape (T', 3, 3).
    """
    near = intrinsics.near_clip_m
    clipped = clip_triangles(triangles_camera, near_plane(intrinsics))
    # A corner that the cut puts on the plane is off it by a rounding error.
    clipped[..., 2][clipped[..., 2] < near * (1 + 1e-9)] = near
    if not solid.closed:
        return clipped
    section = _convex_section(clipped, near) if solid.convex else _section(clipped, near)
    return np.concatenate([clipped, section])


def _convex_section(clipped: Array, near: float) -> Array:
    """A fan of triangles between the corners on the near plane, shape (k, 3, 3)."""
    section = np.unique(clipped[clipped[..., 2] == near], axis=0)
    offset = section - section.mean(axis=0) if len(section) else section
    around = section[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    fan = [[around[0], around[i], around[i + 1]] for i in range(1, len(around) - 1)]
    return np.array(fan).reshape(-1, 3, 3)


def _section(clipped: Array, near: float) -> Array:
    """Triangles that fill what the edges on the near plane enclose, except holes, shape (k, 3, 3)."""
    on_plane = clipped[..., 2] == near
    cut = clipped[on_plane.sum(axis=1) == 2]
    if not len(cut):
        return np.empty((0, 3, 3))
    ends = cut[on_plane[on_plane.sum(axis=1) == 2]].reshape(-1, 2, 3)[..., :2]
    filled = shapely.build_area(shapely.node(shapely.multilinestrings(shapely.linestrings(ends))))
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(filled))
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    return np.concatenate([corners, np.full((len(corners), 3, 1), near)], axis=-1)
