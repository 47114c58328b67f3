"""The triangles that are drawn for outlines, in pixels, clipped where OpenGL would have to cut them itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.clipping import clip_triangles, guard_planes
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.silhouettes import cut_near
from modsim3d.truth.subdivision import subdivided

GUARD_PX = 2048.0
"""Triangles that reach further beyond the image are clipped there in double precision before they are drawn. It is in
buffer pixels, because it keeps corners inside the viewport, beyond which OpenGL would cut edges itself."""
LENS_GUARD_PX = 1.0
"""The same for a lens that distorts. Points far outside its image must not be projected: the lens formula could fold
them back into the image."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """What is drawn for the rows of `Outlines`: T triangles, ordered by row.

    Attributes:
        row: Row of the outlines, shape (T,).
        corners_px: Corners in image pixels, shape (T, 3, 2).
        inverse_depth: near / c3 of the corners, in (0, 1], shape (T, 3).
        of_whole: Whether the triangle is a face of a closed solid that is not clipped, shape (T,).
    """

    row: Indices
    corners_px: Array
    inverse_depth: Array
    of_whole: Mask

    def take(self, chosen: Mask) -> Triangles:
        """The chosen triangles."""
        return Triangles(self.row[chosen], self.corners_px[chosen], self.inverse_depth[chosen], self.of_whole[chosen])


def within_guard(outlines: Outlines, intrinsics: Intrinsics, supersample: int = 1, guard_px: float = GUARD_PX) -> Mask:
    """Whether each row can be drawn without clipping, shape (n,).

    It can if its vertices are in front of the near plane and not far outside the image, and the lens keeps straight
    edges straight.

    Args:
        outlines: Bodies in front of the camera, n rows.
        intrinsics: Intrinsics of the camera.
        supersample: Buffer pixels per image pixel and axis.
        guard_px: How far outside the image vertices may be, in buffer pixels.
    """
    guard, size = guard_px / supersample, np.array(intrinsics.image_size_px)
    inside = np.zeros(len(outlines), dtype=bool)
    if intrinsics.distortion is not None:
        return inside  # every face is bent
    for part in outlines.parts:
        near = (part.vertices_px >= -guard) & (part.vertices_px <= size + guard)  # false for NaN
        inside[part.rows] = np.all(near, axis=(1, 2))
    return inside


def triangles_of(
    outlines: Outlines, intrinsics: Intrinsics, supersample: int = 1, guard_px: float = GUARD_PX
) -> Triangles:
    """The triangles of all rows in image pixels, clipped at the near plane and well outside the image.

    Args:
        outlines: Bodies in front of the camera.
        intrinsics: Intrinsics of the camera.
        supersample: Buffer pixels per image pixel and axis.
        guard_px: How far outside the image triangles may reach, in buffer pixels; `LENS_GUARD_PX` if the lens distorts.
    """
    inside = within_guard(outlines, intrinsics, supersample, guard_px)
    bent = intrinsics.distortion is not None
    guard = guard_planes(intrinsics.pinhole, LENS_GUARD_PX if bent else guard_px / supersample)
    row, whole, corners = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=bool)], [np.empty((0, 3, 3))]
    for part in outlines.parts:
        uncut, faces = inside[part.rows], part.solid.faces
        row.append(np.repeat(part.rows[uncut], len(faces)))
        whole.append(np.full(len(row[-1]), part.solid.closed))
        corners.append(part.vertices_camera[uncut][:, faces].reshape(-1, 3, 3))
        for member in np.flatnonzero(~uncut):
            camera = part.vertices_camera[member][faces]
            if outlines.crosses_near[part.rows[member]]:
                camera = cut_near(camera, intrinsics, part.solid)
            clipped = clip_triangles(camera, guard)
            if bent:
                clipped = subdivided(clipped, intrinsics.pinhole, intrinsics.chord_px / supersample**0.5)
            clipped[..., 2] = np.maximum(clipped[..., 2], intrinsics.near_clip_m)
            row.append(np.full(len(clipped), part.rows[member]))
            whole.append(np.zeros(len(clipped), dtype=bool))
            corners.append(clipped)
    rows = np.concatenate(row)
    order = np.argsort(rows, kind="stable")
    ordered = np.concatenate(corners)[order]
    return Triangles(
        rows[order],
        intrinsics.project(ordered),
        intrinsics.near_clip_m / ordered[..., 2],
        np.concatenate(whole)[order],
    )
