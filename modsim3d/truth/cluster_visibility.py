"""Visible parts of the vessels of clusters, and who hides the rest: silhouettes cut by runs of IDs, or in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask, distinct, extents, ranges, run_starts
from modsim3d.render.id_pass import Ids, Region, Sheet
from modsim3d.truth.buffer_drawing import BufferDrawing
from modsim3d.truth.occlusion_order import overlapping_pairs
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.silhouettes import Spans, runs_of_ids

SHEET_PX = 1024, 1024  # clusters are drawn together in buffers of this size: each costs as much as ten thousand pixels


@dataclass(frozen=True, eq=False)
class Cluster:
    """Vessels of a frame that overlap each other, directly or through others, and what else may hide them."""

    rows: Indices  # of the outlines, ascending, shape (k,)
    shared: Region  # the smallest that contains every pixel which a vessel may share with something else


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
        """Number of rows of each of the k clusters, shape (k,)."""
        return np.array([len(cluster.rows) for cluster in self.clusters])


@dataclass(frozen=True, eq=False)
class ClusteredPairs(Columns):
    """Pairs of rows whose pixel boxes overlap, of which one at least is a vessel; shapes (P,)."""

    first: Indices  # row of the outlines
    second: Indices  # row of the same frame, greater than `first`
    cluster: Indices  # number of the cluster that the pair belongs to: its smallest row that is a vessel

    @classmethod
    def of(cls, outlines: Outlines, boxes: Array) -> ClusteredPairs:
        """The pairs of vessels whose boxes (n, 4) overlap, and of vessels with obstacles. `boxes` are of whole pixels;
        their shape is that of `outlines.boxes_px`."""
        boxed = outlines.boxed
        first, second = overlapping_pairs(outlines.frame, boxes, boxed)
        both = boxed[first] & boxed[second]
        label = _components(first[both], second[both], len(boxed))
        # A pair with one vessel belongs to the cluster of that vessel: a quay must not join all that lies along it.
        return cls(first, second, label[np.where(boxed[first], first, second)])

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
    low, high = np.maximum(boxes[first, :2], boxes[second, :2]), np.minimum(boxes[first, 2:], boxes[second, 2:])
    starts = run_starts(pair_cluster)
    low = np.minimum.reduceat(low, starts, axis=0).astype(int)
    size = np.maximum.reduceat(high, starts, axis=0).astype(int) - low
    members, member_cluster = pairs.members()
    rows = np.split(members, np.flatnonzero(np.diff(member_cluster)) + 1)
    corners = zip(rows, low.tolist(), size.tolist(), strict=True)
    return [Cluster(own, Region(x, y, width, height)) for own, (x, y), (width, height) in corners]


def _components(first: Indices, second: Indices, count: int) -> Indices:
    """A label for each of `count` rows: the smallest row that it is joined to by pairs, shape (count,). Labels flow
    along the pairs until none changes; `scipy.sparse.csgraph` does it too, but its import takes 0.1 s."""
    label = np.arange(count)
    while True:
        one, other = label[first], label[second]
        if (one == other).all():
            return label
        least = np.minimum(one, other)
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)


def batches_of(clusters: list[Cluster]) -> list[Batch]:
    """Clusters on shelves: in rows from left to right, the lowest ones first, so that little of a shelf is empty. A
    cluster that is larger than a sheet gets one of its own."""
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
        batches.append(Batch(chosen, Sheet([cluster.shared for cluster in chosen], np.array(places), size)))
    return batches


@dataclass(frozen=True, eq=False)
class Visibility:
    """Visible parts of the vessels of one or more clusters, drawn or in order."""

    rows: Indices  # of vessels that may be hidden in part; of all others the whole silhouette is visible, shape (k,)
    visible: Spans  # of their visible pixels
    hidden_row: Indices  # row of each hidden piece of a span, shape (m,)
    hider: Indices  # row of what is in front of it, shape (m,)
    px: Indices  # number of pixels of the piece, shape (m,)

    @classmethod
    def none(cls) -> Visibility:
        """Visibility of no vessel."""
        nothing = np.empty(0, dtype=np.int64)
        return cls(nothing, Spans.none(), nothing, nothing, nothing)

    @classmethod
    def joined(cls, parts: list[Visibility]) -> Visibility:
        """Several buffers, one at least, as one."""
        names = ("rows", "hidden_row", "hider", "px")
        rows, *hidden = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return cls(rows, Spans.join([part.visible for part in parts]), *hidden)


def visibility_in(drawing: BufferDrawing, silhouettes: Spans, batch: Batch) -> Visibility:
    """Draw a batch with a depth buffer, and cut the silhouettes of its vessels where something else is in front."""
    rows, counts, sheet = batch.rows, batch.counts, batch.sheet
    ids = drawing.draw(rows, counts, sheet)
    cluster, to_buffer = np.repeat(np.arange(len(counts)), counts), sheet.places - sheet.corners
    vessel = drawing.outlines.boxed[rows]
    rows, cluster = rows[vessel], cluster[vessel]
    first, stop = (np.searchsorted(silhouettes.row, rows, side=side) for side in ("left", "right"))
    own = silhouettes.take(ranges(first, stop - first))
    own_cluster = np.repeat(cluster, stop - first)
    outside, inside, drawn = _split_at_regions(own, own_cluster, sheet)
    base = (inside.y + to_buffer[own_cluster[drawn], 1]) * sheet.size[0] + to_buffer[own_cluster[drawn], 0]
    (begin, end), seen_row, span = _cut_at_runs(ids, base + inside.start, base + inside.stop)
    # Where nothing was drawn, the rasteriser lost a pixel on an edge inside the silhouette: nothing hides it.
    visible = (seen_row == inside.row[span]) | (seen_row < 0)
    pieces = Spans(inside.row[span], inside.y[span], begin - base[span], end - base[span])
    hidden = pieces.take(~visible)
    spans = Spans.join([*outside, pieces.take(visible)])
    return Visibility(rows, spans, hidden.row, seen_row[~visible], hidden.stop - hidden.start)


def _split_at_regions(spans: Spans, cluster: Indices, sheet: Sheet) -> tuple[tuple[Spans, Spans], Spans, Mask]:
    """Cut m spans, in image coordinates, at the borders of the drawn regions, outside of which no pixel is shared with
    anything else; `cluster` is the index of the cluster of each, shape (m,). Returns the parts left and right of the
    regions; the parts inside; and which spans have a part inside, shape (m,)."""
    regions = np.array([(r.x, r.y, r.x + r.width, r.y + r.height) for r in sheet.regions])
    left, top, right, bottom = regions[cluster].T
    start, stop = np.clip(spans.start, left, right), np.clip(spans.stop, left, right)
    drawn = (spans.y >= top) & (spans.y < bottom) & (stop > start)
    # A span that is not drawn counts as left of its region as a whole.
    start, stop = np.where(drawn, start, spans.stop), np.where(drawn, stop, spans.stop)
    before = Spans(spans.row, spans.y, spans.start, start).take(start > spans.start)
    after = Spans(spans.row, spans.y, stop, spans.stop).take(spans.stop > stop)
    return (before, after), Spans(spans.row, spans.y, start, stop).take(drawn), drawn


def _cut_at_runs(ids: Ids, start: Indices, stop: Indices) -> tuple[tuple[Indices, Indices], Indices, Indices]:
    """Cut stretches of a flattened ID image, each from a place `start` (m,) to the place before `stop`, into pieces at
    the borders of its runs: begin and end of the k pieces; the row that is seen in each, −1 if nothing is; the stretch
    of each; all (k,)."""
    run_start, run_id = runs_of_ids(ids)
    run_stop = np.append(run_start[1:], ids.size)
    first = np.searchsorted(run_start, start, side="right") - 1
    count = np.searchsorted(run_start, stop, side="left") - first
    run, stretch = ranges(first, count), np.repeat(np.arange(len(start)), count)
    begin, end = np.maximum(run_start[run], start[stretch]), np.minimum(run_stop[run], stop[stretch])
    return (begin, end), run_id[run] - 1, stretch


@dataclass(frozen=True, eq=False)
class OrderedClusters:
    """Clusters whose solids are in order from near to far."""

    pairs: ClusteredPairs  # all of these clusters
    ranks: Indices  # of all n rows; of two in a cluster with a pixel in common, the one in front has the lower, (n,)
    silhouettes: Spans  # of their rows, and maybe of others, ordered by row


def visibility_in_order(ordered: OrderedClusters, boxed: Mask, image_size_px: tuple[int, int]) -> Visibility:
    """Cut the silhouettes of vessels, those rows that are `boxed` (n,), where something else of their cluster is in
    front, without drawing. The size of the image is in buffer pixels."""
    width, height = image_size_px
    rows, cluster = ordered.pairs.members()
    farthest_first = np.argsort(-ordered.ranks[rows], kind="stable")
    first, count = extents(ordered.silhouettes.row, rows[farthest_first])
    spans = ordered.silhouettes.take(ranges(first, count))
    # The scan lines of all clusters in a row: where a line begins there, and where spans begin and end.
    line = (np.repeat(cluster[farthest_first], count) * height + spans.y) * (width + 1)
    cuts, (begin, end) = _cuts(line + spans.start, line + spans.stop)
    # Between two cuts, a piece of the line shows one span all along: the one that is painted last.
    piece, span = ranges(begin, end - begin), np.repeat(np.arange(len(begin)), end - begin)
    front = np.full(len(cuts), -1)
    front[piece] = span
    behind = np.flatnonzero((front[piece] != span) & boxed[spans.row][span])
    piece, span = piece[behind], span[behind]
    # Many pieces of a row are hidden by the same other row.
    couple, hidden_px = _sums(spans.row[span] * len(boxed) + spans.row[front[piece]], cuts[piece + 1] - cuts[piece])
    hidden, hider = np.divmod(couple, len(boxed))
    is_hidden = np.zeros(len(boxed), dtype=bool)
    is_hidden[hidden] = True
    # What is left of the hidden rows is where they are in front.
    piece = np.flatnonzero((front >= 0) & is_hidden[spans.row][front])
    span = front[piece]
    visible = Spans(spans.row[span], spans.y[span], cuts[piece] - line[span], cuts[piece + 1] - line[span])
    return Visibility(np.flatnonzero(is_hidden), visible, hidden, hider, hidden_px)


def _cuts(starts: Indices, stops: Indices) -> tuple[Indices, Indices]:
    """The distinct ends of m ranges, ascending, and the number among them of each start and stop, shape (2, m)."""
    ends = np.concatenate([starts, stops])
    order = np.argsort(ends)
    first = order[run_starts(ends[order])]
    is_first, number = np.zeros(len(ends), dtype=np.int64), np.empty(len(ends), dtype=np.int64)
    is_first[first] = 1
    number[order] = is_first[order].cumsum() - 1
    return ends[first], number.reshape(2, -1)


def _sums(keys: Indices, values: Indices) -> tuple[Indices, Indices]:
    """The distinct keys, ascending, and the sum of the values of each; `keys` and `values` have shape (m,)."""
    order = np.argsort(keys)
    keys, values = keys[order], values[order]
    first = run_starts(keys)
    return keys[first], np.add.reduceat(values, first) if len(first) else values
