"""Truth from pixels the plain way: the whole image with all vessels, and then each vessel alone.

This is the reference that `rendered` is tested against, and what `--render full` runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modsim3d.annotate.comparison import PixelMasks
from modsim3d.annotate.occlusion import HiddenPixels, Occlusion
from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.triangles import Triangles, triangles_of
from modsim3d.arrays import Array, Mask
from modsim3d.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region

TILE_PX = (8192, 4096)
"""Widest and highest buffer drawn at once; larger regions, as with supersampling, are drawn in tiles."""


def full_frame_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """Draw every frame and count the pixels of vessels.

    A silhouette that holds no pixel centre has no pixels; its full box is then the projected one.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        renderer: Draws the ID buffers.
        supersample: Buffer pixels for each image pixel and axis; results are in image pixels all the same.
    """
    drawing = _Drawing(outlines, triangles_of(outlines, intrinsics, supersample), intrinsics, renderer, supersample)
    tally = _Tally.empty(len(outlines))
    for rows in _frames(outlines):
        for tile in _tiles(drawing.frame):
            _count(drawing, tally, rows, tile)
    full = np.where(tally.silhouette[:, None] > 0, tally.full / supersample, outlines.boxes_px)
    visible = np.where(tally.visible[:, None] > 0, tally.seen / supersample, np.nan)
    area = supersample**2
    return Occlusion(
        full_boxes_px=full,
        visible_boxes_px=visible,
        silhouette_px=tally.silhouette / area,
        visible_px=tally.visible / area,
        hidden=tally.hidden(area),
    )


def pixel_masks(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, row: int, supersample: int = 1
) -> PixelMasks:
    """The pixels of one vessel, drawn once more for those who want to look at them.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        renderer: Draws the ID buffers.
        row: Of the outlines.
        supersample: Buffer pixels for each image pixel and axis.
    """
    drawing = _Drawing(outlines, triangles_of(outlines, intrinsics, supersample), intrinsics, renderer, supersample)
    frame = slice(*np.searchsorted(outlines.frame, (outlines.frame[row], outlines.frame[row] + 1)))
    region = drawing.region(slice(row, row + 1))
    silhouette = drawing.draw_in_tiles(slice(row, row + 1), region) > 0
    visible = drawing.draw_in_tiles(frame, region) == outlines.occluder[row] + 1
    return PixelMasks(region.x, region.y, silhouette, visible)


@dataclass(frozen=True, eq=False)
class _Tally:
    """What was counted so far, in buffer pixels."""

    full: Array
    seen: Array
    silhouette: Array
    visible: Array
    hiders: list[Counter[int]]

    @classmethod
    def empty(cls, count: int) -> _Tally:
        nowhere = np.tile([np.inf, np.inf, -np.inf, -np.inf], (count, 1))
        return cls(nowhere, nowhere.copy(), np.zeros(count), np.zeros(count), [Counter() for _ in range(count)])

    def hidden(self, area: int) -> HiddenPixels:
        """Who hides how much, in image pixels of `area` buffer pixels each."""
        entries = [(row, hider, px) for row, hiders in enumerate(self.hiders) for hider, px in hiders.items()]
        row, hider, px = np.array(entries, dtype=np.int64).reshape(-1, 3).T
        return HiddenPixels.of(row, hider, px / area)


@dataclass(frozen=True, eq=False)
class _Drawing:
    """The triangles of a run of frames, and where in the buffer they go."""

    outlines: Outlines
    triangles: Triangles
    intrinsics: Intrinsics
    renderer: IdRenderer
    supersample: int

    @property
    def frame(self) -> Region:
        """The whole image, in buffer pixels."""
        width, height = self.intrinsics.image_size_px
        return Region(0, 0, width * self.supersample, height * self.supersample)

    def region(self, rows: slice) -> Region:
        """The buffer pixels that the silhouettes of rows can touch."""
        boxes = self.outlines.boxes_px[rows] * self.supersample
        union = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])
        return Region.around(union, (self.frame.width, self.frame.height))

    def draw(self, rows: slice, region: Region) -> Ids:
        """Occluder index + 1 at each pixel."""
        chosen = slice(*np.searchsorted(self.triangles.row, (rows.start, rows.stop)))
        ids = self.outlines.occluder[self.triangles.row[chosen]] + 1
        corners = self.triangles.corners_px[chosen] * self.supersample
        return self.renderer.draw(corners, self.triangles.inverse_depth[chosen], ids, region)

    def draw_in_tiles(self, rows: slice, region: Region) -> Ids:
        """The same for a region that may be larger than a buffer."""
        ids = np.empty((region.height, region.width), dtype=np.uint32)
        for tile in _tiles(region):
            y, x = tile.y - region.y, tile.x - region.x
            ids[y : y + tile.height, x : x + tile.width] = self.draw(rows, tile)
        return ids


def _count(drawing: _Drawing, tally: _Tally, rows: slice, tile: Region) -> None:
    """Count the pixels of a frame's vessels in a tile."""
    scene = drawing.draw(rows, tile)
    boxes = drawing.outlines.boxes_px
    for row in (rows.start + np.flatnonzero(drawing.outlines.boxed[rows])).tolist():
        region = drawing.region(slice(row, row + 1)).common(tile)
        if not region.width or not region.height:
            continue
        seen = scene[region.y - tile.y :, region.x - tile.x :][: region.height, : region.width]
        mask = seen == drawing.outlines.occluder[row] + 1
        silhouette = drawing.draw(slice(row, row + 1), region) > 0 if _overlaps_another(boxes, row, rows) else mask
        mask |= silhouette & (seen == 0)  # far outside the buffer OpenGL cuts edges itself, here and there differently
        _add(tally.silhouette, tally.full, row, silhouette, region)
        _add(tally.visible, tally.seen, row, mask, region)
        for hider, pixels in zip(*np.unique(seen[silhouette & ~mask], return_counts=True), strict=True):
            tally.hiders[row][int(hider) - 1] += int(pixels)


def _add(counts: Array, boxes: Array, row: int, mask: Mask, region: Region) -> None:
    """Add a mask's pixels to a row's count and box."""
    pixels = np.count_nonzero(mask)
    if pixels:
        counts[row] += pixels
        box = mask_box(mask, region)
        boxes[row] = [*np.minimum(boxes[row, :2], box[:2]), *np.maximum(boxes[row, 2:], box[2:])]


def mask_box(mask: Mask, region: Region) -> Array:
    """Half-open box of the true pixels of a region: [min column, max column + 1), in pixels.

    Args:
        mask: Shape (region.height, region.width), with at least one true pixel.
        region: Where the mask lies.

    Returns:
        x_min, y_min, x_max, y_max, shape (4,).
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    left, top = columns[0] + region.x, rows[0] + region.y
    right, bottom = columns[-1] + 1 + region.x, rows[-1] + 1 + region.y
    return np.array([left, top, right, bottom], dtype=np.float64)


def _frames(outlines: Outlines) -> list[slice]:
    """The rows of each frame that has any."""
    edges = [*np.flatnonzero(np.diff(outlines.frame, prepend=-1)).tolist(), len(outlines)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def _tiles(region: Region) -> Iterator[Region]:
    """A region in parts that are small enough to draw."""
    for y in range(region.y, region.y + region.height, TILE_PX[1]):
        for x in range(region.x, region.x + region.width, TILE_PX[0]):
            yield Region(x, y, *TILE_PX).common(region)


def _overlaps_another(boxes_px: Array, row: int, rows: slice) -> bool:
    """Whether the box of a row comes within two pixels of another's in its frame: else nobody can hide it."""
    others = boxes_px[rows]
    near = (others[:, :2] < boxes_px[row, 2:] + 2).all(axis=1) & (others[:, 2:] > boxes_px[row, :2] - 2).all(axis=1)
    return bool(np.count_nonzero(near) > 1)
