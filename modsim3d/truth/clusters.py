"""Groups of vessels that overlap in the image, and how groups are placed in the buffers that are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.render.id_pass import Region
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.overlaps import overlapping_pairs

ATLAS_PX = (1024, 1024)
"""Small clusters are drawn together in buffers of this size: one draw call costs as much as ten thousand pixels."""
SMALL_PX = 256
"""Largest width and height of a cluster that goes into an atlas."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """Vessels of a frame that overlap each other, directly or through others, and what else may hide them.

    Attributes:
        rows: Rows of the outlines, ascending, shape (k,).
        box: The smallest region that contains all their pixels.
        shared: The smallest region that contains every pixel which a vessel may share with something else.
        uncut: Whether all of them are vessels that lie inside the image.
    """

    rows: Indices
    box: Region
    shared: Region
    uncut: bool


@dataclass(frozen=True, eq=False)
class Batch:
    """Clusters that are drawn in one buffer, each at its own place.

    Attributes:
        clusters: The k clusters.
        regions: The part of the image that is drawn of each.
        places: Column and row of the top left corner of each region in the buffer, shape (k, 2).
        size: Width and height of the buffer.
    """

    clusters: list[Cluster]
    regions: list[Region]
    places: Indices
    size: tuple[int, int]

    @property
    def corners(self) -> Indices:
        """Column and row of the top left corner of each region in the image, shape (k, 2)."""
        return np.array([(region.x, region.y) for region in self.regions])


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
        member = np.unique(np.concatenate([self.cluster * count + self.first, self.cluster * count + self.second]))
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
    uncut = (outlines.in_frame_fraction == 1.0) & outlines.boxed
    starts = np.flatnonzero(np.diff(member_cluster, prepend=-1))
    return [
        Cluster(rows, box, region, bool(uncut[rows].all()))
        for rows, box, region in zip(
            np.split(members, starts[1:]),
            _unions(boxes[members], starts),
            _unions(shared, np.flatnonzero(np.diff(pair_cluster, prepend=-1))),
            strict=True,
        )
    ]


def _components(first: Indices, second: Indices, count: int) -> Indices:
    """A label for each of `count` rows: the smallest row that it is joined to by pairs, shape (count,).

    Labels flow along the pairs until none changes. `scipy.sparse.csgraph` would do it too, but its import takes a
    tenth of a second.
    """
    label = np.arange(count)
    while True:
        least = np.minimum(label[first], label[second])
        if np.array_equal(least, label[first]) and np.array_equal(least, label[second]):
            return label
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)


def _unions(boxes: Array, starts: Indices) -> list[Region]:
    """The region that contains each group of boxes; groups begin at `starts`."""
    low = np.minimum.reduceat(boxes[:, :2], starts, axis=0).astype(int)
    size = np.maximum.reduceat(boxes[:, 2:], starts, axis=0).astype(int) - low
    return [Region(x, y, w, h) for (x, y), (w, h) in zip(low.tolist(), size.tolist(), strict=True)]


def batches_of(clusters: list[Cluster]) -> list[Batch]:
    """Small clusters side by side in atlases; each other cluster alone, of which only what overlaps is drawn.

    In an atlas nothing but its own box keeps a vessel off its neighbour's place, so the whole cluster is drawn. A
    vessel cut by the image edge reaches beyond its box, so a cluster with such a vessel is drawn alone.
    """
    small = [max(cluster.box.width, cluster.box.height) <= SMALL_PX and cluster.uncut for cluster in clusters]
    alone = [_alone(cluster) for cluster, goes in zip(clusters, small, strict=True) if not goes]
    return alone + _atlases([cluster for cluster, goes in zip(clusters, small, strict=True) if goes])


def _alone(cluster: Cluster) -> Batch:
    shared = cluster.shared
    return Batch([cluster], [shared], np.zeros((1, 2), dtype=np.int64), (shared.width, shared.height))


def _atlases(clusters: list[Cluster]) -> list[Batch]:
    """Clusters on shelves: in rows from left to right, the lowest ones first, so that little of a shelf is empty."""
    atlases: list[Batch] = []
    waiting = sorted(clusters, key=lambda cluster: cluster.box.height)
    while waiting:
        places, x, y, shelf = [], 0, 0, 0
        for cluster in waiting:
            width, height = cluster.box.width, cluster.box.height
            if x + width > ATLAS_PX[0]:
                x, y, shelf = 0, y + shelf, 0
            if y + height > ATLAS_PX[1]:
                break
            places.append((x, y))
            x, shelf = x + width, max(shelf, height)
        chosen, waiting = waiting[: len(places)], waiting[len(places) :]
        boxes = [cluster.box for cluster in chosen]
        atlases.append(Batch(chosen, boxes, np.array(places), (ATLAS_PX[0], y + shelf)))
    return atlases
