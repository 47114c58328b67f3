"""Groups of vessels that overlap in the image, and how groups are placed in the buffers that are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, distinct, run_starts
from modsim3d.render.id_pass import Region, Sheet
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.overlaps import overlapping_pairs

SHEET_PX = 1024, 1024
"""Clusters are drawn together in buffers of this size: a buffer costs as much as ten thousand pixels."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """Vessels of a frame that overlap each other, directly or through others, and what else may hide them.

    Attributes:
        rows: Rows of the outlines, ascending, shape (k,).
        shared: The smallest region that contains every pixel which a vessel may share with something else.
    """

    rows: Indices
    shared: Region


@dataclass(frozen=True, eq=False)
class Batch:
    """Clusters that are drawn in one buffer: of each the region in which it shares pixels."""

    clusters: list[Cluster]
    sheet: Sheet

    @property
    def rows(self) -> Indices:
        """The rows of the clusters, one cluster after another, shape (m,)."""
        return np.concatenate([cluster.rows for cluster in self.clusters])

    @property
    def counts(self) -> Indices:
        """How many rows each of the k clusters has, shape (k,)."""
        return np.array([len(cluster.rows) for cluster in self.clusters])


@dataclass(frozen=True, eq=False)
class ClusteredPairs:
    """Pairs of rows whose pixel boxes overlap, of which one at least is a vessel.

    Attributes:
        first: Row of the outlines, shape (P,).
        second: Row of the same frame, greater than `first`, shape (P,).
        cluster: Number of the cluster that the pair belongs to: its smallest row that is a vessel, shape (P,).
    """

    first: Indices
    second: Indices
    cluster: Indices

    @classmethod
    def of(cls, outlines: Outlines, boxes: Array) -> ClusteredPairs:
        """The pairs of vessels whose boxes (n, 4) overlap, and of vessels with obstacles.

        `boxes` are of whole pixels; their shape is that of `outlines.boxes_px`.
        """
        boxed = outlines.boxed
        first, second = overlapping_pairs(outlines.frame, boxes, boxed)
        both = boxed[first] & boxed[second]
        label = _components(first[both], second[both], len(boxed))
        # A pair with one vessel belongs to the cluster of that vessel: a quay must not join all that lies along it.
        return cls(first, second, label[np.where(boxed[first], first, second)])

    def take(self, chosen: Mask) -> ClusteredPairs:
        """The pairs that are chosen by a mask, shape (P,)."""
        return ClusteredPairs(self.first[chosen], self.second[chosen], self.cluster[chosen])

    def members(self) -> tuple[Indices, Indices]:
        """The rows of all clusters in order of cluster and row, and the cluster of each, both of shape (k,)."""
        count = int(self.second.max(initial=-1)) + 1
        member = distinct(np.concatenate([self.cluster * count + self.first, self.cluster * count + self.second]))
        cluster, rows = np.divmod(member, max(count, 1))
        return rows, cluster


def clusters_of(outlines: Outlines, boxes: Array, pairs: ClusteredPairs) -> list[Cluster]:
    """The clusters that pairs form; `boxes` (n, 4) are of whole pixels, as for `ClusteredPairs.of`."""
    if not len(pairs.first):
        return []
    order = np.argsort(pairs.cluster, kind="stable")
    first, second, pair_cluster = pairs.first[order], pairs.second[order], pairs.cluster[order]
    shared = np.concatenate(
        [np.maximum(boxes[first, :2], boxes[second, :2]), np.minimum(boxes[first, 2:], boxes[second, 2:])], axis=1
    )
    members, member_cluster = pairs.members()
    rows = np.split(members, np.flatnonzero(np.diff(member_cluster)) + 1)
    regions = _unions(shared, run_starts(pair_cluster))
    return [Cluster(*each) for each in zip(rows, regions, strict=True)]


def _components(first: Indices, second: Indices, count: int) -> Indices:
    """A label for each of `count` rows: the smallest row that it is joined to by pairs, shape (count,).

    Labels flow along the pairs until none changes. `scipy.sparse.csgraph` would do it too, but its import takes a
    tenth of a second.
    """
    label = np.arange(count)
    while True:
        one, other = label[first], label[second]
        if (one == other).all():
            return label
        least = np.minimum(one, other)
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)


def _unions(boxes: Array, starts: Indices) -> list[Region]:
    """The region that contains each group of boxes; groups begin at `starts`."""
    low = np.minimum.reduceat(boxes[:, :2], starts, axis=0).astype(int)
    size = np.maximum.reduceat(boxes[:, 2:], starts, axis=0).astype(int) - low
    return [Region(x, y, w, h) for (x, y), (w, h) in zip(low.tolist(), size.tolist(), strict=True)]


def batches_of(clusters: list[Cluster]) -> list[Batch]:
    """Clusters on shelves: in rows from left to right, the lowest ones first, so that little of a shelf is empty.

    A cluster that is larger than a sheet gets one of its own.
    """
    batches: list[Batch] = []
    waiting = sorted(clusters, key=lambda cluster: cluster.shared.height)
    while waiting:
        width = max(SHEET_PX[0], waiting[0].shared.width)
        places: list[tuple[int, int]] = []
        x = y = shelf = 0
        for cluster in waiting:
            region = cluster.shared
            if x + region.width > width:
                x, y, shelf = 0, y + shelf, 0
            if places and (y + region.height > SHEET_PX[1] or region.width > width):
                break
            places.append((x, y))
            x, shelf = x + region.width, max(shelf, region.height)
        chosen, waiting = waiting[: len(places)], waiting[len(places) :]
        size = max(x + c.shared.width for (x, _), c in zip(places, chosen, strict=True)), y + shelf
        batches.append(Batch(chosen, Sheet([each.shared for each in chosen], np.array(places), size)))
    return batches
