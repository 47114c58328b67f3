"""The outlines of a run of frames in buffer pixels, drawn region by region."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, extents, ranges
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region, Sheet
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
        """Row + 1 at each pixel of a buffer with several regions, zero where nothing is, shape (height, width).

        Args:
            rows: What to draw in the first region, in the second and so on, shape (m,).
            counts: How many of `rows` are drawn in each region, shape (k,).
            sheet: The k regions, in buffer pixels.
        """
        drawn, number = np.unique(rows, return_inverse=True)
        triangles = self._triangles(drawn)
        first, count = extents(triangles.row, number)
        chosen = triangles.take(ranges(first, count))
        in_region = np.add.reduceat(count, np.cumsum(counts) - counts)
        corners = chosen.corners_px * self.supersample
        return self.renderer.draw_sheet(corners, chosen.inverse_depth, drawn[chosen.row] + 1, in_region, sheet)

    def _triangles(self, rows: Indices) -> Triangles:
        """The triangles of some rows, shape (k,), which ascend, without those that their own solid hides."""
        return triangles_of(self.outlines.take(rows), self.intrinsics, self.supersample, facing_only=True)
