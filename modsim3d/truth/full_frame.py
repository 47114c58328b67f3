"""Truth from pixels the plain way: draw the whole image with everything in it, and then each vessel alone. This is the
reference that `rendered` is tested against, and what `annotation.render: full` runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.truth.analytic import PixelMasks, mask_box
from modsim3d.truth.buffer_drawing import Triangles, tiles_of, triangles_of
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.occlusion_order import frame_slices
from modsim3d.truth.outlines import Outlines


def full_frame_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """Draw every frame and count the pixels of vessels; see `rendered_occlusion`. A silhouette that contains no pixel
    centre has no pixels; its full box is then the projected one."""
    drawing = _Drawing.of(outlines, intrinsics, renderer, supersample)
    silhouettes, visible = _Counts.none(len(outlines)), _Counts.none(len(outlines))
    hiders: Counter[tuple[int, int]] = Counter()
    for rows in frame_slices(outlines.frame):
        for tile in tiles_of(drawing.image):
            for row, masks, seen in _drawn_masks(drawing, rows, tile):
                silhouettes.add(row, masks.silhouette, masks.region)
                visible.add(row, masks.visible, masks.region)
                hidden = masks.silhouette & ~masks.visible
                for hider_id, pixels in zip(*np.unique(seen[hidden], return_counts=True), strict=True):
                    hiders[row, int(hider_id) - 1] += int(pixels)
    hidden_row, hider = np.array(list(hiders), dtype=np.int64).reshape(-1, 2).T
    area = supersample**2
    return Occlusion(
        full_boxes_px=np.where(silhouettes.px[:, None] > 0, silhouettes.boxes / supersample, outlines.boxes_px),
        visible_boxes_px=np.where(visible.px[:, None] > 0, visible.boxes / supersample, np.nan),
        silhouette_px=silhouettes.px / area,
        visible_px=visible.px / area,
        hidden=HiddenPixels.of(hidden_row, hider, np.array(list(hiders.values()), dtype=np.float64) / area),
        drawn=np.ones(len(outlines), dtype=bool),
    )


def vessel_masks(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Iterator[tuple[int, PixelMasks]]:
    """Draw every frame: the pixels that `full_frame_occlusion` counts, for each row of the outlines that gets a box. A
    row comes more than once where the image is drawn in tiles, each time with other pixels."""
    drawing = _Drawing.of(outlines, intrinsics, renderer, supersample)
    for rows in frame_slices(outlines.frame):
        for tile in tiles_of(drawing.image):
            for row, masks, _ in _drawn_masks(drawing, rows, tile):
                yield row, masks


@dataclass(frozen=True, eq=False)
class _Counts:
    """Pixels counted so far, and the boxes around them, in buffer pixels; shapes (n,) and (n, 4)."""

    px: Array
    boxes: Array

    @classmethod
    def none(cls, count: int) -> _Counts:
        return cls(np.zeros(count), np.tile([np.inf, np.inf, -np.inf, -np.inf], (count, 1)))

    def add(self, row: int, mask: Mask, region: Region) -> None:
        """Count the pixels of a mask, shape (region.height, region.width)."""
        if pixels := np.count_nonzero(mask):
            self.px[row] += pixels
            box, counted = mask_box(mask, region), self.boxes[row]
            self.boxes[row] = [*np.minimum(counted[:2], box[:2]), *np.maximum(counted[2:], box[2:])]


@dataclass(frozen=True, eq=False)
class _Drawing:
    """The triangles of a run of frames, and where they go in the buffer."""

    outlines: Outlines
    triangles: Triangles
    image: Region
    renderer: IdRenderer
    supersample: int

    @classmethod
    def of(cls, outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int) -> _Drawing:
        width, height = intrinsics.image_size_px
        image = Region(0, 0, width * supersample, height * supersample)
        triangles = triangles_of(outlines, intrinsics, supersample, facing_only=True)
        return cls(outlines, triangles, image, renderer, supersample)

    def region(self, row: int) -> Region:
        """The buffer pixels that the silhouette of a row can touch."""
        return Region.around(self.outlines.boxes_px[row] * self.supersample, (self.image.width, self.image.height))

    def draw(self, rows: slice, region: Region) -> Ids:
        """Occluder index + 1 at each pixel."""
        chosen = slice(*np.searchsorted(self.triangles.row, (rows.start, rows.stop)))
        ids = self.outlines.occluder[self.triangles.row[chosen]] + 1
        corners = self.triangles.corners_px[chosen] * self.supersample
        return self.renderer.draw(corners, self.triangles.inverse_depth[chosen], ids, region)


def _drawn_masks(drawing: _Drawing, rows: slice, tile: Region) -> Iterator[tuple[int, PixelMasks, Ids]]:
    """Each vessel of a frame that may have pixels in a tile: its row, those pixels, and the IDs seen around them."""
    scene = drawing.draw(rows, tile)
    for row in (rows.start + np.flatnonzero(drawing.outlines.boxed[rows])).tolist():
        region = drawing.region(row).common(tile)
        if not region.width or not region.height:
            continue
        seen = scene[region.y - tile.y :, region.x - tile.x :][: region.height, : region.width]
        mask = seen == drawing.outlines.occluder[row] + 1
        # Nothing can hide it unless another box in its frame comes within two pixels of its own.
        others, own = drawing.outlines.boxes_px[rows], drawing.outlines.boxes_px[row]
        near = (others[:, :2] < own[2:] + 2).all(axis=1) & (others[:, 2:] > own[:2] - 2).all(axis=1)
        silhouette = drawing.draw(slice(row, row + 1), region) > 0 if np.count_nonzero(near) > 1 else mask
        mask |= silhouette & (seen == 0)  # far outside the buffer OpenGL cuts edges itself, here and there differently
        yield row, PixelMasks(region, silhouette, mask), seen
