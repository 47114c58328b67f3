"""Solids that the near plane cuts: what is left of their faces, and the sections that close them there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices, Mask, ranges, run_starts
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.clipping import clip_triangles, near_plane
from modsim3d.vessels.vessel import Solid

PORTION_FACES = 20_000
"""Faces that are cut at once: few calls, but arrays that fit a cache."""


def cut_faces(
    vertices_camera: Array, crosses: Mask, intrinsics: Intrinsics, solid: Solid, *, in_image: bool = False
) -> Iterator[tuple[Array, Indices]]:
    """The faces of m solids, cut where the near plane crosses the solid, in portions of some of the solids.

    Args:
        vertices_camera: In CCF, shape (m, K, 3).
        crosses: Whether the near plane cuts each solid, shape (m,).
        intrinsics: Have the near plane.
        solid: Has the faces that the vertices span.
        in_image: Close only the solids whose section may have a corner of the image in it. Of the others, nothing is
            in the image that is beyond the edges of the section.

    Yields:
        Triangles, shape (T, 3, 3), and the solid of each, shape (T,); those of one solid are in the order of its faces.
    """
    size = max(1, PORTION_FACES // len(solid.faces))
    for first in range(0, len(crosses), size):
        here = crosses[first : first + size]
        faces = vertices_camera[first : first + size][:, solid.faces]
        whole = np.repeat(first + np.flatnonzero(~here), len(solid.faces))
        triangles, member = cut_near(faces[here], intrinsics, solid, in_image=in_image)
        yield (
            np.concatenate([faces[~here].reshape(-1, 3, 3), triangles]),
            np.concatenate([whole, first + np.flatnonzero(here)[member]]),
        )


def cut_near(
    faces_camera: Array, intrinsics: Intrinsics, solid: Solid, *, in_image: bool = False
) -> tuple[Array, Indices]:
    """The faces of m solids beyond the near plane, and the section that closes each there if it was closed.

    Without the section the camera would look into the solid, and see the faces of what touches it from behind.

    Args:
        faces_camera: The F faces of each in CCF, shape (m, F, 3, 3).
        intrinsics: Have the near plane.
        solid: Says whether the solids are closed, and convex.
        in_image: See `cut_faces`.

    Returns:
        Triangles in CCF, shape (T, 3, 3), and the solid of each, ascending, shape (T,). A section comes last.
    """
    if not len(faces_camera):
        return np.empty((0, 3, 3)), np.empty(0, dtype=np.int64)
    near = intrinsics.near_clip_m
    clipped, face = clip_triangles(faces_camera.reshape(-1, 3, 3), near_plane(intrinsics))
    member = face // max(faces_camera.shape[1], 1)
    # A corner that the cut puts on the plane is off it by a rounding error.
    clipped[..., 2][clipped[..., 2] < near * (1 + 1e-9)] = near
    if not solid.closed:
        return clipped, member
    to_close = _corner_inside(clipped, member, intrinsics)[member] if in_image else np.ones(len(member), dtype=bool)
    sections = _convex_sections if solid.convex else _sections
    section, section_member = sections(clipped[to_close], member[to_close], near)
    members = np.concatenate([member, section_member])
    order = np.argsort(members, kind="stable")
    return np.concatenate([clipped, section])[order], members[order]


def _corner_inside(clipped: Array, member: Indices, intrinsics: Intrinsics) -> Mask:
    """Whether the section of each solid up to the last member may have a corner of the image in it.

    Then edges of the section are on all four sides of the corner.
    """
    (ends, of), count = _edges(clipped, member, intrinsics.near_clip_m), int(member.max(initial=-1)) + 1
    low, high = ends.min(axis=1), ends.max(axis=1)
    width, height = intrinsics.image_size_px
    corners_px = np.array([(0, 0), (width, 0), (0, height), (width, height)], dtype=np.float64)
    inside = np.zeros(count, dtype=bool)
    for corner in intrinsics.unproject(corners_px, np.full(4, intrinsics.near_clip_m))[:, :2]:
        beside = ((low <= corner) & (corner <= high))[:, ::-1]  # along the other axis
        sides = np.concatenate([beside & (low <= corner), beside & (corner <= high)], axis=1)
        inside |= np.all([np.bincount(of, side, minlength=count) > 0 for side in sides.T], axis=0)
    return inside


def _edges(clipped: Array, member: Indices, near: float) -> tuple[Array, Indices]:
    """The ends of the edges on the near plane, shape (k, 2, 2), and the solid of each, shape (k,)."""
    on_plane = clipped[..., 2] == near
    cut = on_plane.sum(axis=1) == 2
    return clipped[cut][on_plane[cut]].reshape(-1, 2, 3)[..., :2], member[cut]


def _convex_sections(clipped: Array, member: Indices, near: float) -> tuple[Array, Indices]:
    """Fans of triangles between the corners on the near plane, shape (k, 3, 3), and the solid of each, shape (k,)."""
    on_plane = clipped[..., 2] == near
    corners, of = clipped[on_plane], np.repeat(member, on_plane.sum(axis=1))
    order = np.lexsort((corners[:, 1], corners[:, 0], of))
    corners, of = corners[order], of[order]
    distinct = np.ones(len(of), dtype=bool)
    distinct[1:] = (np.diff(of) != 0) | (np.diff(corners[:, :2], axis=0) != 0).any(axis=1)
    corners, of = corners[distinct], of[distinct]
    first = run_starts(of)
    count = np.bincount(of)[of[first]]
    centre = np.stack([np.bincount(of, corners[:, i])[of] for i in (0, 1)], axis=1) / np.repeat(count, count)[:, None]
    offset = corners[:, :2] - centre
    around = np.lexsort((np.arctan2(offset[:, 1], offset[:, 0]), of))
    triangles = np.maximum(count - 2, 0)
    start, second = np.repeat(first, triangles), ranges(first + 1, triangles)
    return corners[around[np.stack([start, second, second + 1], axis=1)]], of[start]


def _sections(clipped: Array, member: Indices, near: float) -> tuple[Array, Indices]:
    """Triangles that fill what the edges on the near plane enclose, except holes; see `_convex_sections`."""
    ends, of = _edges(clipped, member, near)
    members, which = np.unique(of, return_inverse=True)
    lines = shapely.multilinestrings(shapely.linestrings(ends), indices=which)
    filled = shapely.build_area(shapely.node(lines))
    pieces, solid = shapely.get_parts(shapely.constrained_delaunay_triangles(filled), return_index=True)
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    return np.concatenate([corners, np.full((len(corners), 3, 1), near)], axis=-1), members[solid]
