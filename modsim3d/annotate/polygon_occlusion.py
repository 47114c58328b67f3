"""Regions of the image as polygons: what is left of each when others cover it, and who covers how much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.annotate.occlusion import HiddenPixels
from modsim3d.arrays import Array, Indices

NOTHING_PX2 = 1e-6
"""Regions smaller than this are rounding errors of cutting one polygon by another."""

Polygons = NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class Hiding:
    """Which rows may hide which, ordered by the hidden row.

    Attributes:
        hidden: Shape (m,), non-decreasing.
        hiders: Shape (m,).
    """

    hidden: Indices
    hiders: Indices

    @classmethod
    def of(cls, hidden: Indices, hiders: Indices) -> Hiding:
        """Put pairs in order."""
        ascending = np.lexsort((hiders, hidden))
        return cls(hidden[ascending], hiders[ascending])

    def hiders_of(self, row: int) -> Indices:
        """Rows that may hide a row."""
        return self.hiders[slice(*np.searchsorted(self.hidden, (row, row + 1)))]


def less(polygons: Polygons, rows: Indices, covers: Polygons) -> Polygons:
    """Polygons less what covers them: each round takes one cover from every polygon that has one left.

    Args:
        polygons: Shape (n,).
        rows: The polygon that each cover is taken from, non-decreasing, shape (m,).
        covers: Shape (m,).
    """
    left = polygons.copy()
    turn = np.arange(len(rows)) - np.searchsorted(rows, rows)
    for k in range(int(turn.max(initial=-1)) + 1):
        now = turn == k
        left[rows[now]] = shapely.difference(left[rows[now]], covers[now])
    return left


def visible_of(silhouettes: Polygons, hiding: Hiding) -> Polygons:
    """What is visible of each silhouette, shape (n,)."""
    return less(silhouettes, hiding.hidden, silhouettes[hiding.hiders])


def boxes_and_areas(visible: Polygons, full_boxes_px: Array, full_areas_px: Array) -> tuple[Array, Array]:
    """Bounding boxes (NaN where nothing is) and areas of visible regions, shapes (n, 4) and (n,).

    Args:
        visible: Shape (n,).
        full_boxes_px: Of the whole silhouettes; taken exactly where nothing is hidden, shape (n, 4).
        full_areas_px: Shape (n,).
    """
    areas: Array = shapely.area(visible)
    seen, whole = areas > NOTHING_PX2, areas >= full_areas_px - NOTHING_PX2
    boxes = np.where(whole[:, None], full_boxes_px, np.where(seen[:, None], shapely.bounds(visible), np.nan))
    return boxes, np.where(whole, full_areas_px, np.where(seen, areas, 0.0))


def hidden_areas(silhouettes: Polygons, hiding: Hiding, occluder: Indices, ties: Hiding | None = None) -> Array:
    """How much each hider hides of each hidden: every hidden point belongs to the front-most thing there, shape (m,).

    A solid that may hide the hider takes its part only where it also hides the hidden one, since being in front is an
    order along a ray. So a hider's part is what the two silhouettes share, less the silhouettes in front of the hider.
    What several pieces of an obstacle hide together stands at the first of them.

    Args:
        silhouettes: Shape (n,).
        hiding: m pairs.
        occluder: Vessel or obstacle of each row, as an index into the scene's occluder names, shape (n,).
        ties: Pairs that overlap without an order, as if one were in front: what both hide of a third must be counted
            once only.
    """
    shared = shapely.intersection(silhouettes[hiding.hidden], silhouettes[hiding.hiders])
    rows: list[int] = []
    covers: list[int] = []
    for k, (hidden, hider) in enumerate(zip(hiding.hidden.tolist(), hiding.hiders.tolist(), strict=True)):
        in_front = [row for row in hiding.hiders_of(hider).tolist() if row != hidden]
        if ties is not None:
            also = set(ties.hiders_of(hider).tolist()) & set(hiding.hiders_of(hidden).tolist())
            in_front += sorted(also)
        rows += [k] * len(in_front)
        covers += in_front
    parts = less(shared, np.array(rows, dtype=np.int64), silhouettes[covers])
    pairs = np.stack([hiding.hidden, occluder[hiding.hiders]], axis=1)
    _, first, piece_of, pieces = np.unique(pairs, axis=0, return_index=True, return_inverse=True, return_counts=True)
    piece_of = piece_of.reshape(-1)
    areas: Array = np.where(pieces[piece_of] == 1, shapely.area(parts), 0.0)
    for group in np.flatnonzero(pieces > 1).tolist():
        areas[first[group]] = shapely.area(shapely.union_all(parts[piece_of == group]))
    return areas


def hidden_by(hiding: Hiding, areas_px: Array, occluder: Indices) -> HiddenPixels:
    """Who hides how much of which row, leaving out rounding errors.

    Args:
        hiding: m pairs.
        areas_px: Shape (m,).
        occluder: As in `hidden_areas`, shape (n,).
    """
    real = areas_px > NOTHING_PX2
    return HiddenPixels.of(hiding.hidden[real], occluder[hiding.hiders[real]], areas_px[real])
