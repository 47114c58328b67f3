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

from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import IdRenderer
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer
from modsim3d.truth.cluster_visibility import Visibility, visibility_in
from modsim3d.truth.clusters import batches_of, clusters_of
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.pixel_spans import counts_and_boxes
from modsim3d.truth.silhouette_spans import silhouette_spans


def rendered_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """What is visible of each outline, counted from pixels.

    Args:
        outlines: What is in front of the camera.
        intrinsics: Intrinsics of the camera.
        renderer: Draws the ID buffers.
        supersample: Buffer pixels per image pixel and axis. Results are in image pixels.
    """
    if intrinsics.distortion is not None:  # silhouettes are bent: draw everything
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)
    drawing = BufferDrawing(outlines, intrinsics, renderer, supersample)
    silhouettes = silhouette_spans(drawing)
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
