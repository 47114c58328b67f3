"""What is visible of the vessels of clusters, and who hides the rest: silhouettes cut by runs of IDs, or in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices, Mask, extents, ranges, run_starts
from modsim3d.render.id_pass import Ids, Sheet
from modsim3d.truth.buffer_drawing import BufferDrawing
from modsim3d.truth.clusters import Batch, ClusteredPairs
from modsim3d.truth.pixel_spans import Spans, joined_spans, runs_of_ids


@dataclass(frozen=True, eq=False)
class Visibility:
    """What one or more clusters, drawn or in order, say about the vessels in them.

    Attributes:
        rows: Rows of vessels that may be hidden in part; of all others the whole silhouette is visible, shape (k,).
        visible: The spans of their visible pixels.
        hidden_row: Row of each hidden piece of a span, shape (m,).
        hider: Row of what is in front of it, shape (m,).
        px: Number of pixels of the piece, shape (m,).
    """

    rows: Indices
    visible: Spans
    hidden_row: Indices
    hider: Indices
    px: Indices

    @classmethod
    def none(cls) -> Visibility:
        """Of no vessel."""
        nothing = np.empty(0, dtype=np.int64)
        return cls(nothing, Spans.none(), nothing, nothing, nothing)

    @classmethod
    def joined(cls, parts: list[Visibility]) -> Visibility:
        """Several buffers, one at least, as one."""
        rows, hidden_row, hider, px = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("rows", "hidden_row", "hider", "px")
        )
        return cls(rows, joined_spans([part.visible for part in parts]), hidden_row, hider, px)


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
    return Visibility(
        rows,
        joined_spans([*outside, pieces.take(visible)]),
        hidden_row=hidden.row,
        hider=seen_row[~visible],
        px=hidden.stop - hidden.start,
    )


def _split_at_regions(spans: Spans, cluster: Indices, sheet: Sheet) -> tuple[tuple[Spans, Spans], Spans, Mask]:
    """Cut spans at the borders of the drawn regions, outside of which no pixel is shared with anything else.

    Args:
        spans: m spans, in image coordinates.
        cluster: Index of the cluster of each, shape (m,).
        sheet: Has the regions of the clusters.

    Returns:
        The parts left and right of the regions; the parts inside; and which spans have a part inside, shape (m,).
    """
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
    """Cut stretches of a flattened ID image into pieces at the borders of its runs.

    A stretch of the m runs from a place `start` to the place before `stop`.

    Returns:
        Begin and end of the k pieces; the row that is seen in each, −1 if nothing is; the stretch of each. All (k,).
    """
    run_start, run_id = runs_of_ids(ids)
    run_stop = np.append(run_start[1:], ids.size)
    first = np.searchsorted(run_start, start, side="right") - 1
    count = np.searchsorted(run_start, stop, side="left") - first
    run, stretch = ranges(first, count), np.repeat(np.arange(len(start)), count)
    begin, end = np.maximum(run_start[run], start[stretch]), np.minimum(run_stop[run], stop[stretch])
    return (begin, end), run_id[run] - 1, stretch


@dataclass(frozen=True, eq=False)
class Ordered:
    """Clusters whose solids are in order from near to far.

    Attributes:
        pairs: All pairs of these clusters.
        ranks: Of all n rows; of two in a cluster with a pixel in common, the one in front has the lower, shape (n,).
        silhouettes: The spans of their rows, and maybe of others, ordered by row.
    """

    pairs: ClusteredPairs
    ranks: Indices
    silhouettes: Spans


def visibility_in_order(ordered: Ordered, boxed: Mask, image_size_px: tuple[int, int]) -> Visibility:
    """Cut the silhouettes of vessels where something else of their cluster is in front, without drawing.

    Args:
        ordered: The clusters.
        boxed: Which rows are vessels, shape (n,).
        image_size_px: Width and height of the buffer.
    """
    width, height = image_size_px
    rows, cluster = ordered.pairs.members()
    farthest_first = np.argsort(-ordered.ranks[rows], kind="stable")
    first, count = extents(ordered.silhouettes.row, rows[farthest_first])
    spans = ordered.silhouettes.take(ranges(first, count))
    # The scan lines of all clusters in a row: where a line begins there, and where spans begin and end.
    line = (np.repeat(cluster[farthest_first], count) * height + spans.y) * (width + 1)
    ends = np.concatenate([line + spans.start, line + spans.stop])
    order = np.argsort(ends)
    new = order[run_starts(ends[order])]
    cuts, is_new, number = ends[new], np.zeros(len(ends), dtype=np.int64), np.empty(len(ends), dtype=np.int64)
    is_new[new] = 1
    number[order] = is_new[order].cumsum() - 1
    # Between two cuts, a piece of the line shows one span all along: the one that is painted last.
    begin, end = number.reshape(2, -1)
    piece, span = ranges(begin, end - begin), np.repeat(np.arange(len(begin)), end - begin)
    front = np.full(len(cuts), -1)
    front[piece] = span
    behind = np.flatnonzero((front[piece] != span) & boxed[spans.row][span])
    piece, span = piece[behind], span[behind]
    # Many pieces of a row are hidden by the same other row.
    pair, px = _sums(spans.row[span] * len(boxed) + spans.row[front[piece]], cuts[piece + 1] - cuts[piece])
    hidden_row, hider = np.divmod(pair, len(boxed))
    hidden = np.zeros(len(boxed), dtype=bool)
    hidden[hidden_row] = True
    seen = np.flatnonzero((front >= 0) & hidden[spans.row][front])
    shown = front[seen]
    visible = Spans(spans.row[shown], spans.y[shown], cuts[seen] - line[shown], cuts[seen + 1] - line[shown])
    return Visibility(np.flatnonzero(hidden), visible, hidden_row, hider, px)


def _sums(keys: Indices, values: Indices) -> tuple[Indices, Indices]:
    """The distinct keys, ascending, and the sum of the values of each; `keys` and `values` have shape (m,)."""
    order = np.argsort(keys)
    keys, values = keys[order], values[order]
    first = run_starts(keys)
    return keys[first], np.add.reduceat(values, first) if len(first) else values
