"""Truth from pixels, drawing only where vessels overlap.

A vessel that shares no pixel with another's box is seen whole: its pixels follow from its outline by exact scan
conversion, and no buffer is needed. Vessels whose boxes do overlap form clusters, and only the part of the image in
which they overlap is drawn, once, with all of them and a depth buffer. Silhouettes are spans of pixels, an ID image is
runs of pixels, and cutting the one by the other says what is seen of each vessel and who hides the rest.

The pixels are those of the whole image, so the truth is that of `full_frame`, which draws it all and is the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.annotate.full_frame import TILE_PX, full_frame_occlusion, pixel_masks
from modsim3d.annotate.occlusion import HiddenPixels, Occlusion
from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.scan_conversion import (
    Edges,
    Spans,
    concatenate_spans,
    counts_and_boxes,
    facing,
    scan_convert,
    spans_of_ids,
    spans_of_runs,
)
from modsim3d.annotate.separating_planes import overlapping_pairs
from modsim3d.annotate.triangles import Triangles, triangles_of, within_guard
from modsim3d.arrays import Array, Indices
from modsim3d.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Ids, Region

ATLAS_PX = (1024, 1024)
"""Small clusters are drawn together into buffers of this size: a drawing costs as much as ten thousand pixels."""
SMALL_PX = 256
"""Widest and highest cluster that goes into an atlas."""

__all__ = ["pixel_masks", "rendered_occlusion"]


def rendered_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """What is seen of each outline, counted from pixels.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        renderer: Draws the ID buffers.
        supersample: Buffer pixels for each image pixel and axis; results are in image pixels all the same.
    """
    if intrinsics.distortion is not None:
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)  # silhouettes are bent: draw it all
    drawing = _Drawing(outlines, intrinsics, renderer, supersample)
    count = len(outlines)
    spans = _silhouettes(drawing)
    whole_px, whole_boxes = counts_and_boxes(spans, count)
    clusters = _clusters(outlines, np.where(outlines.boxed[:, None], whole_boxes, drawing.pixel_boxes))
    if any(max(cluster.region.width / TILE_PX[0], cluster.region.height / TILE_PX[1]) > 1 for cluster in clusters):
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)  # larger than a buffer: draw in tiles
    seen_px, seen_boxes = whole_px.copy(), whole_boxes.copy()
    entries = [_Seen.nothing()]
    rows = [np.empty(0, dtype=np.int64)]
    for batch in _batches(clusters):
        entries.append(_look(drawing, spans, batch))
        rows += [cluster.rows[outlines.boxed[cluster.rows]] for cluster in batch.clusters]
    clustered = np.concatenate(rows)
    if len(clustered):
        seen = concatenate_spans([entry.spans for entry in entries])
        pixels, boxes = counts_and_boxes(seen, count)
        seen_px[clustered], seen_boxes[clustered] = pixels[clustered], boxes[clustered]
    return _occlusion(drawing, whole_px, whole_boxes, seen_px, seen_boxes, entries)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a drawing says of the rows in it.

    Attributes:
        spans: Their visible pixels.
        hidden_row: Row of a hidden piece, shape (m,).
        hider: Row of what is in front of it, shape (m,).
        px: Pixels of the piece, shape (m,).
    """

    spans: Spans
    hidden_row: Indices
    hider: Indices
    px: Indices

    @classmethod
    def nothing(cls) -> _Seen:
        empty = np.empty(0, dtype=np.int64)
        return cls(Spans.none(), empty, empty, empty)


def _occlusion(
    drawing: _Drawing,
    whole_px: Array,
    whole_boxes: Array,
    seen_px: Array,
    seen_boxes: Array,
    entries: list[_Seen],
) -> Occlusion:
    """From counts in buffer pixels to truth in image pixels."""
    scale, outlines = drawing.supersample, drawing.outlines
    count = len(outlines)
    pair = np.concatenate([entry.hidden_row * count + entry.hider for entry in entries])
    keys, which = np.unique(pair, return_inverse=True)
    pieces = np.bincount(which, np.concatenate([entry.px for entry in entries]), minlength=len(keys))
    row, hider = np.divmod(keys, max(count, 1))
    hidden = HiddenPixels.of(
        row, outlines.occluder[hider], pieces.astype(np.float64)
    )  # whole numbers: an obstacle's pieces add up exactly
    return Occlusion(
        full_boxes_px=np.where(whole_px[:, None] > 0, whole_boxes / scale, outlines.boxes_px),
        visible_boxes_px=np.where(seen_px[:, None] > 0, seen_boxes / scale, np.nan),
        silhouette_px=whole_px / scale**2,
        visible_px=seen_px / scale**2,
        hidden=replace(hidden, px=hidden.px / scale**2),
    )


class _Drawing:
    """The outlines in buffer pixels, and their triangles once somebody needs them."""

    def __init__(self, outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int) -> None:
        self.outlines = outlines
        self.intrinsics = intrinsics
        self.renderer = renderer
        self.supersample = supersample
        self.size = (intrinsics.image_size_px[0] * supersample, intrinsics.image_size_px[1] * supersample)
        self._triangles: Triangles | None = None

    @property
    def triangles(self) -> Triangles:
        if self._triangles is None:
            every = triangles_of(self.outlines, self.intrinsics, self.supersample)
            # Of a whole closed solid, the faces turned to the camera hide the others.
            self._triangles = every.take(~every.of_whole | (facing(every.corners_px * self.supersample) > 0))
        return self._triangles

    @property
    def pixel_boxes(self) -> Array:
        """The least boxes of whole pixels around the silhouettes, shape (n, 4)."""
        boxes = self.outlines.boxes_px * self.supersample
        return np.concatenate([np.floor(boxes[:, :2]), np.ceil(boxes[:, 2:])], axis=1)

    def triangles_of_rows(self, rows: Indices) -> tuple[Indices, Indices]:
        """Indices of the triangles of rows, one row after another, and which of the rows each belongs to."""
        first, stop = (np.searchsorted(self.triangles.row, rows, side=side) for side in ("left", "right"))
        return _ranges(first, stop - first), np.repeat(np.arange(len(rows)), stop - first)

    def draw(self, triangles: Indices, shift: Array | float, region: Region) -> Ids:
        """Row + 1 at each pixel of a region, with triangles moved by whole pixels."""
        chosen = self.triangles
        corners = chosen.corners_px[triangles] * self.supersample + shift
        return self.renderer.draw(corners, chosen.inverse_depth[triangles], chosen.row[triangles] + 1, region)


def _silhouettes(drawing: _Drawing) -> Spans:
    """The spans of every vessel's silhouette: by scan conversion if it is a whole convex one, drawn alone if not."""
    outlines, scale = drawing.outlines, drawing.supersample
    whole = within_guard(outlines, drawing.intrinsics, scale) & outlines.boxed
    parts, alone = [], [np.flatnonzero(outlines.boxed & ~whole)]
    for part in outlines.parts:
        uncut = whole[part.rows]
        rows = part.rows[uncut]
        if not part.solid.convex:
            alone.append(rows)
            continue
        corners = part.vertices_px[uncut] * scale
        spans, odd = scan_convert(corners, part.solid, Edges.of(part.solid), drawing.size)
        parts.append(Spans(rows[spans.row], spans.y, spans.start, spans.stop))
        alone.append(rows[odd])
    drawn = np.sort(np.concatenate(alone))
    if len(drawn):
        parts += _drawn_alone(drawing, drawn)
    return parts[0] if len(parts) == 1 else concatenate_spans([Spans.none(), *parts])


def _drawn_alone(drawing: _Drawing, rows: Indices) -> list[Spans]:
    """The spans of silhouettes that have to be drawn to be known; small ones share a buffer."""
    boxes, image = drawing.pixel_boxes, Region(0, 0, *drawing.size)
    uncut = drawing.outlines.in_frame_fraction == 1.0
    clusters = []
    for row in rows.tolist():
        region = Region.around(boxes[row], drawing.size).common(image)
        clusters.append(_Cluster(np.array([row]), region, region, bool(uncut[row])))
    found = []
    for batch in _batches([cluster for cluster in clusters if cluster.region.width and cluster.region.height]):
        if max(batch.size[0] / TILE_PX[0], batch.size[1] / TILE_PX[1]) > 1:
            found += _drawn_in_tiles(drawing, batch.clusters[0])
            continue
        drawn = np.concatenate([cluster.rows for cluster in batch.clusters])
        triangles, member = drawing.triangles_of_rows(drawn)
        corner = np.array([(region.x, region.y) for region in batch.regions])
        shift = (batch.places - corner)[member][:, None, :]
        ids = drawing.draw(triangles, shift, Region(0, 0, *batch.size))
        spans = spans_of_ids(ids)
        moved = np.zeros((len(drawing.outlines), 2), dtype=np.int64)
        moved[drawn] = corner - batch.places
        dx, dy = moved[spans.row].T
        found.append(Spans(spans.row, spans.y + dy, spans.start + dx, spans.stop + dx))
    return found


def _drawn_in_tiles(drawing: _Drawing, cluster: _Cluster) -> list[Spans]:
    """The spans of one silhouette that is larger than a buffer."""
    region, parts = cluster.region, []
    triangles, _ = drawing.triangles_of_rows(cluster.rows)
    for y in range(region.y, region.y + region.height, TILE_PX[1]):
        for x in range(region.x, region.x + region.width, TILE_PX[0]):
            spans = spans_of_ids(drawing.draw(triangles, 0.0, Region(x, y, *TILE_PX).common(region)))
            parts.append(Spans(spans.row, spans.y + y, spans.start + x, spans.stop + x))
    return parts


@dataclass(frozen=True, eq=False)
class _Cluster:
    """Vessels of a frame that overlap each other, directly or through others, and what else may hide them.

    Attributes:
        rows: Of the outlines, ascending.
        box: Smallest region that holds all their pixels.
        region: The smallest that holds every pixel that a vessel of them may share.
        uncut: Whether all of them are vessels that lie inside the image.
    """

    rows: Indices
    box: Region
    region: Region
    uncut: bool


def _clusters(outlines: Outlines, boxes: Array) -> list[_Cluster]:
    """Connected groups of vessels whose pixel boxes overlap, each with what only hides and overlaps one of them."""
    boxed = outlines.boxed
    first, second = overlapping_pairs(outlines.frame, boxes, boxed)
    if not len(first):
        return []
    both = boxed[first] & boxed[second]
    label = _components(first[both], second[both], len(boxed))
    # Of a pair with one vessel, the cluster is that vessel's: a quay must not join all that lies along it.
    names = label[np.where(boxed[first], first, second)]
    shared = np.concatenate(
        [np.maximum(boxes[first, :2], boxes[second, :2]), np.minimum(boxes[first, 2:], boxes[second, 2:])], axis=1
    )
    membership = np.unique(np.concatenate([np.stack([names, first]), np.stack([names, second])], axis=1), axis=1)
    pairs = np.argsort(names, kind="stable")
    clusters = np.unique(names)
    starts = np.searchsorted(membership[0], clusters)
    members = membership[1]
    regions = _unions(shared[pairs], names[pairs], clusters)
    unions = _unions(boxes[members], membership[0], clusters)
    uncut = (outlines.in_frame_fraction == 1.0) & boxed
    return [
        _Cluster(rows, box, region, bool(uncut[rows].all()))
        for rows, box, region in zip(np.split(members, starts[1:]), unions, regions, strict=True)
    ]


def _components(first: Indices, second: Indices, count: int) -> Indices:
    """A label for each of `count` rows that is the same for rows joined by pairs: the least row among them.

    Labels flow along the pairs until none changes. (SciPy's would do it too, for a tenth of a second's import.)
    """
    label = np.arange(count)
    while True:
        least = np.minimum(label[first], label[second])
        if np.array_equal(least, label[first]) and np.array_equal(least, label[second]):
            return label
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)


def _unions(boxes: Array, label: Indices, names: Indices) -> list[Region]:
    """The region that holds all boxes of each label; boxes are ordered by label."""
    first = np.searchsorted(label, names)
    low = np.minimum.reduceat(boxes[:, :2], first, axis=0).astype(int)
    size = np.maximum.reduceat(boxes[:, 2:], first, axis=0).astype(int) - low
    return [Region(x, y, w, h) for (x, y), (w, h) in zip(low.tolist(), size.tolist(), strict=True)]


@dataclass(frozen=True, eq=False)
class _Batch:
    """Clusters that are drawn together, each at a place of its own.

    Attributes:
        clusters: One or more.
        places: Columns and rows of their top-left corners in the buffer, shape (k, 2).
        size: Width and height of the buffer.
        regions: What of the image is drawn of each.
    """

    clusters: list[_Cluster]
    places: Indices
    size: tuple[int, int]
    regions: list[Region]


def _batches(clusters: list[_Cluster]) -> list[_Batch]:
    """Small clusters side by side in rows of an atlas; large ones each alone, where only what overlaps is drawn.

    In an atlas nothing keeps a vessel off its neighbour's place but its own box, so the whole cluster is drawn. A
    vessel cut by the image edge reaches beyond its box; a cluster that touches an edge is drawn alone.
    """
    batches, waiting = [], []
    for cluster in clusters:
        box = cluster.box
        if max(box.width, box.height) > SMALL_PX or not cluster.uncut:
            region = cluster.region
            place = np.zeros((1, 2), dtype=np.int64)
            batches.append(_Batch([cluster], place, (region.width, region.height), [region]))
        else:
            waiting.append(cluster)
    waiting.sort(key=lambda cluster: cluster.box.height)
    while waiting:
        taken, places, x, y, shelf = 0, [], 0, 0, 0
        for cluster in waiting:
            width, height = cluster.box.width, cluster.box.height
            if x + width > ATLAS_PX[0]:
                x, y, shelf = 0, y + shelf, 0
            if y + height > ATLAS_PX[1]:
                break
            places.append((x, y))
            x, shelf, taken = x + width, max(shelf, height), taken + 1
        chosen, waiting = waiting[:taken], waiting[taken:]
        regions = [cluster.box for cluster in chosen]
        batches.append(_Batch(chosen, np.array(places), (ATLAS_PX[0], y + shelf), regions))
    return batches


def _look(drawing: _Drawing, spans: Spans, batch: _Batch) -> _Seen:
    """Draw a batch and cut its rows' silhouettes by what is in front."""
    rows = np.concatenate([cluster.rows for cluster in batch.clusters])
    cluster = np.repeat(np.arange(len(batch.clusters)), [len(c.rows) for c in batch.clusters])
    corner = np.array([(region.x, region.y) for region in batch.regions])
    size = np.array([(region.width, region.height) for region in batch.regions])
    shift = batch.places - corner
    triangles, member = drawing.triangles_of_rows(rows)
    ids = drawing.draw(triangles, shift[cluster[member]][:, None, :], Region(0, 0, *batch.size))
    boxed = drawing.outlines.boxed[rows]
    rows, cluster = rows[boxed], cluster[boxed]  # from here on, what is seen of the vessels
    place_of_row = np.zeros(len(drawing.outlines), dtype=np.int64)
    place_of_row[rows] = cluster
    first, stop = np.searchsorted(spans.row, rows, side="left"), np.searchsorted(spans.row, rows, side="right")
    own = spans.take(_ranges(first, stop - first))
    here = place_of_row[own.row]
    low, high = corner[here], corner[here] + size[here]
    start, end = np.clip(own.start, low[:, 0], high[:, 0]), np.clip(own.stop, low[:, 0], high[:, 0])
    drawn = (own.y >= low[:, 1]) & (own.y < high[:, 1]) & (end > start)
    # What lies outside the drawn region is shared with nobody.
    end, start = np.where(drawn, end, own.stop), np.where(drawn, start, own.stop)
    before = Spans(own.row, own.y, own.start, start).take(start > own.start)
    after = Spans(own.row, own.y, end, own.stop).take(own.stop > end)
    inside = Spans(own.row, own.y, start, end).take(drawn)
    base = (inside.y + shift[here[drawn], 1]) * batch.size[0] + shift[here[drawn], 0]
    pieces, who, piece_of = _cut(ids, base + inside.start, base + inside.stop)
    # Where nothing was drawn, the rasteriser lost a pixel on an edge inside the silhouette: nobody hides it.
    mine = (who == inside.row[piece_of]) | (who < 0)
    row, y, offset = inside.row[piece_of], inside.y[piece_of], base[piece_of]
    visible = Spans(row, y, pieces[0] - offset, pieces[1] - offset).take(mine)
    hidden = ~mine
    return _Seen(concatenate_spans([before, after, visible]), row[hidden], who[hidden], (pieces[1] - pieces[0])[hidden])


def _cut(ids: Ids, start: Indices, stop: Indices) -> tuple[tuple[Indices, Indices], Indices, Indices]:
    """Cut stretches of a flattened ID image at the borders of its runs.

    Args:
        ids: Row + 1, shape (h, w).
        start: First place of each stretch in the flattened image, shape (m,).
        stop: The place after its last, shape (m,).

    Returns:
        Beginnings and ends of the pieces; the row that is seen in each, −1 if nothing is; the stretch of each.
    """
    run_start, run_id = spans_of_runs(ids)
    run_stop = np.append(run_start[1:], ids.size)
    first = np.searchsorted(run_start, start, side="right") - 1
    count = np.searchsorted(run_start, stop, side="left") - first
    run, stretch = _ranges(first, count), np.repeat(np.arange(len(start)), count)
    begin, end = np.maximum(run_start[run], start[stretch]), np.minimum(run_stop[run], stop[stretch])
    return (begin, end), run_id[run] - 1, stretch


def _ranges(first: Indices, count: Indices) -> Indices:
    """The numbers first, first + 1, … of each range, one range after another."""
    total = np.cumsum(count)
    offset = first - np.concatenate([[0], total[:-1]]) if len(first) else first
    numbers: Indices = np.arange(int(total[-1]) if len(total) else 0) + np.repeat(offset, count)
    return numbers
