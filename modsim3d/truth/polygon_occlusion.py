"""Occlusion of polygons by polygons: what remains visible of each, and who hides how much of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.unions import union_of
from modsim3d.truth.occlusion import HiddenPixels

NOTHING_PX2 = 1e-6
"""Smaller regions are rounding errors of cutting one polygon by another."""

Polygons = NDArray[np.object_]


@dataclass(frozen=True, eq=False)
class Hiding:
    """Which rows may hide which, ordered by the hidden row.

    Attributes:
        hidden: Row that may be hidden, non-decreasing, shape (m,).
        hiders: Row that may hide it, shape (m,).
    """

    hidden: Indices
    hiders: Indices

    @classmethod
    def of(cls, hidden: Indices, hiders: Indices) -> Hiding:
        """Sort pairs: `hiders[k]` may hide `hidden[k]`; both of shape (m,)."""
        ascending = np.lexsort((hiders, hidden))
        return cls(hidden[ascending], hiders[ascending])

    def hiders_of(self, row: int) -> Indices:
        """Rows that may hide a row, ascending, shape (k,)."""
        return self.hiders[slice(*np.searchsorted(self.hidden, (row, row + 1)))]


def subtract(polygons: Polygons, rows: Indices, covers: Polygons) -> Polygons:
    """Polygons, shape (n,), minus all that covers them, shape (n,).

    Cover k of the m `covers` is subtracted from polygon rows[k]; `rows`, shape (m,), do not decrease. Each round
    subtracts one cover from every polygon that still has one.
    """
    left = polygons.copy()
    turn = np.arange(len(rows)) - np.searchsorted(rows, rows)
    for k in range(int(turn.max(initial=-1)) + 1):
        now = turn == k
        left[rows[now]] = shapely.difference(left[rows[now]], covers[now])
    return left


def visible_of(silhouettes: Polygons, hiding: Hiding) -> Polygons:
    """What is visible of each silhouette (n,), shape (n,)."""
    return subtract(silhouettes, hiding.hidden, silhouettes[hiding.hiders])


def boxes_and_areas(visible: Polygons, full_boxes_px: Array, full_areas_px: Array) -> tuple[Array, Array]:
    """Bounding boxes (NaN where nothing is) and areas of visible regions (n,), shapes (n, 4) and (n,).

    Where nothing is hidden, they are the boxes and areas given for the whole silhouettes.
    """
    areas: Array = shapely.area(visible)
    seen, whole = areas > NOTHING_PX2, areas >= full_areas_px - NOTHING_PX2
    boxes = np.where(whole[:, None], full_boxes_px, np.where(seen[:, None], shapely.bounds(visible), np.nan))
    return boxes, np.where(whole, full_areas_px, np.where(seen, areas, 0.0))


def hidden_areas(silhouettes: Polygons, hiding: Hiding, occluder: Indices, ties: Hiding | None = None) -> Array:
    """How much each hider hides of each hidden row, in square pixels, shape (m,).

    Every hidden point is counted for the front-most solid there. A hider's part is therefore what the two silhouettes
    share, minus the silhouettes of everything that may hide the hider. What several pieces of an obstacle hide together
    is entered for the first of them; the others get zero.

    Args:
        silhouettes: Silhouettes of all rows, shape (n,).
        hiding: The m pairs of hidden row and hider.
        occluder: Vessel or obstacle of each row, as an index into the scene's occluder names, shape (n,).
        ties: Pairs that overlap but have no order. The hider of a pair counts as the one in front, so that what both
            hide of a third row is counted once.
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
    parts = subtract(shared, np.array(rows, dtype=np.int64), silhouettes[covers])
    pairs = np.stack([hiding.hidden, occluder[hiding.hiders]], axis=1)
    _, first, piece_of, pieces = np.unique(pairs, axis=0, return_index=True, return_inverse=True, return_counts=True)
    piece_of = piece_of.reshape(-1)
    areas: Array = np.where(pieces[piece_of] == 1, shapely.area(parts), 0.0)
    for group in np.flatnonzero(pieces > 1).tolist():
        areas[first[group]] = shapely.area(union_of(parts[piece_of == group]))
    return areas


def hidden_by(hiding: Hiding, areas_px: Array, occluder: Indices) -> HiddenPixels:
    """Who hides how much of which row, from the m areas of `hidden_areas`, shape (m,), without rounding errors."""
    real = areas_px > NOTHING_PX2
    return HiddenPixels.of(hiding.hidden[real], occluder[hiding.hiders[real]], areas_px[real])


def boundary_pixels(regions: Polygons, supersample: int) -> Array:
    """How many buffer pixels the boundary of each region can cross: |dx| + |dy| + 2 for each edge, shape (n,).

    Only these pixels can be counted otherwise than by their share of the area, each by less than one. Regions are
    polygons in image pixels, shape (n,).
    """
    boundaries = shapely.boundary(regions)
    points, row = shapely.get_coordinates(boundaries, return_index=True)
    steps = np.abs(np.diff(points, axis=0)).sum(axis=1) * supersample + 2
    steps[row[1:] != row[:-1]] = 0.0
    crossed: Array = np.bincount(row[1:], steps, minlength=len(regions)).astype(np.float64)
    return crossed
