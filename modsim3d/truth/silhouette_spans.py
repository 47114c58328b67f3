"""The pixels of each vessel's whole silhouette: by scan conversion where that is exact, otherwise drawn alone."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.render.id_pass import Region
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of
from modsim3d.truth.clusters import Batch, Cluster, batches_of
from modsim3d.truth.pixel_spans import Spans, concatenate_spans, spans_of_ids
from modsim3d.truth.scan_conversion import scan_convert
from modsim3d.truth.triangles import within_guard


def silhouette_spans(drawing: BufferDrawing) -> Spans:
    """The spans of the silhouettes of all vessels.

    Scan conversion needs a convex solid that nothing is cut off. Meshes, and solids that the near plane cuts or that
    reach far outside the image, are drawn alone.
    """
    outlines, image = drawing.outlines, drawing.image
    whole = within_guard(outlines, drawing.intrinsics, drawing.supersample) & outlines.boxed
    spans, to_draw = [Spans.none()], [np.flatnonzero(outlines.boxed & ~whole)]
    for part in outlines.parts:
        uncut = whole[part.rows]
        rows = part.rows[uncut]
        if not part.solid.convex:
            to_draw.append(rows)
            continue
        vertices = part.vertices_px[uncut] * drawing.supersample
        found, odd = scan_convert(vertices, part.solid, (image.width, image.height))
        spans.append(Spans(rows[found.row], found.y, found.start, found.stop))
        to_draw.append(rows[odd])
    alone = _drawn_alone(drawing, np.sort(np.concatenate(to_draw)))
    return spans[1] if len(spans) == 2 and not alone else concatenate_spans(spans + alone)


def _drawn_alone(drawing: BufferDrawing, rows: Indices) -> list[Spans]:
    """The spans of silhouettes that are drawn, each at its own place; small ones share a buffer."""
    uncut = drawing.outlines.in_frame_fraction == 1.0
    clusters = []
    for row in rows.tolist():
        region = Region.around(drawing.pixel_boxes[row], (drawing.image.width, drawing.image.height))
        if region.width and region.height:
            clusters.append(Cluster(np.array([row]), region, region, bool(uncut[row])))
    spans = []
    for batch in batches_of(clusters):
        spans += [_drawn_in_buffer(drawing, batch)] if fits_a_buffer(batch.size) else _drawn_in_tiles(drawing, batch)
    return spans


def _drawn_in_buffer(drawing: BufferDrawing, batch: Batch) -> Spans:
    """The spans of the silhouettes of a batch, of which each cluster is one row."""
    rows = np.concatenate([cluster.rows for cluster in batch.clusters])
    triangles, member = drawing.triangles_of_rows(rows)
    to_buffer = batch.places - batch.corners
    spans = spans_of_ids(drawing.draw(triangles, to_buffer[member], Region(0, 0, *batch.size)))
    to_image = np.zeros((len(drawing.outlines), 2), dtype=np.int64)
    to_image[rows] = -to_buffer
    dx, dy = to_image[spans.row].T
    return spans.moved(dx, dy)


def _drawn_in_tiles(drawing: BufferDrawing, batch: Batch) -> list[Spans]:
    """The spans of one silhouette that is larger than a buffer."""
    (cluster,) = batch.clusters
    triangles, _ = drawing.triangles_of_rows(cluster.rows)
    unmoved = np.zeros(2, dtype=np.int64)
    return [
        spans_of_ids(drawing.draw(triangles, unmoved, tile)).moved(tile.x, tile.y) for tile in tiles_of(cluster.shared)
    ]
