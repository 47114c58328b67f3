"""False positives as seen by a camera whose horizon may be known: where they lie below it and along it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import centres, sizes
from modsim3d.detector.placement import depths_px, sea_levels
from modsim3d.formats.horizon import EVERYWHERE
from modsim3d.learn.observed.observed import Observed

_EDGE_PX = 1.0


@dataclass(frozen=True, eq=False)
class FalseSightings:
    """The n false positives of a labelled set, ordered by image.

    Attributes:
        image: Image of each, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        image_px: Width and height of its image, NaN where unknown, shape (n, 2).
        half_planes: The sea's side of the horizon in its image; everywhere where unknown, shape (n, 3).
        known: Whether the horizon of its image is known, shape (n,).
    """

    image: Indices
    boxes_px: Array
    image_px: Array
    half_planes: Array
    known: Mask

    @classmethod
    def of(cls, observed: Observed) -> FalseSightings:
        """Those of a labelled set."""
        results, images = observed.labelled.results, observed.labelled.images
        rows = observed.false_positives
        image = results.image[rows]
        given = images.half_planes[image]
        known: Mask = np.asarray(np.isfinite(given).all(axis=1))
        sea = np.where(known[:, None], given, EVERYWHERE)
        return cls(image, results.boxes_px[rows], images.sizes_px[image], sea, known)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.image)

    @cached_property
    def centres_px(self) -> Array:
        """Shape (n, 2)."""
        return centres(self.boxes_px)

    @cached_property
    def sizes_px(self) -> Array:
        """Width and height, at least a pixel, shape (n, 2)."""
        sides: Array = np.maximum(sizes(self.boxes_px), 1.0)
        return sides

    @cached_property
    def depth_px(self) -> Array:
        """Distance of the centre below the horizon, shape (n,)."""
        return depths_px(self.half_planes, self.centres_px)

    @cached_property
    def along_px(self) -> Array:
        """Distance of the centre from the left edge along the horizon, shape (n,)."""
        flat = np.hypot(self.half_planes[:, 0], self.half_planes[:, 1])
        cosine = np.abs(self.half_planes[:, 1]) / np.where(flat > 0, flat, 1.0)
        result: Array = self.centres_px[:, 0] / np.where(cosine > 0, cosine, 1.0)
        return result

    @cached_property
    def places_px(self) -> tuple[Array, Array]:
        """First and last row of the image in which the centre may lie, shapes (n,); the image's edge cuts boxes."""
        low = high = self.centres_px[:, 1]
        top, bottom = self.cut[:, 1], self.cut[:, 3]
        return np.where(top, 0.0, low), np.where(bottom, self.image_px[:, 1], high)

    @cached_property
    def cut(self) -> Mask:
        """Whether the left, upper, right and lower side lies on the image's edge, shape (n, 4)."""
        with np.errstate(invalid="ignore"):
            far: Mask = self.boxes_px[:, 2:] >= self.image_px - _EDGE_PX
        near: Mask = self.boxes_px[:, :2] <= _EDGE_PX
        return np.concatenate([near, far], axis=1)

    @cached_property
    def whole(self) -> Mask:
        """Whether no edge cuts the box, nor its level below the horizon between the left and the right edge, (n,)."""
        (a, b, _), (x, y) = self.half_planes.T, self.centres_px.T
        with np.errstate(divide="ignore", invalid="ignore"):
            left, right = y + a / b * x, y + a / b * (x - self.image_px[:, 0])
            outside = (np.minimum(left, right) < 0) | (np.maximum(left, right) > self.image_px[:, 1])
        inside: Mask = ~outside & ~self.cut.any(axis=1)
        return inside

    @cached_property
    def levels(self) -> tuple[Array, Array, Indices]:
        """Depths and widths of the sea in each distinct image, shapes (k, nodes), and which is that of each row (n,).

        Only for images whose size is known.
        """
        keys = np.column_stack([self.half_planes, self.image_px])
        distinct, row = np.unique(keys, axis=0, return_inverse=True)
        depth, width = np.empty((len(distinct), 0)), np.empty((len(distinct), 0))
        for size in np.unique(distinct[:, 3:], axis=0):
            ours = (distinct[:, 3:] == size).all(axis=1)
            some = sea_levels(distinct[ours, :3], (int(size[0]), int(size[1])))
            if not depth.shape[1]:
                depth, width = (np.empty((len(distinct), each.shape[1])) for each in some)
            depth[ours], width[ours] = some
        return depth, width, row.ravel()

    @cached_property
    def level_px(self) -> Array:
        """The depth in one image of the set at which as much of the sea lies above as above each row, shape (n,)."""
        depth, width, row = self.levels
        if not len(depth):
            return np.empty(0)
        area = np.cumsum((width[:, 1:] + width[:, :-1]) / 2 * np.diff(depth, axis=1), axis=1)
        share = np.concatenate([np.zeros((len(area), 1)), area], axis=1) / np.maximum(area[:, -1:], 1e-9)
        reference = int(np.argsort(area[:, -1])[len(area) // 2])
        result = np.empty(len(self))
        order = np.argsort(row, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
            k = row[rows[0]]
            above = np.interp(self.depth_px[rows], depth[k], share[k])
            result[rows] = np.interp(above, share[reference], depth[reference])
        return result
