"""Silhouettes as polygons, and the order in which to draw them over each other."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.frames import Array

Indices = NDArray[np.int64]


def rings(polygons: NDArray[np.object_]) -> tuple[Array, Indices]:
    """The corners of polygons, one after the other, the first not repeated at the end.

    Args:
        polygons: Shape (n,).

    Returns:
        Corners, shape (m, 2), and how many belong to each polygon, shape (n,); none to what is empty or in pieces.
    """
    corners, owner = shapely.get_coordinates(shapely.get_exterior_ring(polygons), return_index=True)
    last = np.append(owner[1:] != owner[:-1], True)[: len(owner)]
    return corners[~last], np.bincount(owner[~last], minlength=len(polygons))


def drawing_order(frame: Indices, depth_m: Array, hidden: Indices, hider: Indices) -> Indices:
    """Rows so that what is drawn later hides what the truth says that it hides; farther ones first otherwise.

    The distance of the centres alone would put a long ship before the boat that lies in front of its stern.

    Args:
        frame: Of each row, ascending, shape (n,).
        depth_m: Shape (n,).
        hidden: Rows of which a part is hidden, shape (p,).
        hider: By which row of the same frame, shape (p,).

    Returns:
        A permutation of the rows, in order of frame, shape (n,).
    """
    order = np.lexsort((-depth_m, frame))
    place = np.argsort(order)
    wrong = np.unique(frame[hidden[place[hidden] > place[hider]]])
    in_question = np.isin(frame[hidden], wrong)
    behind = defaultdict(set)
    for back, front in zip(hidden[in_question].tolist(), hider[in_question].tolist(), strict=True):
        behind[front].add(back)
    for crowded in wrong:
        rows = slice(*np.searchsorted(frame, (crowded, crowded + 1)))
        order[rows] = _behind_first(order[rows].tolist(), behind)
    return order


def _behind_first(far_to_near: list[int], behind: dict[int, set[int]]) -> list[int]:
    """The rows, each after those behind it; where three hide each other in a ring, the farthest comes first."""
    waiting, drawn = list(far_to_near), list[int]()
    while waiting:
        left = set(waiting)
        free = next((row for row in waiting if not behind.get(row, set()) & left), waiting[0])
        waiting.remove(free)
        drawn.append(free)
    return drawn
