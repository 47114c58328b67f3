"""One frame drawn as ID buffers in the most obvious way: each corner projected, each triangle drawn, a depth test. A
corner x of a solid is at R · x + s in the world, at R_c · (x − s_c) in the camera and at K of that in the image. What
is nearer than the near plane is cut off, and the section there closes the solid again. What reaches far outside the
image is cut off too, since OpenGL would cut edges there itself and move them. Triangles that are turned away from the
camera are drawn as well: the depth test hides them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Columns, Indices, Mask, distinct, occurring
from modsim3d.geometry.camera import Intrinsics
from modsim3d.geometry.curved_sea import drop_m
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.world.bodies import Obstacle
from modsim3d.world.vessels import Solid, Vessel


@dataclass(frozen=True, eq=False)
class WorldTriangles(Columns):
    """T triangles, those of a solid together, in order of occluder."""

    corners_m: Array  # in WCF, shape (T, 3, 3)
    occluder: Indices  # index into the scene's occluder names of the solid of each, shape (T,)
    closed: Indices  # number of the closed solid that it bounds, 1 or more; 0 for a surface with holes, shape (T,)

    @classmethod
    def joined(cls, parts: Sequence[WorldTriangles]) -> WorldTriangles:
        """The triangles of several lists."""
        none = np.empty(0, dtype=np.int64)
        return cls.join([cls(np.empty((0, 3, 3)), none, none), *parts])

    @classmethod
    def of_solid(cls, corners_m: Array, solid: Solid, occluder: int, number: int) -> WorldTriangles:
        """The triangles of one solid, whose number is not below 1."""
        count = len(corners_m)
        return cls(corners_m, np.full(count, occluder), np.full(count, number if solid.closed else 0))


def vessel_triangles(
    vessels: Sequence[Vessel], present: Mask, positions_m: Array, world_R_vessel: Array
) -> WorldTriangles:
    """The solids of V vessels at one step: R · x + s for each corner (Jessen & Mohr (2023), eq. 7.1). The index of each
    vessel is its occluder index; `present` says which to take, shape (V,). Origins are in WCF, shape (V, 3), and
    rotations VCF to WCF, shape (V, 3, 3)."""
    parts = []
    for index in np.flatnonzero(present).tolist():
        corners = vessels[index].triangles_m @ world_R_vessel[index].T + positions_m[index]
        parts.append(WorldTriangles.of_solid(corners, vessels[index].solid, index, index + 1))
    return WorldTriangles.joined(parts)


def obstacle_triangles(obstacles: tuple[Obstacle, ...], first_occluder: int, camera_m: Array | None) -> WorldTriangles:
    """The solids of obstacles; `first_occluder` is the occluder index of the first one. On a curved sea `camera_m` is
    the camera's centre in WCF, (3,), and each obstacle is lowered by the drop there; else None."""
    triangles = _standing(obstacles, first_occluder)
    if camera_m is None or not obstacles:
        return triangles
    corners = triangles.corners_m.copy()
    drops = np.array([drop_m(obstacle.centre_m, camera_m) for obstacle in obstacles])
    corners[..., 2] -= drops[triangles.occluder - first_occluder, None]
    return replace(triangles, corners_m=corners)


@lru_cache(maxsize=4)
def _standing(obstacles: tuple[Obstacle, ...], first_occluder: int) -> WorldTriangles:
    solids = [(index, *pair) for index, obstacle in enumerate(obstacles) for pair in obstacle.solids]
    parts = [
        WorldTriangles.of_solid(vertices[solid.faces], solid, first_occluder + index, first_occluder + number + 1)
        for number, (index, solid, vertices) in enumerate(solids)
    ]
    return WorldTriangles.joined(parts)


HalfSpace = tuple[Array, float]  # a normal n, shape (D,), and an offset d: inside is n · p >= d


def cut(triangles: Array, half_spaces: Sequence[HalfSpace]) -> tuple[Array, Indices]:
    """The parts of triangles, shape (T, 3, D), inside all half-spaces, in order, with the triangle of each."""
    source = np.arange(len(triangles))
    for normal, offset in half_spaces:
        height = triangles @ normal - offset
        if not (height >= 0).all():
            triangles, of = _cut(triangles, height)
            source = source[of]
    return triangles, source


def _cut(triangles: Array, height: Array) -> tuple[Array, Indices]:
    """The parts of triangles (T, 3, D) where their corners' heights (T, 3), a linear function, are not negative."""
    inside = height >= 0
    corners_inside = inside.sum(axis=1)
    whole = np.flatnonzero(corners_inside == 3)
    parts, sources = [triangles[whole]], [whole]
    for count in (1, 2):
        rows = np.flatnonzero(corners_inside == count)
        # First comes the corner that is alone on its side.
        alone = inside[rows].argmax(axis=1) if count == 1 else inside[rows].argmin(axis=1)
        turn = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(triangles[rows], turn[..., None], axis=1), 1, 0)
        at_a, at_b, at_c = np.take_along_axis(height[rows], turn, axis=1).T[..., None]
        if count == 1:
            pieces = [(a, _crossing(a, at_a, b, at_b), _crossing(a, at_a, c, at_c))]
        else:
            to_b, to_c = _crossing(b, at_b, a, at_a), _crossing(c, at_c, a, at_a)
            pieces = [(to_b, b, c), (to_b, c, to_c)]
        parts += [np.stack(piece, axis=1) for piece in pieces]
        sources += [rows] * len(pieces)
    source = np.concatenate(sources)
    order = np.argsort(source, kind="stable")
    return np.concatenate(parts)[order], source[order]


def _crossing(inner: Array, at_inner: Array, outer: Array, at_outer: Array) -> Array:
    """Points at which edges leave the half-space, from the inner corner on: the same for both triangles at an edge."""
    return inner + (outer - inner) * (at_inner / (at_inner - at_outer))


GUARD_PX, LENS_GUARD_PX = 2048.0, 1.0
"""How far outside the image triangles are drawn, in buffer pixels; the second where a lens distorts, since its formula
may fold what lies far outside back into the image."""
MARGIN_PX = 2  # of a buffer around the corners of what is drawn into it
TILE_PX = (4096, 256)  # width and height of the largest buffer that is drawn at once: large ones take long to make


@dataclass(frozen=True, eq=False)
class Drawing:
    """The triangles of one frame in buffer pixels, of which there are `supersample` per image pixel and axis."""

    intrinsics: Intrinsics
    supersample: int
    straight_px: Array  # corners in the image of the pinhole: the camera's unless its lens distorts, shape (T, 3, 2)
    inverse_depth: Array  # near / c3 of these corners, in (0, 1], which is linear in that image, shape (T, 3)
    occluder: Indices  # index into the scene's occluder names of the solid of each, shape (T,)

    @classmethod
    def of(
        cls,
        triangles: WorldTriangles,
        camera_R_world: Array,
        camera_m: Array,
        intrinsics: Intrinsics,
        supersample: int = 1,
    ) -> Drawing:
        """Project triangles into the image of a camera with a rotation (3, 3) and a place (3,) in WCF."""
        pinhole, near_m = intrinsics.pinhole, intrinsics.near_clip_m
        corners = (triangles.corners_m - camera_m) @ camera_R_world.T
        guard_px = GUARD_PX / supersample if intrinsics.distortion is None else LENS_GUARD_PX
        corners, source = cut(corners, [(np.array([0.0, 0.0, 1.0]), near_m)])
        sections, of = _sections(corners, triangles.closed[source], near_m)
        occluder = triangles.occluder[np.concatenate([source, source[of]])]
        order = np.argsort(occluder, kind="stable")
        corners, source = cut(np.concatenate([corners, sections])[order], _field_of_view(pinhole, guard_px))
        depth = np.maximum(corners[..., 2], near_m)
        pixels = (corners @ pinhole.matrix.T)[..., :2] / depth[..., None]
        return cls(intrinsics, supersample, pixels * supersample, near_m / depth, occluder[order][source])

    def only(self, occluder: int) -> Drawing:
        """One solid alone."""
        chosen = self.occluder == occluder
        columns = (column[chosen] for column in (self.straight_px, self.inverse_depth, self.occluder))
        return Drawing(self.intrinsics, self.supersample, *columns)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the whole buffer."""
        width, height = self.intrinsics.image_size_px
        return width * self.supersample, height * self.supersample

    @property
    def image(self) -> Region:
        """The whole buffer."""
        return Region(0, 0, *self.size_px)

    @cached_property
    def boxes_px(self) -> dict[int, Array]:
        """The tight box, shape (4,), of each solid's corners, cut at the edge of the image; of what is in it only."""
        corners, _, occluder = self._drawn
        width, height = self.size_px
        x, y = np.eye(2)
        inside, source = cut(corners, [(x, 0.0), (-x, -float(width)), (y, 0.0), (-y, -float(height))])
        solids, place = occurring(occluder[source], int(occluder.max(initial=-1)) + 1)
        boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (len(solids), 1))
        np.minimum.at(boxes[:, :2], place, inside.min(axis=1))
        np.maximum.at(boxes[:, 2:], place, inside.max(axis=1))
        return dict(zip(solids.tolist(), boxes, strict=True))

    def region(self, *occluders: int) -> Region:
        """The rectangle around solids, with a margin, in the image; empty if none of them is there."""
        boxes = np.array([self.boxes_px[solid] for solid in occluders if solid in self.boxes_px]).reshape(-1, 4)
        around = np.concatenate([boxes[:, :2].min(axis=0, initial=np.inf), boxes[:, 2:].max(axis=0, initial=-np.inf)])
        return Region.around(around, self.size_px, MARGIN_PX)

    def ids(self, renderer: IdRenderer, region: Region) -> Ids:
        """Occluder index + 1 of what is in front at each pixel of a region, zero where nothing is, (height, width)."""
        corners, inverse_depth, occluder = self._drawn
        tiles = list(tiles_of(region))
        if len(tiles) == 1:
            return renderer.draw(corners, inverse_depth, occluder + 1, region)
        out = np.empty((region.height, region.width), dtype=np.uint32)
        for tile in tiles:
            x, y = tile.x - region.x, tile.y - region.y
            out[y : y + tile.height, x : x + tile.width] = renderer.draw(corners, inverse_depth, occluder + 1, tile)
        return out

    @cached_property
    def _drawn(self) -> tuple[Array, Array, Indices]:
        """Corners in the image (D, 3, 2), near / c3 (D, 3) and solid (D,) of the triangles that are drawn."""
        if self.intrinsics.distortion is None:
            return self.straight_px, self.inverse_depth, self.occluder
        pieces, source = _pieces(self.straight_px, self.inverse_depth, self.intrinsics.chord_px * self.supersample**0.5)
        bent = self.intrinsics.through_lens(pieces[..., :2] / self.supersample) * self.supersample
        return bent, pieces[..., 2], self.occluder[source]


def _sections(corners: Array, closed: Indices, near_m: float) -> tuple[Array, Indices]:
    """The sections of closed solids at the near plane as triangles (k, 3, 3), and a triangle of the solid of each (k,).
    Otherwise the camera would look into a solid that it is close to. `corners` (T, 3, 3) are cut there; for `closed`
    (T,) see `WorldTriangles`."""
    on_plane = corners[..., 2] <= near_m * (1 + 1e-9)
    edge = np.flatnonzero((on_plane.sum(axis=1) == 2) & (closed > 0))
    sections, sources = [corners[:0]], [edge[:0]]
    for number in distinct(closed[edge]).tolist():
        own = edge[closed[edge] == number]
        ends = corners[own][on_plane[own]].reshape(-1, 2, 3)[..., :2]
        area = shapely.build_area(shapely.node(shapely.multilinestrings(shapely.linestrings(ends))))
        pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(area))
        flat = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
        sections.append(np.concatenate([flat, np.full((len(flat), 3, 1), near_m)], axis=-1))
        sources.append(np.full(len(flat), own[0]))
    return np.concatenate(sections), np.concatenate(sources)


def _field_of_view(pinhole: Intrinsics, guard_px: float) -> list[HalfSpace]:
    """The half-spaces that project to an image and a band around it: x >= −guard is (f1, s, a1 + guard) · p >= 0."""
    (x, y, depth), (width, height) = pinhole.matrix, pinhole.image_size_px
    right, bottom = (width + guard_px) * depth - x, (height + guard_px) * depth - y
    return [(side, 0.0) for side in (x + guard_px * depth, right, y + guard_px * depth, bottom)]


def _pieces(straight_px: Array, inverse_depth: Array, longest_px: float) -> tuple[Array, Indices]:
    """Triangles (T, 3, 2) in pieces with short edges: x, y and near / c3 (D, 3, 3); the triangle of each, (D,)."""
    corners = np.concatenate([straight_px, inverse_depth[..., None]], axis=-1)
    edges = np.linalg.norm(np.roll(straight_px, -1, axis=1) - straight_px, axis=-1)
    counts = np.maximum(np.ceil(edges.max(axis=1, initial=0.0) / longest_px), 1).astype(np.int64)
    pieces, sources = [corners[:0]], [np.empty(0, dtype=np.int64)]
    for count in distinct(counts).tolist():
        chosen = np.flatnonzero(counts == count)
        weights = _lattice(count)
        pieces.append((weights @ corners[chosen, None]).reshape(-1, 3, 3))
        sources.append(np.repeat(chosen, len(weights)))
    source = np.concatenate(sources)
    order = np.argsort(source, kind="stable")
    return np.concatenate(pieces)[order], source[order]


def _lattice(count: int) -> Array:
    """Weights of a triangle's corners at those of the pieces that a lattice makes of it, (count², 3, 3)."""
    i, j = np.nonzero(np.tri(count))
    inner = j < i
    k, m = i[inner], j[inner]
    upright = np.stack([[i, j], [i + 1, j], [i + 1, j + 1]]).transpose(2, 0, 1)
    upside_down = np.stack([[k, m], [k + 1, m + 1], [k, m + 1]]).transpose(2, 0, 1)
    places = np.concatenate([upright, upside_down])
    i, j = places[..., 0], places[..., 1]
    return np.stack([count - i, i - j, j], axis=-1) / count


def tiles_of(region: Region) -> Iterator[Region]:
    """A region in parts that can each be drawn at once."""
    for y in range(region.y, region.y + region.height, TILE_PX[1]):
        for x in range(region.x, region.x + region.width, TILE_PX[0]):
            yield Region(x, y, *TILE_PX).common(region)
