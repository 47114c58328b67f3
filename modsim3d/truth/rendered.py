"""Truth from pixels, drawn only where vessels overlap.

The pixels of a vessel whose box overlaps no other follow from its outline by exact scan conversion, so nothing is
drawn. Vessels whose boxes overlap form clusters. Of each cluster only the part of the image in which boxes overlap is
drawn, once, with all of its solids and a depth buffer. Silhouettes are spans of pixels and the ID image is runs of
equal IDs; cutting the spans at the borders of the runs gives the visible pixels of each vessel and who hides the rest.

Corners are rounded to a grid of 1/256 pixel, so a part of the image holds the same pixels as the whole. The result is
therefore exactly that of `full_frame`, which draws everything and is the reference for the tests.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer, Region
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of
from modsim3d.truth.cluster_visibility import Visibility, visibility_in
from modsim3d.truth.clusters import Batch, Cluster, batches_of, clusters_of
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.pixel_spans import Spans, concatenate_spans, counts_and_boxes, spans_of_ids
from modsim3d.truth.scan_conversion import scan_convert
from modsim3d.truth.triangles import within_guard
from modsim3d.truth.winding import winding_spans


def rendered_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """What is visible of each outline, counted from pixels.

    There are `supersample` buffer pixels per image pixel and axis; results are in image pixels.
    """
    if intrinsics.distortion is not None:  # silhouettes are bent: draw everything
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)
    drawing = BufferDrawing(outlines, intrinsics, renderer, supersample)
    silhouettes = _silhouettes(drawing)
    full_px, full_boxes = counts_and_boxes(silhouettes, len(outlines))
    clusters = clusters_of(outlines, np.where(outlines.boxed[:, None], full_boxes, drawing.pixel_boxes))
    if not all(fits_a_buffer((cluster.shared.width, cluster.shared.height)) for cluster in clusters):
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)  # which draws in tiles
    seen = Visibility.joined([visibility_in(drawing, silhouettes, batch) for batch in batches_of(clusters)])
    drawn_px, drawn_boxes = counts_and_boxes(seen.visible, len(outlines))
    visible_px, visible_boxes = full_px.copy(), full_boxes.copy()
    visible_px[seen.rows], visible_boxes[seen.rows] = drawn_px[seen.rows], drawn_boxes[seen.rows]
    # In buffer pixels all counts are whole numbers, whose sums are exact; only then are they divided.
    hidden = HiddenPixels.of(seen.hidden_row, outlines.occluder[seen.hider], seen.px.astype(np.float64))
    return Occlusion(
        full_boxes_px=np.where(full_px[:, None] > 0, full_boxes / supersample, outlines.boxes_px),
        visible_boxes_px=np.where(visible_px[:, None] > 0, visible_boxes / supersample, np.nan),
        silhouette_px=full_px / supersample**2,
        visible_px=visible_px / supersample**2,
        hidden=replace(hidden, px=hidden.px / supersample**2),
    )


def _silhouettes(drawing: BufferDrawing) -> Spans:
    """The spans of all vessels' whole silhouettes: by scan conversion where that is exact, otherwise drawn alone.

    Scan conversion needs a closed solid that nothing is cut off. Meshes with holes, and solids that the near plane cuts
    or that reach far outside the image, are drawn alone.
    """
    outlines, image = drawing.outlines, drawing.image
    whole = within_guard(outlines, drawing.intrinsics, drawing.supersample) & outlines.boxed
    spans, to_draw = [Spans.none()], [np.flatnonzero(outlines.boxed & ~whole)]
    for part in outlines.parts:
        uncut = whole[part.rows]
        rows = part.rows[uncut]
        vertices, odd = part.vertices_px[uncut] * drawing.supersample, rows[:0]
        if part.solid.convex:
            found, odd = scan_convert(vertices, part.solid, (image.width, image.height))
        elif part.solid.closed:
            found = winding_spans(vertices, part.solid, (image.width, image.height))
        else:
            found, odd = Spans.none(), np.arange(len(rows))
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
