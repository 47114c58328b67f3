"""Outlines: what a camera sees of each body by itself, as if nothing else were there. A vessel or obstacle has a
`Solid`, its shape. `Bodies` are solids with their size and place in the world at each step. `outline` moves their
vertices into camera coordinates, projects them, and keeps those that are in the image, with their boxes. That is exact
and needs no renderer. Every source of truth starts from it, and then says what hides what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Indices, Mask, run_starts
from modsim3d.geometry.camera import Intrinsics, clip_triangles, guard_planes
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.truth.silhouettes import cut_faces, doubled_face_areas, in_image, share_in_image, silhouette_polygons
from modsim3d.world.bodies import Bodies
from modsim3d.world.vessels import Solid

BESIDE = 1e-6  # metres times pixels by which a solid must be outside the image, beyond the reach of rounding errors
MAX_VERTICES = 12_000  # most vertices of bodies that are projected together: few calls, but arrays that fit a cache


@dataclass(frozen=True, eq=False)
class OutlinePart:
    """The m rows of `Outlines` whose solids have the same faces, and therefore vertices that form one array."""

    solid: Solid  # the faces that the vertices span
    rows: Indices  # row of each solid, ascending, so that those between two rows are found by bisection, shape (m,)
    vertices_camera: Array  # in CCF, in metres, shape (m, K, 3)
    vertices_px: Array  # in the image of the camera's pinhole; NaN nearer than the near plane, shape (m, K, 2)

    def take(self, chosen: Indices | Mask | slice) -> OutlinePart:
        """The solids that are chosen by ascending indices (k,), by a mask (m,), or by a slice, which copies nothing."""
        return OutlinePart(self.solid, self.rows[chosen], self.vertices_camera[chosen], self.vertices_px[chosen])


@dataclass(frozen=True, eq=False)
class Outlines:
    """Outlines in a camera's image: n rows, one for each frame and body there, in order of frame and occluder."""

    frame: Indices  # index into the run of frames, shape (n,)
    occluder: Indices  # index into the scene's occluder names, of which vessels come first, shape (n,)
    boxed: Mask  # whether it is a vessel that gets a box; an obstacle only hides, shape (n,)
    boxes_px: Array  # tight box of the silhouette, cut at the image edge, shape (n, 4)
    areas_px: Array  # area of the silhouette in the image; NaN for a solid that is not convex, shape (n,)
    in_frame_fraction: Array  # area in the image over whole area; NaN where the near plane cuts, shape (n,)
    depth_m: Array  # mean c3 of the corner points of the body's bounding box, shape (n,)
    crosses_near: Mask  # whether the near plane cuts the solid, shape (n,)
    parts: tuple[OutlinePart, ...]  # the solids of the rows, those with the same faces together

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    @property
    def convex(self) -> Mask:
        """Whether each solid is convex, shape (n,)."""
        convex = np.ones(len(self), dtype=bool)
        for part in self.parts:
            convex[part.rows] = part.solid.convex
        return convex

    def depths_m(self) -> tuple[Array, Array]:
        """Least and greatest c3 of each solid's vertices, both of shape (n,)."""
        nearest, farthest = np.empty((2, len(self)))
        for part in self.parts:
            depths_m = part.vertices_camera[..., 2].T.copy()  # many rows are compared faster than few vertices
            nearest[part.rows], farthest[part.rows] = depths_m.min(axis=0), depths_m.max(axis=0)
        return nearest, farthest

    def take(self, rows: Indices) -> Outlines:
        """The chosen rows, shape (k,), which ascend."""
        place = new_numbers(rows, len(self))
        parts = [part.take(place[part.rows] >= 0) for part in self.parts]
        return self._chosen(rows, [replace(part, rows=place[part.rows]) for part in parts])

    def between(self, first: int, stop: int) -> Outlines:
        """Rows first to stop − 1, which `take` would copy."""
        parts = [part.take(slice(*np.searchsorted(part.rows, (first, stop)).tolist())) for part in self.parts]
        return self._chosen(slice(first, stop), [replace(part, rows=part.rows - first) for part in parts])

    def _chosen(self, rows: Indices | slice, parts: Sequence[OutlinePart]) -> Outlines:
        """The chosen rows, whose solids are the parts, with the rows' new numbers."""
        columns = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return Outlines(**columns, parts=tuple(part for part in parts if len(part.rows)))


_OF_VERTICES = ("vertices_camera", "vertices_px")
_COLUMNS = ("frame", "occluder", "boxed", "boxes_px", "areas_px", "in_frame_fraction", "depth_m", "crosses_near")


def new_numbers(rows: Indices, count: int) -> Indices:
    """0, 1, … for the chosen rows, shape (k,), and −1 for the others, shape (count,)."""
    place = np.full(count, -1)
    place[rows] = np.arange(len(rows))
    return place


def outline(
    intrinsics: Intrinsics, camera_poses: CameraPoses, bodies: Sequence[Bodies], *, measured: bool = True
) -> Outlines:
    """Project all bodies at the steps of the camera's poses and keep those whose silhouettes overlap the image. Unless
    they are to be measured, areas and shares are NaN, and boxes are whole ones in the pinhole's image; of what the near
    plane cuts they are the whole image, and it may be outside."""
    pairs = [_outline(intrinsics, camera_poses, some, measured) for some in bodies]
    if len(pairs) == 1:  # they are in order
        ((columns, part),) = pairs
        return Outlines(**columns, parts=(part,) if len(part.rows) else ())
    columns = {name: np.concatenate([_NOTHING[name], *(columns[name] for columns, _ in pairs)]) for name in _COLUMNS}
    order = np.lexsort((columns["occluder"], columns["frame"]))
    place = new_numbers(order, len(order))
    parts, first = [], 0
    for _, part in pairs:
        rows = place[first : first + len(part.rows)]
        first += len(part.rows)
        ascending = np.argsort(rows)
        vertices, pixels = part.vertices_camera[ascending], part.vertices_px[ascending]
        parts.append(OutlinePart(part.solid, rows[ascending], vertices, pixels))
    parts = [part for part in parts if len(part.rows)]
    return Outlines(**{name: column[order] for name, column in columns.items()}, parts=tuple(parts))


_NOTHING = {
    **dict.fromkeys(("frame", "occluder"), np.empty(0, dtype=np.int64)),
    **dict.fromkeys(("boxed", "crosses_near"), np.empty(0, dtype=bool)),
    **dict.fromkeys(("areas_px", "in_frame_fraction", "depth_m"), np.empty(0)),
    "boxes_px": np.empty((0, 4)),
}


def _outline(
    intrinsics: Intrinsics, camera_poses: CameraPoses, bodies: Bodies, measured: bool
) -> tuple[dict[str, Any], OutlinePart]:
    """The columns of `Outlines` for bodies with the same faces, and the part that they form."""
    steps = max(1, MAX_VERTICES // bodies.vertices_m[..., 0].size)
    portions = [slice(first, first + steps) for first in range(0, len(bodies.present), steps)]
    pairs = [_portion(intrinsics, camera_poses.at(some), bodies.at(some), measured) for some in portions]
    if len(pairs) == 1:
        return pairs[0]
    for some, (columns, _) in zip(portions, pairs, strict=True):
        columns["frame"] += some.start
    parts = [part for _, part in pairs]
    vertices, pixels = (np.concatenate([getattr(part, name) for part in parts]) for name in _OF_VERTICES)
    joined = {name: np.concatenate([columns[name] for columns, _ in pairs]) for name in _COLUMNS}
    return joined, OutlinePart(bodies.solid, np.arange(len(vertices)), vertices, pixels)


def _portion(
    intrinsics: Intrinsics, camera_poses: CameraPoses, bodies: Bodies, measured: bool
) -> tuple[dict[str, Any], OutlinePart]:
    """Result of `_outline` for few enough steps."""
    solid, pinhole = bodies.solid, intrinsics.pinhole
    camera = camera_poses.to_camera(bodies.vertices_world())
    in_front = camera[..., 2] >= intrinsics.near_clip_m
    frame, body = np.nonzero(bodies.present & in_front.any(axis=-1))
    vertices, crosses = camera[frame, body], ~np.all(in_front[frame, body], axis=-1)
    pixels = pinhole.project(vertices)
    boxes, size = _boxes_of(pixels), np.array(pinhole.image_size_px, dtype=np.float64)
    touching: Mask = np.all((boxes[:, :2] < size) & (boxes[:, 2:] > 0), axis=1)
    if crosses.any():
        touching[crosses] = ~_beside_image(vertices[crosses], pinhole)
    frame, body, crosses, vertices, pixels, boxes = _chosen(touching, frame, body, crosses, vertices, pixels, boxes)
    if measured:
        boxes, areas, fractions = _measured(intrinsics, bodies, vertices, pixels, crosses, boxes)
    else:
        boxes[crosses] = [0, 0, *size]
        areas, fractions = np.full((2, len(boxes)), np.nan)
    frame, body, crosses, vertices, pixels, boxes, areas, fractions = _chosen(
        ~(areas <= 0), frame, body, crosses, vertices, pixels, boxes, areas, fractions
    )
    if solid.convex:
        depth = vertices[..., 2].mean(axis=-1)
    else:
        depth = camera_poses.to_camera(bodies.centres_world())[frame, body, 2]
    columns = {
        "frame": frame,
        "occluder": bodies.occluder[body],
        "boxed": np.full(len(frame), bodies.boxed),
        "boxes_px": boxes,
        "areas_px": areas,
        "in_frame_fraction": np.minimum(fractions, 1.0),
        "depth_m": depth,
        "crosses_near": crosses,
    }
    return columns, OutlinePart(solid, np.arange(len(frame)), vertices, pixels)


def _chosen(rows: Mask, *columns: Any) -> tuple[Any, ...]:
    """The rows of columns that a mask, shape (n,), chooses; the same arrays where all are chosen, as they often are."""
    return columns if rows.all() else tuple(column[rows] for column in columns)


def _measured(
    intrinsics: Intrinsics, bodies: Bodies, vertices: Array, pixels: Array, crosses: Mask, boxes: Array
) -> tuple[Array, Array, Array]:
    """Boxes in the image (n, 4), areas (n,) and shares (n,) of n solids, as `Outlines` has them. The area is 0 where
    the box of an obstacle shows that it is not in the image. `boxes` (n, 4) are around the pixels; for `vertices`,
    `pixels` and `crosses` see `silhouette_polygons`."""
    if not len(boxes):  # as in most steps of a live scene
        return boxes, np.empty(0), np.empty(0)
    solid, pinhole, boxes = bodies.solid, intrinsics.pinhole, boxes.copy()
    whole = np.all((boxes[:, :2] >= 0) & (boxes[:, 2:] <= pinhole.image_size_px), axis=1) & ~crosses
    cut: Mask = ~(whole & (intrinsics.distortion is None))
    areas, fractions = np.full(len(boxes), np.nan), np.where(cut, np.nan, 1.0)
    if solid.convex:
        areas[~cut] = _projected_areas(pixels[~cut], solid)
    if not cut.any():
        return boxes, areas, fractions
    # Of an obstacle only a box is needed, which may be too large. A mesh that the near plane cuts has no share.
    box_only = cut & (crosses & (not solid.convex and intrinsics.distortion is None) | (not bodies.boxed))
    if box_only.any():
        boxes[box_only] = _boxes_in_image(vertices[box_only], crosses[box_only], intrinsics, solid, bodies.boxed)
        areas[box_only & ~(boxes[:, :2] < boxes[:, 2:]).all(axis=1)] = 0.0
    rest = cut & ~box_only
    if rest.any():
        silhouettes = silhouette_polygons(pinhole, vertices[rest], pixels[rest], crosses[rest], solid)
        inside = in_image(silhouettes, intrinsics)
        boxes[rest], areas[rest] = shapely.bounds(inside), shapely.area(inside)
        fractions[rest] = np.where(crosses[rest], np.nan, share_in_image(silhouettes, inside, intrinsics))
    return boxes, areas, fractions


def _beside_image(vertices_camera: Array, intrinsics: Intrinsics) -> Mask:
    """Whether solids, shape (n, K, 3), are as a whole to the left or right of the image, above or below it."""
    outside = vertices_camera @ guard_planes(intrinsics, 0.0)[:, :3].T < -BESIDE
    beside: Mask = np.any(np.all(outside, axis=1), axis=1)
    return beside


def _boxes_in_image(vertices_camera: Array, crosses: Mask, intrinsics: Intrinsics, solid: Solid, tight: bool) -> Array:
    """Boxes (n, 4) around what n solids show in the image; (inf, inf, −inf, −inf) for nothing. Those that need not be
    `tight` may differ by rounding errors. For the other arguments see `cut_faces`."""
    pinhole = intrinsics.pinhole
    boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (len(crosses), 1))
    for faces, member in cut_faces(vertices_camera, crosses, pinhole, solid, in_image=not tight):
        seen, face = clip_triangles(faces, guard_planes(pinhole, 0.0))
        pixels, of = np.clip(pinhole.project(seen), 0, pinhole.image_size_px), member[face]
        order = np.argsort(of, kind="stable")
        pixels, of = pixels[order], of[order]
        first = run_starts(of)
        boxes[of[first], :2] = np.minimum.reduceat(pixels.min(axis=1), first)
        boxes[of[first], 2:] = np.maximum.reduceat(pixels.max(axis=1), first)
    if intrinsics.distortion is not None:
        filled = np.all(boxes[:, :2] < boxes[:, 2:], axis=1)
        boxes[filled] = shapely.bounds(in_image(shapely.box(*boxes[filled].T), intrinsics))
    return boxes


def _boxes_of(pixels: Array) -> Array:
    """Boxes around the projected vertices (n, K, 2) of n solids; those that are NaN are left out, shape (n, 4)."""
    by_vertex = pixels.T.copy()  # many rows at a time are compared faster than few vertices
    return np.concatenate([np.fmin.reduce(by_vertex, axis=1), np.fmax.reduce(by_vertex, axis=1)]).T.copy()


def _projected_areas(pixels: Array, solid: Solid) -> Array:
    """Areas of silhouettes from projected vertices, shape (n, K, 2) to (n,), in square pixels: half the area of the
    projected faces, as a ray through a convex solid meets two of them."""
    doubled = doubled_face_areas(pixels, solid.faces)
    # The sum is rounded in order of memory, which must be the same for one silhouette as for many.
    areas: Array = np.ascontiguousarray(np.abs(doubled)).sum(axis=-1) / 4
    return areas


INSIDE = 2 * np.pi  # a closed mesh subtends the whole sphere of 4π at a point inside, and 0 at a point outside
MAX_TRIANGLES = 30_000  # most triangles times points that are looked at together; more leave the processor's cache


def first_body_around(cameras_m: Array, bodies: Sequence[Bodies]) -> tuple[int, int] | None:
    """The first frame in which a camera, at positions in WCF at S steps, shape (S, 3), is inside one of the bodies, and
    that body, as an index into the scene's occluder names; None if the camera is always outside."""
    hits = []
    for some in bodies:
        offsets = cameras_m[:, None, None, :] - some.positions_m[:, :, None, :]
        places = (offsets @ some.world_R_body)[:, :, 0, :]  # in the frame of each body
        low, high = some.vertices_m.min(axis=1), some.vertices_m.max(axis=1)
        within = np.all((places > low) & (places < high), axis=-1) & some.present
        for body in np.flatnonzero(within.any(axis=0)).tolist():
            frames, triangles = np.flatnonzero(within[:, body]), some.vertices_m[body][some.solid.faces]
            for some_frames in np.array_split(frames, -(-len(frames) * len(triangles) // MAX_TRIANGLES)):
                inside = np.abs(solid_angle(places[some_frames, body], triangles)) > INSIDE
                hits += [(frame, int(some.occluder[body])) for frame in some_frames[inside][:1].tolist()]
    return min(hits, default=None)


def solid_angle(points: Array, triangles: Array) -> Array:
    """Steradians that oriented triangles, shape (T, 3, 3), subtend at points, shape (..., 3) to (...). They are ±4π
    inside a closed mesh and 0 outside. A. van Oosterom and J. Strackee, "The solid angle of a plane triangle", IEEE
    Transactions on Biomedical Engineering 30 (1983)."""
    a, b, c = np.moveaxis(triangles - points[..., None, None, :], -2, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=-1) for corner in (a, b, c))
    volume = np.einsum("...i,...i->...", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("...i,...i->...", p, q) for p, q in ((a, b), (b, c), (c, a)))
    angle: Array = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=-1)
    return angle
