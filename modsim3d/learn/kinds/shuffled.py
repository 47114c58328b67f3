"""False detections put into other frames, where they meet vessels by chance alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from modsim3d.boxes import sizes
from modsim3d.formats.labelled import Images
from modsim3d.learn.kinds.detection_shapes import Loose

SHUFFLES = 8
"""How often they are put elsewhere."""


def shuffled(loose: Loose, images: Images) -> Iterator[Loose]:
    """False detections in other frames of the same state; every other time moved across the image as well."""
    timed = np.isfinite(images.time_s)
    keys = np.column_stack(
        [
            images.condition,
            images.source,
            np.where(timed, images.sequence, -1),
            np.nan_to_num(images.sizes_px, nan=-1.0).astype(np.int64),
        ]
    )
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.ravel()
    order = np.argsort(group, kind="stable")
    first = np.searchsorted(group[order], group)
    number = np.bincount(group)[group]
    position = np.empty(len(images), dtype=np.int64)
    position[order] = np.arange(len(images))
    width = images.sizes_px[loose.image, 0]
    for k in range(SHUFFLES):
        step = (number * (2 * k + 1)) // (2 * SHUFFLES)
        other = order[first + (position - first + step) % number]
        stays = step == 0  # too few frames: they would meet their own vessels
        boxes = loose.boxes_px
        if k % 2:
            room = width - sizes(boxes)[:, 0]
            x = np.where(
                room > 0, (boxes[:, 0] + room * (k + 1) / (SHUFFLES + 2)) % np.maximum(room, 1e-9), boxes[:, 0]
            )
            shift = np.where(np.isfinite(x), x - boxes[:, 0], 0.0)
            boxes = boxes + shift[:, None] * [1, 0, 1, 0]
        there = other[loose.image]
        kept = np.flatnonzero(~stays[loose.image])
        kept = kept[np.argsort(there[kept], kind="stable")]
        yield Loose(loose.row[kept], there[kept], boxes[kept])
