"""Vessels in front of a camera: their solids in camera coordinates, projected, clipped, boxed.

This is corner projection: exact for convex solids, and it needs no renderer. Both the analytic and the rendered
source start from it; only the rendered one then asks the pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.camera import CameraPoses, Intrinsics, clip_triangles, guard_planes, near_plane
from modsim3d.frames import Array
from modsim3d.vessels import Solid, Vessel, shoebox

GUARD_PX = 2048.0
"""Triangles that reach further beyond the image are cut there, in double precision, before they are drawn. Counted in
buffer pixels, as it keeps corners where OpenGL does not cut them itself."""

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Outlines:
    """n vessels whose silhouettes overlap the image, in order of frame and vessel.

    Attributes:
        frame: Index into the run of frames, shape (n,).
        vessel: Index into the scene's vessels, shape (n,).
        vertices_camera: Of the solid, in CCF, shape (n, K, 3).
        vertices_px: Projected; NaN nearer than the near plane, shape (n, K, 2).
        boxes_px: Tight box of the silhouette, cut at the image edge, shape (n, 4).
        areas_px: Area of the silhouette in the image, shape (n,).
        in_frame_fraction: Area in the image over whole area; NaN where the near plane cuts, shape (n,).
        depth_m: Mean c3 of the corner points, shape (n,).
        crosses_near: Whether the near plane cuts the solid, shape (n,).
        solid: The faces that the vertices span.
    """

    frame: Indices
    vessel: Indices
    vertices_camera: Array
    vertices_px: Array
    boxes_px: Array
    areas_px: Array
    in_frame_fraction: Array
    depth_m: Array
    crosses_near: NDArray[np.bool_]
    solid: Solid

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)


def corners_world(vessels: Sequence[Vessel], positions_m: Array, world_R_vessel: Array, solid: Solid) -> Array:
    """Vertices of the vessels' solids in the world (Jessen & Mohr (2023), eq. 7.1).

    Args:
        vessels: V of them.
        positions_m: Shape (S, V, 3).
        world_R_vessel: Rotations VCF to WCF, shape (S, V, 3, 3).
        solid: In units of length, beam and air draft.

    Returns:
        Shape (S, V, K, 3).
    """
    extents = np.array([vessel.extents_m for vessel in vessels])
    body = solid.vertices * extents[:, None, :]
    turned = body @ np.swapaxes(world_R_vessel, -1, -2)
    corners: Array = turned + positions_m[:, :, None, :]
    return corners


def outline(
    intrinsics: Intrinsics,
    camera_poses: CameraPoses,
    vessels: Sequence[Vessel],
    present: NDArray[np.bool_],
    positions_m: Array,
    world_R_vessel: Array,
) -> Outlines:
    """Project all vessels at S steps and keep those whose silhouette overlaps the image.

    Args:
        intrinsics: Of the camera.
        camera_poses: S poses.
        vessels: V of them.
        present: Which are to be looked at, shape (S, V).
        positions_m: Shape (S, V, 3).
        world_R_vessel: Rotations VCF to WCF, shape (S, V, 3, 3).
    """
    solid = shoebox()
    camera = camera_poses.to_camera(corners_world(vessels, positions_m, world_R_vessel, solid))
    in_front = camera[..., 2] >= intrinsics.near_clip_m
    frame, vessel = np.nonzero(present & in_front.any(axis=-1))
    vertices, behind = camera[frame, vessel], ~in_front[frame, vessel]
    crosses: NDArray[np.bool_] = np.any(behind, axis=-1)
    pixels = intrinsics.project(vertices)
    boxes = np.concatenate([_least(pixels), -_least(-pixels)], axis=-1)
    size = np.array(intrinsics.image_size_px, dtype=np.float64)
    touching = np.all((boxes[:, :2] < size) & (boxes[:, 2:] > 0), axis=1) | crosses
    areas = _projected_areas(pixels, solid)
    fractions = np.where(crosses, np.nan, 1.0)
    whole = np.all((boxes[:, :2] >= 0) & (boxes[:, 2:] <= size), axis=1) & ~crosses
    cut = np.flatnonzero(touching & ~whole)
    if len(cut):
        silhouettes = silhouette_polygons(intrinsics, vertices[cut], pixels[cut], crosses[cut], solid)
        inside = shapely.intersection(silhouettes, shapely.box(0, 0, *size))
        areas[cut] = shapely.area(inside)
        boxes[cut] = shapely.bounds(inside)
        fractions[cut] = np.where(crosses[cut], np.nan, areas[cut] / shapely.area(silhouettes))
    rows = np.flatnonzero(touching & (areas > 0))
    return Outlines(
        frame=frame[rows],
        vessel=vessel[rows],
        vertices_camera=vertices[rows],
        vertices_px=pixels[rows],
        boxes_px=boxes[rows],
        areas_px=areas[rows],
        in_frame_fraction=np.minimum(fractions[rows], 1.0),
        depth_m=vertices[rows, :, 2].mean(axis=-1),
        crosses_near=crosses[rows],
        solid=solid,
    )


def _least(pixels: Array) -> Array:
    """Least column and row of each vertex set; of those in front where the near plane cuts, shape (n, 2)."""
    least: Array = np.where(np.isnan(pixels), np.inf, pixels).min(axis=1)
    return least


def _projected_areas(pixels: Array, solid: Solid) -> Array:
    """Area of each silhouette: every ray that meets a convex solid meets two of its faces, shape (n,)."""
    a, b, c = np.moveaxis(pixels[:, solid.faces], 2, 0)
    doubled = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
    # In order of memory, or the sum is rounded differently for one silhouette and for many.
    areas: Array = np.ascontiguousarray(np.abs(doubled)).sum(axis=-1) / 4
    return areas


def silhouette_polygons(
    intrinsics: Intrinsics, vertices: Array, pixels: Array, crosses: NDArray[np.bool_], solid: Solid
) -> NDArray[np.object_]:
    """Whole silhouettes of convex solids as polygons, beyond the image too, cut at the near plane.

    Args:
        intrinsics: Of the camera.
        vertices: In CCF, shape (n, K, 3).
        pixels: The same projected, shape (n, K, 2).
        crosses: Whether the near plane cuts each, shape (n,).
        solid: Its faces.

    Returns:
        Polygons, shape (n,).
    """
    polygons = np.empty(len(pixels), dtype=object)
    polygons[~crosses] = shapely.convex_hull(shapely.multipoints(pixels[~crosses]))
    for row in np.flatnonzero(crosses):
        clipped = cut_near(vertices[row][solid.faces], intrinsics)
        polygons[row] = shapely.convex_hull(shapely.multipoints(intrinsics.project(clipped.reshape(-1, 3))))
    return polygons


def cut_near(triangles_camera: Array, intrinsics: Intrinsics) -> Array:
    """The triangles of a convex solid beyond the near plane, and the section that closes the solid there.

    Without the section one would look into the solid, and see the faces of what touches it from behind.

    Args:
        triangles_camera: In CCF, shape (T, 3, 3).
        intrinsics: Of the camera.

    Returns:
        Triangles in CCF, shape (T', 3, 3).
    """
    near = intrinsics.near_clip_m
    clipped = clip_triangles(triangles_camera, near_plane(intrinsics))
    # A corner put on the plane by the cut comes out a rounding error before or behind it.
    clipped[..., 2][clipped[..., 2] < near * (1 + 1e-9)] = near
    section = np.unique(clipped[clipped[..., 2] == near], axis=0)
    offset = section - section.mean(axis=0) if len(section) else section
    around = section[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    fan = [[around[0], around[i], around[i + 1]] for i in range(1, len(around) - 1)]
    return np.concatenate([clipped, np.array(fan).reshape(-1, 3, 3)])


@dataclass(frozen=True, eq=False)
class Triangles:
    """What is drawn for the rows of `Outlines`: T triangles, ordered by row.

    Attributes:
        row: Shape (T,).
        corners_px: Shape (T, 3, 2).
        inverse_depth: near / c3 in (0, 1], shape (T, 3).
    """

    row: Indices
    corners_px: Array
    inverse_depth: Array

    def take(self, chosen: NDArray[np.bool_]) -> Triangles:
        """The triangles chosen."""
        return Triangles(self.row[chosen], self.corners_px[chosen], self.inverse_depth[chosen])


def within_guard(outlines: Outlines, intrinsics: Intrinsics, supersample: int = 1) -> NDArray[np.bool_]:
    """Whether all vertices are in front of the near plane and not far outside the image, shape (n,)."""
    guard, size = GUARD_PX / supersample, np.array(intrinsics.image_size_px)
    near = (outlines.vertices_px >= -guard) & (outlines.vertices_px <= size + guard)  # NaN is not
    inside: NDArray[np.bool_] = np.all(near, axis=(1, 2))
    return inside


def triangles_of(outlines: Outlines, intrinsics: Intrinsics, supersample: int = 1) -> Triangles:
    """The triangles of all rows in image pixels, clipped at the near plane and well outside the image.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        supersample: Buffer pixels for each image pixel and axis.
    """
    camera = outlines.vertices_camera[:, outlines.solid.faces]
    inside = within_guard(outlines, intrinsics, supersample)
    faces = len(outlines.solid.faces)
    rows = [np.repeat(np.flatnonzero(inside), faces)]
    parts = [camera[inside].reshape(-1, 3, 3)]
    guard = guard_planes(intrinsics, GUARD_PX / supersample)
    for beyond in np.flatnonzero(~inside):
        beyond_near = cut_near(camera[beyond], intrinsics) if outlines.crosses_near[beyond] else camera[beyond]
        clipped = clip_triangles(beyond_near, guard)
        clipped[..., 2] = np.maximum(clipped[..., 2], intrinsics.near_clip_m)
        rows.append(np.full(len(clipped), beyond))
        parts.append(clipped)
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    corners = np.concatenate(parts)[order]
    return Triangles(row[order], intrinsics.project(corners), intrinsics.near_clip_m / corners[..., 2])
