"""Silhouettes as polygons, not yet cut at the image edge: hulls of convex solids, unions of faces of other solids."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from typing import TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Columns, Indices, Mask, ranges, run_starts
from modsim3d.geometry.camera import Intrinsics, clip_triangles, near_plane
from modsim3d.geometry.kinematics import union_of
from modsim3d.render.id_pass import SUBPIXELS
from modsim3d.world.vessels import Solid, once_a_solid

PORTION_FACES = 20_000  # faces that are cut at once: few calls, but arrays that fit a cache


def cut_faces(
    vertices_camera: Array, crosses: Mask, intrinsics: Intrinsics, solid: Solid, *, in_image: bool = False
) -> Iterator[tuple[Array, Indices]]:
    """The faces of m solids, cut where the near plane crosses the solid, in portions of some of the solids.
    `vertices_camera` are in CCF, shape (m, K, 3), and span the faces of `solid`; `crosses` says which solids the near
    plane cuts, shape (m,). With `in_image`, only the solids are closed whose section may have a corner of the image in
    it: of the others, nothing is in the image that is beyond the edges of the section. Yields triangles, shape
    (T, 3, 3), and the solid of each, shape (T,); those of one solid are in the order of its faces."""
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
    """The faces of m solids beyond the near plane, and the section that closes each there if it was closed. Without the
    section the camera would look into the solid, and see the faces of what touches it from behind. `faces_camera` are
    the F faces of each in CCF, shape (m, F, 3, 3); for `in_image` see `cut_faces`. Returns triangles in CCF, shape
    (T, 3, 3), and the solid of each, ascending, shape (T,). A section comes last."""
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
    """Whether the section of each solid up to the last member may have a corner of the image in it: then edges of the
    section are on all four sides of the corner."""
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


NO_AREA_PX2 = 1e-9  # a smaller face is seen edge-on: it adds nothing to a silhouette, and its polygon would be invalid
Number = TypeVar("Number", np.float64, np.int64)


def silhouette_polygons(
    intrinsics: Intrinsics, vertices: Array, pixels: Array, crosses: Mask, solid: Solid
) -> NDArray[np.object_]:
    """Whole silhouettes of n solids as polygons, cut at the near plane, shape (n,). Vertices are in CCF, shape
    (n, K, 3), `pixels` are the same projected, shape (n, K, 2), and `crosses` says which solids the near plane cuts,
    shape (n,)."""
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
    """The parts of silhouettes, polygons in the pinhole's image, that are in the image, both of shape (n,). They are
    seen through the lens if it distorts."""
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
    """Share of each silhouette's area that is in the image, measured before the lens distorts it, shape (n,). `inside`
    are the parts of the silhouettes (n,) that `in_image` gives."""
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
    """Twice the signed areas of projected triangles, shape (..., 3, 2) to (...), in square units of the corners. They
    are positive if a triangle is turned to the camera, so that its corners run counter-clockwise seen from there."""
    (ax, ay), (bx, by) = (np.moveaxis(triangles_px[..., i, :] - triangles_px[..., 0, :], -1, 0) for i in (1, 2))
    areas: NDArray[Number] = ay * bx - ax * by  # pixel rows run downwards, which turns the sign
    return areas


def doubled_face_areas(vertices_px: Array, faces: Indices) -> Array:
    """`doubled_areas` of the faces (F, 3) of n solids from their projected vertices (n, K, 2), shape (n, F)."""
    (x, y), (a, b, c) = vertices_px.T.copy(), faces.T  # rows of a vertex each: they are taken faster than columns
    areas: Array = (y[b] - y[a]) * (x[c] - x[a]) - (x[b] - x[a]) * (y[c] - y[a])
    return areas.T


def faces_union(triangles_px: Array, *, both_sides: bool = True) -> shapely.Geometry:
    """The region that projected triangles, shape (T, 3, 2), cover together. Without `both_sides`, triangles turned away
    from the camera are left out; those of a closed solid add nothing."""
    doubled = doubled_areas(triangles_px)
    return union_of(shapely.polygons(triangles_px[(np.abs(doubled) if both_sides else doubled) > NO_AREA_PX2]))


@dataclass(frozen=True, eq=False)
class Spans(Columns):
    """Runs of pixels of n silhouettes; shapes (m,)."""

    row: Indices  # index of the silhouette
    y: Indices  # pixel row
    start: Indices  # first column
    stop: Indices  # the column after the last, greater than `start`

    @classmethod
    def none(cls) -> Spans:
        """No spans."""
        empty = np.empty(0, dtype=np.int64)
        return cls(empty, empty, empty, empty)

    def ordered(self) -> Spans:
        """The spans in order of silhouette."""
        return self.take(np.argsort(self.row, kind="stable"))

    def moved(self, dx: Indices | int, dy: Indices | int) -> Spans:
        """The spans moved right by dx and down by dy, each a number or of shape (m,)."""
        return Spans(self.row, self.y + dy, self.start + dx, self.stop + dx)


_FAR = np.iinfo(np.int64).max
_NO_BOX = np.array([np.inf, np.inf, -np.inf, -np.inf])


def counts_and_boxes(spans: Spans, count: int) -> tuple[Array, Array]:
    """Numbers of pixels, shape (n,), and bounding boxes, shape (n, 4), of n = `count` silhouettes; spans in any order.
    Boxes are half-open, [x_min, x_max) × [y_min, y_max), and (inf, inf, −inf, −inf) without a pixel."""
    # The first of the spans of one silhouette that follow each other: summed up first if they are several as a rule.
    first = run_starts(spans.row)
    several = 4 * len(first) < len(spans.row)
    row = spans.row[first] if several else spans.row

    def of_rows(reduce: np.ufunc, values: Indices) -> Indices:  # one value for each of `row`
        return reduce.reduceat(values, first) if several else values

    pixels: Array = np.bincount(row, of_rows(np.add, spans.stop - spans.start), minlength=count).astype(np.float64)
    low, high = np.full((2, count), _FAR), np.full((2, count), -1)
    for axis, (starts, stops) in enumerate(((spans.start, spans.stop), (spans.y, spans.y + 1))):
        np.minimum.at(low[axis], row, of_rows(np.minimum, starts))
        np.maximum.at(high[axis], row, of_rows(np.maximum, stops))
    boxes: Array = np.where(pixels > 0, np.concatenate([low, high]), _NO_BOX[:, None]).T.copy()
    return pixels, boxes


def runs_of_ids(ids: NDArray[np.uint32]) -> tuple[Indices, Indices]:
    """First place and ID of each run of equal IDs in the rows of an ID image (h, w), both of shape (k,)."""
    flat = ids.reshape(-1)
    begins = np.empty(flat.shape, dtype=bool)
    np.not_equal(flat[1:], flat[:-1], out=begins[1:])
    begins[:: ids.shape[1]] = True
    starts = np.flatnonzero(begins)
    return starts, flat[starts].astype(np.int64)


def spans_of_ids(ids: NDArray[np.uint32]) -> Spans:
    """The spans of the silhouettes in an ID image in which none hides another; ordered by scan line. An ID is the index
    of the silhouette + 1, zero where there is none, shape (h, w)."""
    starts, values = runs_of_ids(ids)
    stops = np.append(starts[1:], ids.size)
    filled = values > 0
    lines, first = np.divmod(starts[filled], ids.shape[1])
    return Spans(values[filled] - 1, lines, first, first + (stops - starts)[filled])


HALF = SUBPIXELS // 2
MAX_CROSSINGS = 200_000  # edges times scan lines that are computed at once; it bounds the memory


@once_a_solid
def edges_of(solid: Solid) -> Indices:
    """Start, end, left and right face of each edge of a closed solid, shape (4, E). The face on the left runs from
    start to end, that on the right from end to start. Where more than two faces meet, an edge comes more than once."""
    start, end = (solid.faces[:, corners].reshape(-1) for corners in ([0, 1, 2], [1, 2, 0]))
    number, face = solid.faces.max(initial=0) + 1, np.arange(len(start)) // 3
    forth, back = np.flatnonzero(start < end), np.flatnonzero(start > end)
    _, first, edge = np.unique((start * number + end)[forth], return_index=True, return_inverse=True)
    opposite = np.unique((end * number + start)[back], return_inverse=True)[1]
    forth, back = forth[np.argsort(first[edge], kind="stable")], back[np.argsort(first[opposite], kind="stable")]
    return np.stack([start[forth], end[forth], face[forth], face[back]])


def faces_towards(vertices_px: Array, solid: Solid) -> Mask:
    """Mask of the faces of n solids with rounded corners that are turned to the camera, shape (n, F). The vertices are
    in buffer pixels, shape (n, K, 2)."""
    return doubled_face_areas(np.rint(vertices_px * SUBPIXELS), solid.faces) > 0


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges between faces turned to the camera and faces turned away, ordered by silhouette."""

    row: Indices  # silhouette of each edge, shape (e,)
    upper: Array  # upper end on the grid, shape (e, 2)
    lower: Array  # lower end on the grid, shape (e, 2)
    step: Indices  # 1 if a face begins on its right, −1 if one ends there, shape (e,)
    first: Indices  # first scan line that it crosses, shape (e,)
    lines: Indices  # number of scan lines that it crosses, shape (e,)

    @classmethod
    def of(cls, vertices_px: Array, solid: Solid, height: int) -> _Edges:
        """Edges of n solids in an image of some height; the vertices are in buffer pixels, shape (n, K, 2)."""
        (start, end, left, right), grid = edges_of(solid), np.rint(vertices_px * SUBPIXELS)
        towards = faces_towards(vertices_px, solid)
        turn = towards[:, left].astype(np.int64) - towards[:, right]
        row, edge = np.nonzero(turn)
        tail, head, turn = grid[row, start[edge]], grid[row, end[edge]], turn[row, edge]
        down = head[:, 1] > tail[:, 1]
        upper, lower = np.where(down[:, None], tail, head), np.where(down[:, None], head, tail)
        # Pixel rows whose centre is at or below the upper end and above the lower: 256 y + 128 in [upper, lower).
        first, stop = (
            np.clip(np.ceil((end[:, 1] - HALF) / SUBPIXELS), 0, height).astype(np.int64) for end in (upper, lower)
        )
        return cls(row, upper, lower, np.where(down, turn, -turn), first, stop - first)

    def portions(self) -> list[_Edges]:
        """The edges of some silhouettes after the others."""
        if self.lines.sum() < MAX_CROSSINGS:
            return [self]
        crossings = np.cumsum(np.bincount(self.row, self.lines))
        limits = np.searchsorted(self.row, np.flatnonzero(np.diff(crossings // MAX_CROSSINGS)) + 1)
        columns = [np.split(getattr(self, field.name), limits) for field in fields(self)]
        return [_Edges(*some) for some in zip(*columns, strict=True)]

    def spans(self, width: int, height: int) -> Spans:
        """The spans between the edges in an image of some size."""
        which, y = np.repeat(np.arange(len(self.row)), self.lines), ranges(self.first, self.lines)
        (dx, dy), (x0, y0) = (self.lower - self.upper).T, self.upper.T
        # 256 dy times the crossing, counted from the centre of column 0, at line 0 and from one line to the next.
        at_zero, slope, scale = (HALF - y0) * dx + (x0 - HALF) * dy, SUBPIXELS * dx, SUBPIXELS * dy
        column = np.ceil((at_zero[which] + slope[which] * y) / scale[which])
        column = np.clip(column, 0, width).astype(np.int64)
        line = self.row[which] * height + y
        order = np.argsort(line * (width + 1) + column)
        line, column = line[order], column[order]
        covered = np.cumsum(self.step[which][order]) > 0  # the number is zero after the last edge of each line
        last = np.ones(len(line), dtype=bool)  # of the edges that cross a line in the same column
        last[:-1] = (np.diff(line) != 0) | (np.diff(column) != 0)
        line, column, covered = line[last], column[last], covered[last]
        border = np.diff(covered, prepend=False)
        row, y = np.divmod(line[border][::2], height)
        return Spans(row, y, column[border][::2], column[border][1::2])


def winding_spans(vertices_px: Array, solid: Solid, image_size_px: tuple[int, int]) -> Spans:
    """The spans of n closed solids inside an image. Projected vertices are all in front of the near plane, in buffer
    pixels like the width and height of the buffer, shape (n, K, 2)."""
    width, height = image_size_px
    return Spans.join([some.spans(width, height) for some in _Edges.of(vertices_px, solid, height).portions()])
