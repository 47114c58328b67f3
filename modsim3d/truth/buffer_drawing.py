"""The outlines of a run of frames in buffer pixels, drawn region by region."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask, extents, ranges
from modsim3d.geometry.camera import Intrinsics, clip_triangles, guard_planes
from modsim3d.render.id_pass import IdRenderer, Ids, Region, Sheet
from modsim3d.truth.outlines import OutlinePart, Outlines
from modsim3d.truth.silhouettes import cut_faces, faces_towards

GUARD_PX = 2048.0
"""Triangles that reach further beyond the image are clipped there in double precision before they are drawn. It is in
buffer pixels, because it keeps corners inside the viewport, beyond which OpenGL would cut edges itself."""
LENS_GUARD_PX = 1.0
"""The same for a lens that distorts. Points far outside its image must not be projected: the lens formula could fold
them back into the image."""


@dataclass(frozen=True, eq=False)
class Triangles(Columns):
    """Drawn triangles of the rows of `Outlines`: T triangles, ordered by row."""

    row: Indices  # of the outlines, shape (T,)
    corners_px: Array  # in image pixels, shape (T, 3, 2)
    inverse_depth: Array  # near / c3 of the corners, in (0, 1], shape (T, 3)
    of_whole: Mask  # whether the triangle is a face of a closed solid that is not clipped, shape (T,)

    @classmethod
    def none(cls) -> Triangles:
        """No triangles."""
        nothing = np.empty(0, dtype=np.int64)
        return cls(nothing, np.empty((0, 3, 2)), np.empty((0, 3)), nothing.astype(bool))


def within_guard(outlines: Outlines, intrinsics: Intrinsics, supersample: int = 1, guard_px: float = GUARD_PX) -> Mask:
    """Whether each row can be drawn without clipping, shape (n,): its vertices are in front of the near plane and at
    most `guard_px` buffer pixels outside the image, and the lens keeps straight edges straight."""
    guard, size = guard_px / supersample, np.array(intrinsics.image_size_px)
    inside = np.zeros(len(outlines), dtype=bool)
    if intrinsics.distortion is not None:
        return inside  # every face is bent
    for part in outlines.parts:
        by_vertex = part.vertices_px.T.copy()  # many rows at a time are compared faster than few vertices
        low, high = by_vertex.min(axis=1).T, by_vertex.max(axis=1).T
        near = (low >= -guard) & (high <= size + guard)  # false for NaN
        inside[part.rows] = near.all(axis=1)
    return inside


def triangles_of(
    outlines: Outlines,
    intrinsics: Intrinsics,
    supersample: int = 1,
    guard_px: float = GUARD_PX,
    *,
    facing_only: bool = False,
) -> Triangles:
    """The triangles of all rows in image pixels, clipped at the near plane and well outside the image. They reach at
    most `guard_px` buffer pixels outside it, and `LENS_GUARD_PX` if the lens distorts. With `facing_only`, the faces of
    whole closed solids that are turned away from the camera are left out: the others hide them."""
    inside = within_guard(outlines, intrinsics, supersample, guard_px)
    pieces = [Triangles.none()]
    for part in outlines.parts:
        uncut = inside[part.rows]
        pieces.append(_uncut(part.take(uncut), intrinsics, supersample if facing_only and part.solid.closed else None))
        if not uncut.all():
            rest = part.take(~uncut)
            pieces += _clipped(rest, outlines.crosses_near[rest.rows], intrinsics, supersample, guard_px)
    triangles = Triangles.join(pieces)
    return triangles.take(np.argsort(triangles.row, kind="stable"))


def _uncut(part: OutlinePart, intrinsics: Intrinsics, supersample: int | None) -> Triangles:
    """The faces of solids that need no clipping; with `supersample`, those that are turned to the camera."""
    faces = part.solid.faces
    if supersample is None:
        chosen = np.ones((len(part.rows), len(faces)), dtype=bool)
    else:
        chosen = faces_towards(part.vertices_px * supersample, part.solid)
    member, face = np.nonzero(chosen)
    corner = (member[:, None], faces[face])
    depths = (intrinsics.near_clip_m / part.vertices_camera[..., 2])[corner]
    whole = np.full(len(member), part.solid.closed)
    return Triangles(part.rows[member], part.vertices_px[corner], depths, whole)


def _clipped(
    part: OutlinePart, crosses: Mask, intrinsics: Intrinsics, supersample: int, guard_px: float
) -> list[Triangles]:
    """The clipped faces of solids, of which the near plane crosses some, in portions."""
    bent = intrinsics.distortion is not None
    guard = guard_planes(intrinsics.pinhole, LENS_GUARD_PX if bent else guard_px / supersample)
    portions = []
    for triangles, member in cut_faces(part.vertices_camera, crosses, intrinsics, part.solid):
        clipped, source = clip_triangles(triangles, guard)
        if bent:
            clipped, piece_of = subdivided(clipped, intrinsics.pinhole, intrinsics.chord_px / supersample**0.5)
            source = source[piece_of]
        clipped[..., 2] = np.maximum(clipped[..., 2], intrinsics.near_clip_m)
        rows, depths = part.rows[member[source]], intrinsics.near_clip_m / clipped[..., 2]
        portions.append(Triangles(rows, intrinsics.project(clipped), depths, np.zeros(len(rows), dtype=bool)))
    return portions


def subdivided(triangles_camera: Array, intrinsics: Intrinsics, longest_px: float) -> tuple[Array, Indices]:
    """Surface of T triangles in front of the near plane, in CCF, shape (T, 3, 3), in T' pieces whose edges are at most
    `longest_px` long in the image of a pinhole camera, with the same orientation; and the triangle that each is a piece
    of, shape (T',). Whether an edge is halved depends on its own length only. Both triangles at an edge are therefore
    cut alike, and no gap opens between them."""
    waiting, source = triangles_camera, np.arange(len(triangles_camera))
    done, sources = [waiting[:0]], [source[:0]]
    while len(waiting):
        pixels = intrinsics.project(np.maximum(waiting, (-np.inf, -np.inf, intrinsics.near_clip_m)))
        # Edge i runs from corner i to corner i + 1.
        long = np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1) > longest_px
        count = long.sum(axis=1)
        done.append(waiting[count == 0])
        sources.append(source[count == 0])
        waiting = np.concatenate([_cut(waiting[count == k], long[count == k], k) for k in (1, 2, 3)])
        source = np.concatenate([np.tile(source[count == k], k + 1) for k in (1, 2, 3)])
    return np.concatenate(done), np.concatenate(sources)


def _cut(triangles: Array, long: Array, count: int) -> Array:
    """Triangles with `count` long edges each, cut at the middles of these edges."""
    # Turn each so that its edge 0 is the one long edge, or its edge 2 the one short edge.
    first = np.zeros(len(long), dtype=np.int64)
    if count == 1:
        first = long.argmax(axis=1)
    elif count == 2:
        first = (long.argmin(axis=1) + 1) % 3
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, turn[:, :, None], axis=1), 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = {
        1: ((a, ab, c), (ab, b, c)),
        2: ((ab, b, bc), (a, ab, bc), (a, bc, c)),
        3: ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)),
    }[count]
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])


TILE_PX = (8192, 4096)  # width and height of the largest buffer that is drawn at once; larger regions are tiled


def fits_a_buffer(size_px: tuple[int, int]) -> bool:
    """Whether a region of this width and height can be drawn at once."""
    return size_px[0] <= TILE_PX[0] and size_px[1] <= TILE_PX[1]


def tiles_of(region: Region) -> list[Region]:
    """A region in parts that can each be drawn at once."""
    return [
        Region(x, y, *TILE_PX).common(region)
        for y in range(region.y, region.y + region.height, TILE_PX[1])
        for x in range(region.x, region.x + region.width, TILE_PX[0])
    ]


@dataclass(frozen=True, eq=False)
class BufferDrawing:
    """Outlines, what draws them at `supersample` buffer pixels per image pixel and axis."""

    outlines: Outlines
    intrinsics: Intrinsics
    renderer: IdRenderer
    supersample: int

    @property
    def image(self) -> Region:
        """The whole image, in buffer pixels."""
        width, height = self.intrinsics.image_size_px
        return Region(0, 0, width * self.supersample, height * self.supersample)

    @cached_property
    def pixel_boxes(self) -> Array:
        """The smallest boxes of whole buffer pixels that contain the silhouettes, shape (n, 4)."""
        boxes = self.outlines.boxes_px * self.supersample
        return np.concatenate([np.floor(boxes[:, :2]), np.ceil(boxes[:, 2:])], axis=1)

    def draw(self, rows: Indices, counts: Indices, sheet: Sheet) -> Ids:
        """Row + 1 at each pixel of a buffer with several regions, zero where nothing is, shape (height, width). `rows`
        (m,) are to be drawn in the first region, in the second and so on, as many in each of the k regions of the
        sheet, in buffer pixels, as `counts` (k,) say."""
        drawn, number = np.unique(rows, return_inverse=True)
        triangles = triangles_of(self.outlines.take(drawn), self.intrinsics, self.supersample, facing_only=True)
        first, count = extents(triangles.row, number)
        chosen = triangles.take(ranges(first, count))
        in_region = np.add.reduceat(count, np.cumsum(counts) - counts)
        corners = chosen.corners_px * self.supersample
        return self.renderer.draw_sheet(corners, chosen.inverse_depth, drawn[chosen.row] + 1, in_region, sheet)
