"""How much of each box is visible, from the boxes alone.

On a flat sea, seen from above it, the vessel whose foot is lower in the image is nearer. So a box is hidden by the
boxes whose lower edges lie below its own; of boxes with equal lower edges, neither hides the other.
"""

from __future__ import annotations

import numpy as np
import shapely

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import areas, intersections
from modsim3d.truth.overlaps import overlapping_pairs
from modsim3d.truth.polygon_occlusion import NOTHING_PX2, Hiding


def visible_fractions(image: Indices, boxes_px: Array, feet_px: Array) -> Array:
    """Share of each box that no nearer box of its image covers, shape (n,).

    Args:
        image: Image of each box, non-decreasing, shape (n,).
        boxes_px: The boxes cut at the edge of the image, shape (n, 4).
        feet_px: Lower edge of each box before it was cut, shape (n,).
    """
    first, second = overlapping_pairs(image, boxes_px)
    below, above = feet_px[first] > feet_px[second], feet_px[first] < feet_px[second]
    hiding = Hiding.of(np.concatenate([second[below], first[above]]), np.concatenate([first[below], second[above]]))
    hidden_px = np.zeros(len(boxes_px))
    common_px = intersections(boxes_px[hiding.hidden], boxes_px[hiding.hiders])
    rows, starts, counts = np.unique(hiding.hidden, return_index=True, return_counts=True)
    hidden_px[rows] = common_px[starts]
    for row, start, count in zip(*(column[counts > 1].tolist() for column in (rows, starts, counts)), strict=True):
        nearer = boxes_px[hiding.hiders[start : start + count]]
        low, high = np.maximum(nearer[:, :2], boxes_px[row, :2]), np.minimum(nearer[:, 2:], boxes_px[row, 2:])
        hidden_px[row] = shapely.area(shapely.union_all(shapely.box(*low.T, *high.T)))
    whole_px = np.maximum(areas(boxes_px), 0)
    left_px = np.where(whole_px - hidden_px > NOTHING_PX2, whole_px - hidden_px, 0.0)
    fractions: Array = np.where(hidden_px > 0, left_px / np.where(whole_px > 0, whole_px, 1.0), 1.0)
    return fractions
