"""One frame drawn as ID buffers in the most obvious way: each corner projected, each triangle drawn, a depth test.

A corner x of a solid is at R · x + s in the world, at R_c · (x − s_c) in the camera and at K of that in the image.
What is nearer than the near plane is cut off, and the section there closes the solid again. What reaches far outside
the image is cut off too, since OpenGL would cut edges there itself and move them. Triangles that are turned away from
the camera are drawn as well: the depth test hides them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices, distinct, occurring
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.truth.crosscheck.clipping import HalfSpace, cut
from modsim3d.truth.crosscheck.world_triangles import WorldTriangles

GUARD_PX, LENS_GUARD_PX = 2048.0, 1.0
"""How far outside the image triangles are drawn, in buffer pixels; the second where a lens distorts, since its formula
may fold what lies far outside back into the image."""
MARGIN_PX = 2
"""Of a buffer around the corners of what is drawn into it."""
TILE_PX = (4096, 256)
"""Width and height of the largest buffer that is drawn at once: large ones take long to make."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """The triangles of one frame in buffer pixels, of which there are `supersample` per image pixel and axis.

    Attributes:
        intrinsics: Of the camera.
        supersample: See above.
        straight_px: Corners in the image of a pinhole, shape (T, 3, 2): that of the camera unless its lens distorts.
        inverse_depth: near / c3 of these corners, in (0, 1], which is linear in that image, shape (T, 3).
        occluder: Index into the scene's occluder names of the solid of each, shape (T,).
    """

    intrinsics: Intrinsics
    supersample: int
    straight_px: Array
    inverse_depth: Array
    occluder: Indices

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
        return replace(
            self,
            straight_px=self.straight_px[chosen],
            inverse_depth=self.inverse_depth[chosen],
            occluder=self.occluder[chosen],
        )

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
        boxes = np.array([self.boxes_px[each] for each in occluders if each in self.boxes_px]).reshape(-1, 4)
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
    (T,) see `WorldTriangles`.
    """
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
    return [
        (x + guard_px * depth, 0.0),
        ((width + guard_px) * depth - x, 0.0),
        (y + guard_px * depth, 0.0),
        ((height + guard_px) * depth - y, 0.0),
    ]


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
    places = np.concatenate(
        [
            np.stack([[i, j], [i + 1, j], [i + 1, j + 1]]).transpose(2, 0, 1),
            np.stack([[k, m], [k + 1, m + 1], [k, m + 1]]).transpose(2, 0, 1),
        ]
    )
    i, j = places[..., 0], places[..., 1]
    weights: Array = np.stack([count - i, i - j, j], axis=-1) / count
    return weights


def tiles_of(region: Region) -> Iterator[Region]:
    """A region in parts that can each be drawn at once."""
    for y in range(region.y, region.y + region.height, TILE_PX[1]):
        for x in range(region.x, region.x + region.width, TILE_PX[0]):
            yield Region(x, y, *TILE_PX).common(region)
