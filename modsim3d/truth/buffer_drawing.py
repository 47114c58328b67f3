"""The outlines of a run of frames in buffer pixels, ready to be drawn together or each by itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, ranges
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.triangles import Triangles, triangles_of

TILE_PX = (8192, 4096)
"""Width and height of the largest buffer that is drawn at once; larger regions are drawn in tiles."""


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
    """Outlines, what draws them at `supersample` buffer pixels per image pixel and axis, and their triangles."""

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

    @cached_property
    def triangles(self) -> Triangles:
        """The triangles of all rows, without those that their own solid hides."""
        return triangles_of(self.outlines, self.intrinsics, self.supersample, facing_only=True)

    def triangles_of_rows(self, rows: Indices) -> tuple[Indices, Indices]:
        """Indices of the triangles of rows (k,), one row after another, and each one's place in `rows`, shapes (t,)."""
        first, stop = (np.searchsorted(self.triangles.row, rows, side=side) for side in ("left", "right"))
        return ranges(first, stop - first), np.repeat(np.arange(len(rows)), stop - first)

    def draw(self, triangles: Indices, shift_px: Indices, region: Region) -> Ids:
        """Row + 1 at each pixel of a region, zero where nothing is, shape (region.height, region.width).

        Args:
            triangles: Indices of what to draw, shape (t,).
            shift_px: Whole buffer pixels by which each triangle is moved, shape (t, 2), or (2,) for all.
            region: In buffer pixels.
        """
        chosen = self.triangles
        corners = chosen.corners_px[triangles] * self.supersample + shift_px[..., None, :]
        return self.renderer.draw(corners, chosen.inverse_depth[triangles], chosen.row[triangles] + 1, region)
