"""Truth from pixels: ID buffers of the visible image and of each silhouette alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from modsim3d.annotate.outlines import Outlines, Triangles, triangles_of
from modsim3d.annotate.record import Occlusion
from modsim3d.camera import Intrinsics
from modsim3d.frames import Array
from modsim3d.render.id_pass import IdRenderer, Ids, Region


def rendered_occlusion(outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer) -> Occlusion:
    """Draw every frame and count pixels.

    A silhouette that holds no pixel centre has no pixels; its full box is then the projected one.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        renderer: Draws the ID buffers.
    """
    full, visible = outlines.boxes_px.copy(), np.full((len(outlines), 4), np.nan)
    silhouette_px, visible_px = np.zeros(len(outlines)), np.zeros(len(outlines))
    occluders: list[tuple[tuple[int, float], ...]] = [()] * len(outlines)
    triangles = triangles_of(outlines, intrinsics)
    ids = outlines.vessel + 1
    for rows in _frames(outlines):
        scene = _draw(renderer, triangles, ids, rows, _region(outlines, rows, intrinsics))
        for row in range(rows.start, rows.stop):
            alone = slice(row, row + 1)
            region = _region(outlines, alone, intrinsics)
            seen = scene.cut(region)
            mask = seen == ids[row]
            silhouette = (
                _draw(renderer, triangles, ids, alone, region).ids > 0
                if _overlaps_another(outlines.boxes_px, row, rows)
                else mask
            )
            silhouette_px[row], visible_px[row] = np.count_nonzero(silhouette), np.count_nonzero(mask)
            if silhouette_px[row]:
                full[row] = mask_box(silhouette, region)
            if visible_px[row]:
                visible[row] = mask_box(mask, region)
            if visible_px[row] < silhouette_px[row]:
                hiding, counts = np.unique(seen[silhouette & ~mask], return_counts=True)
                occluders[row] = tuple(zip((hiding.astype(np.int64) - 1).tolist(), counts.tolist(), strict=True))
    return Occlusion(full, visible, silhouette_px, visible_px, tuple(occluders))


def mask_box(mask: NDArray[np.bool_], region: Region) -> Array:
    """Half-open box of the true pixels of a region: [min column, max column + 1), in image pixels.

    Args:
        mask: Shape (region.height, region.width), with at least one true pixel.
        region: Where the mask lies in the image.

    Returns:
        x_min, y_min, x_max, y_max, shape (4,).
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    left, top = columns[0] + region.x, rows[0] + region.y
    right, bottom = columns[-1] + 1 + region.x, rows[-1] + 1 + region.y
    return np.array([left, top, right, bottom], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Drawing:
    ids: Ids
    region: Region

    def cut(self, region: Region) -> Ids:
        """The part of this drawing that a region inside it covers."""
        top, left = region.y - self.region.y, region.x - self.region.x
        return self.ids[top : top + region.height, left : left + region.width]


def _frames(outlines: Outlines) -> list[slice]:
    """The rows of each frame that has any."""
    edges = [*np.flatnonzero(np.diff(outlines.frame, prepend=-1)).tolist(), len(outlines)]
    return [slice(first, stop) for first, stop in pairwise(edges)]


def _region(outlines: Outlines, rows: slice, intrinsics: Intrinsics) -> Region:
    boxes = outlines.boxes_px[rows]
    union = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])
    return Region.around(union, intrinsics.image_size_px)


def _draw(renderer: IdRenderer, triangles: Triangles, ids: NDArray[np.int64], rows: slice, region: Region) -> _Drawing:
    first, stop = np.searchsorted(triangles.row, (rows.start, rows.stop))
    chosen = slice(first, stop)
    drawn = renderer.draw(
        triangles.corners_px[chosen], triangles.inverse_depth[chosen], ids[triangles.row[chosen]], region
    )
    return _Drawing(drawn, region)


def _overlaps_another(boxes_px: Array, row: int, rows: slice) -> bool:
    """Whether the box of a row comes within two pixels of another's in its frame: else nobody can hide it."""
    others = boxes_px[rows]
    near = (others[:, :2] < boxes_px[row, 2:] + 2).all(axis=1) & (others[:, 2:] > boxes_px[row, :2] - 2).all(axis=1)
    return bool(np.count_nonzero(near) > 1)
