"""Truth from pixels, drawn only where geometry alone does not tell them. The pixels of a closed solid follow from its
outline by exact scan conversion, as spans. Vessels whose boxes overlap form clusters. If planes between its solids put
a cluster in order from near to far, its spans are cut in that order, and nothing is drawn. Of each other cluster only
the part of the image in which boxes overlap is drawn, once, with all of its solids and a depth buffer. The ID image is
runs of equal IDs; cutting the spans at the borders of the runs gives the visible pixels of each vessel and who hides
the rest. Corners are rounded to a grid of 1/256 pixel, so a part of the image holds the same pixels as the whole. The
result is therefore exactly that of `full_frame`, which draws everything and is the reference for the tests."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, extents, ranges, run_starts
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import SUBPIXELS, IdRenderer, Region
from modsim3d.truth.buffer_drawing import BufferDrawing, fits_a_buffer, tiles_of, within_guard
from modsim3d.truth.cluster_visibility import (
    Batch,
    Cluster,
    ClusteredPairs,
    OrderedClusters,
    Visibility,
    batches_of,
    clusters_of,
    visibility_in,
    visibility_in_order,
)
from modsim3d.truth.full_frame import full_frame_occlusion, vessel_masks
from modsim3d.truth.occlusion import HiddenPixels, Occlusion
from modsim3d.truth.occlusion_order import in_boxes, order_of_pairs, overlapping_pairs, pairs_by_parts
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.scan_conversion import scan_convert
from modsim3d.truth.silhouettes import Spans, counts_and_boxes, spans_of_ids, winding_spans

DEPTH_ERROR = 1e-4
"""Solids that are apart by less than this share of their distance are left to the depth buffer. Its 24 bits hold depths
a thousand times more precisely, but it interpolates them across triangles that may be seen almost edge-on."""
MAX_ROUNDS = 64  # solids one behind the other in the longest chain whose order is looked for


def ranks_of(
    outlines: Outlines, first: Indices, second: Indices, intrinsics: Intrinsics, supersample: int
) -> tuple[Indices, Mask]:
    """Ranks of n solids, in which whatever is in front of another has the lower one, shape (n,); and whether the order
    of each pair is known and its ranks agree with it, shape (P,). Rows `first` (P,) are of solids in front of the near
    plane, `second` of those that they may have pixels in common with. The intrinsics are those of a pinhole camera;
    there are `supersample` buffer pixels per image pixel and axis."""
    nearest, farthest = outlines.depths_m()
    # A corner is moved by at most 1/512 of a buffer pixel along each axis.
    per_metre = DEPTH_ERROR + 1 / (SUBPIXELS * supersample * min(intrinsics.focal_px))
    gap_m = per_metre * np.maximum(farthest[first], farthest[second])
    first_nearer = farthest[first] + gap_m < nearest[second]
    second_nearer = farthest[second] + gap_m < nearest[first]
    asked, known = np.flatnonzero(~first_nearer & ~second_nearer), np.ones(len(first), dtype=bool)
    if len(asked):
        order = order_of_pairs(in_boxes(outlines), first[asked], second[asked], gap_m[asked])
        first_nearer[asked], second_nearer[asked] = order.first_can_hide, order.second_can_hide
        touching = asked[order.intersecting]
        first_nearer[touching] = _in_front(outlines, first[touching], second[touching], gap_m[touching])
        second_nearer[touching] = _in_front(outlines, second[touching], first[touching], gap_m[touching])
        known[touching] = first_nearer[touching] | second_nearer[touching]
    near = np.concatenate([first[first_nearer], second[second_nearer]])
    far = np.concatenate([second[first_nearer], first[second_nearer]])
    ranks = _ranks(near, far, len(outlines))
    known &= (ranks[first] < ranks[second]) | ~first_nearer
    known &= (ranks[first] > ranks[second]) | ~second_nearer
    return ranks, known


def _in_front(outlines: Outlines, near: Indices, far: Indices, gap_m: Array) -> Mask:
    """Whether solids `far` (P,) are `gap_m` (P,) beyond all faces of solids `near` (P,) that the camera may see. A ray
    meets one of these faces first, even if the solids touch: a hill that stands on an island seen from below is behind
    its shores. If the near solid is not convex, that is not known."""
    in_front = np.zeros(len(near), dtype=bool)
    for pairs, a_part, b_part in pairs_by_parts(outlines, near, far):
        if not a_part.solid.convex:
            continue
        vertices = a_part.vertices_camera[np.searchsorted(a_part.rows, near[pairs])]
        others = b_part.vertices_camera[np.searchsorted(b_part.rows, far[pairs])]
        a, b, c = np.moveaxis(vertices[:, a_part.solid.faces], 2, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        outside_m = -(normal * a).sum(axis=-1)  # how far the camera, which is at zero, is in front of each face
        nearest_m = (normal @ np.swapaxes(others, 1, 2)).max(axis=-1) + outside_m
        gap = gap_m[pairs, None]
        in_front[pairs] = ((nearest_m < -gap) | (outside_m < -gap)).all(axis=1)
    return in_front


def _ranks(near: Indices, far: Indices, count: int) -> Indices:
    """Number of solids in front of each of `count` in the longest chain of pairs from near to far, shape (count,).
    Where pairs run in a circle, there is no such number; then some pair has ranks that do not rise."""
    ranks = np.zeros(count, dtype=np.int64)
    for _ in range(MAX_ROUNDS):
        behind = ranks[near] + 1
        if (ranks[far] >= behind).all():
            break
        np.maximum.at(ranks, far, behind)
    return ranks


MAX_LINES = 32_768  # most scan lines of silhouettes that are treated at once: few calls, but arrays that fit a cache


def rendered_occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1
) -> Occlusion:
    """Visible part of each outline in image pixels, each counted from `supersample` buffer pixels on each axis."""
    if intrinsics.distortion is not None:  # silhouettes are bent: draw everything
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample)
    portions = _portions(outlines, supersample)
    if len(portions) == 1:
        return _occlusion(outlines, intrinsics, renderer, supersample)[0]
    parts = [_occlusion(outlines.between(*rows), intrinsics, renderer, supersample)[0] for rows in portions]
    return Occlusion.joined(parts)


def spans_of_frame(spans: Spans, outlines: Outlines, frame: int) -> Spans:
    """The spans of a frame, by index of the vessel in place of the row of the outlines."""
    chosen = spans.take(outlines.frame[spans.row] == frame)
    return replace(chosen, row=outlines.occluder[chosen.row])


def _portions(outlines: Outlines, supersample: int) -> list[tuple[int, int]]:
    """Runs of whole frames that have about `MAX_LINES` scan lines together, one at least: first row and stop."""
    heights = (outlines.boxes_px[:, 3] - outlines.boxes_px[:, 1]) * supersample
    before = np.cumsum(heights) - heights
    begins = run_starts(outlines.frame)
    portion = before[begins] // MAX_LINES
    later = begins[1:][np.diff(portion) != 0]
    return list(pairwise([0, *later.tolist(), len(outlines)]))


def rendered_spans(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int = 1, *, full: bool = False
) -> tuple[Spans, Spans]:
    """The pixels that `rendered_occlusion` counts of each row with a box: whole silhouettes, and their visible parts.
    With `full`, those that `full_frame_occlusion` counts."""
    if intrinsics.distortion is None and not full:
        _, silhouettes, seen = _occlusion(outlines, intrinsics, renderer, supersample)
        if seen is not None:
            cut = np.zeros(len(outlines), dtype=bool)
            cut[seen.rows] = True
            uncut, parts = silhouettes.take(~cut[silhouettes.row]), seen.visible
            return silhouettes, Spans.join([uncut, parts.take(cut[parts.row])])
    whole, shown = [Spans.none()], [Spans.none()]
    for row, masks in vessel_masks(outlines, intrinsics, renderer, supersample):
        for spans, mask in ((whole, masks.silhouette), (shown, masks.visible)):
            spans.append(spans_of_ids(mask * np.uint32(row + 1)).moved(masks.region.x, masks.region.y))
    return Spans.join(whole), Spans.join(shown)


def _occlusion(
    outlines: Outlines, intrinsics: Intrinsics, renderer: IdRenderer, supersample: int
) -> tuple[Occlusion, Spans, Visibility | None]:
    """The occlusion, with the spans of silhouettes, and how they were cut; None where the image was drawn in tiles."""
    drawing = BufferDrawing(outlines, intrinsics, renderer, supersample)
    whole = within_guard(outlines, intrinsics, supersample)
    silhouettes, drawn = _silhouettes(drawing, whole)
    full_px, full_boxes = counts_and_boxes(silhouettes, len(outlines))
    boxes = np.where(outlines.boxed[:, None], full_boxes, drawing.pixel_boxes)
    seen = _overlaps(drawing, silhouettes, boxes, whole, drawn)
    if seen is None:
        return full_frame_occlusion(outlines, intrinsics, renderer, supersample), silhouettes, None
    visible_px, visible_boxes = full_px.copy(), full_boxes.copy()
    if len(seen.rows):
        drawn_px, drawn_boxes = counts_and_boxes(seen.visible, len(outlines))
        visible_px[seen.rows], visible_boxes[seen.rows] = drawn_px[seen.rows], drawn_boxes[seen.rows]
    # In buffer pixels all counts are whole numbers, whose sums are exact; only then are they divided.
    hidden = HiddenPixels.of(seen.hidden_row, outlines.occluder[seen.hider], seen.px.astype(np.float64))
    occlusion = Occlusion(
        full_boxes_px=np.where(full_px[:, None] > 0, full_boxes / supersample, outlines.boxes_px),
        visible_boxes_px=np.where(visible_px[:, None] > 0, visible_boxes / supersample, np.nan),
        silhouette_px=full_px / supersample**2,
        visible_px=visible_px / supersample**2,
        hidden=replace(hidden, px=hidden.px / supersample**2),
        drawn=drawn,
    )
    return occlusion, silhouettes, seen


def _overlaps(drawing: BufferDrawing, silhouettes: Spans, boxes: Array, whole: Mask, drawn: Mask) -> Visibility | None:
    """Visible parts of the vessels whose boxes (n, 4) of whole pixels overlap others; None if no buffer holds them. The
    rows that are drawn for it are marked in `drawn` (n,). For `silhouettes` and `whole` see `_silhouettes`."""
    outlines = drawing.outlines
    pairs = ClusteredPairs.of(outlines, boxes)
    if not len(pairs.first):
        return Visibility.none()
    ordered = _in_order(drawing, silhouettes, boxes, pairs, whole)
    in_order = visibility_in_order(ordered, outlines.boxed, (drawing.image.width, drawing.image.height))
    if len(ordered.pairs.first) == len(pairs.first):
        return in_order
    to_draw = ~np.isin(pairs.cluster, ordered.pairs.cluster)
    clusters = clusters_of(outlines, boxes, pairs.take(to_draw))
    if not all(fits_a_buffer((cluster.shared.width, cluster.shared.height)) for cluster in clusters):
        return None
    parts = [visibility_in(drawing, silhouettes, batch) for batch in batches_of(clusters)]
    for part in parts:
        drawn[part.rows] = True
    return Visibility.joined([in_order, *parts])


def _silhouettes(drawing: BufferDrawing, whole: Mask) -> tuple[Spans, Mask]:
    """The spans of all vessels' whole silhouettes: by scan conversion where that is exact, otherwise drawn alone (n,).
    Scan conversion needs a closed solid that is `whole` (n,), of which nothing is cut off. Meshes with holes, and
    solids that the near plane cuts or that reach far outside the image, are drawn alone."""
    boxed = drawing.outlines.boxed
    spans, refused = _scan_converted(drawing, boxed & whole)
    to_draw = boxed & ~whole
    to_draw[refused] = True
    alone = _drawn_alone(drawing, np.flatnonzero(to_draw))
    return (Spans.join([spans, *alone]).ordered() if alone else spans), to_draw


def _scan_converted(drawing: BufferDrawing, rows: Mask) -> tuple[Spans, Indices]:
    """The spans of the closed solids among some rows (n,), in order; and the rows (k,) to be drawn instead."""
    parts, refused = [Spans.none()], [np.empty(0, dtype=np.int64)]
    for part in drawing.outlines.parts:
        chosen, size = rows[part.rows], (drawing.image.width, drawing.image.height)
        if not chosen.any():
            continue
        vertices, of_part = part.vertices_px[chosen] * drawing.supersample, part.rows[chosen]
        if part.solid.convex:
            spans, odd = scan_convert(vertices, part.solid, size)
        elif part.solid.closed:
            spans, odd = winding_spans(vertices, part.solid, size), np.empty(0, dtype=np.int64)
        else:
            spans, odd = Spans.none(), np.arange(len(of_part))
        parts.append(Spans(of_part[spans.row], spans.y, spans.start, spans.stop))
        refused.append(of_part[odd])
    spans = parts[-1] if len(parts) <= 2 else Spans.join(parts).ordered()
    return spans, np.concatenate(refused)


def _in_order(
    drawing: BufferDrawing, silhouettes: Spans, boxes: Array, pairs: ClusteredPairs, whole: Mask
) -> OrderedClusters:
    """The clusters in which geometry tells who is in front, with the silhouettes of the obstacles among them. Obstacles
    must be convex and `whole` (n,), so that scan conversion gives their pixels."""
    outlines = drawing.outlines
    hiding = np.zeros(len(outlines), dtype=bool)
    hiding[pairs.first] = hiding[pairs.second] = True
    hiding &= whole & outlines.convex & ~outlines.boxed
    spans, odd = _scan_converted(drawing, hiding)
    hiding[odd] = False
    asked = np.flatnonzero((hiding | (whole & outlines.boxed))[np.stack([pairs.first, pairs.second])].all(axis=0))
    # Of two obstacles that hide the same pixel of a vessel, the one in front is to be named.
    obstacles = np.flatnonzero(hiding)
    one, other = (obstacles[rows] for rows in overlapping_pairs(outlines.frame[obstacles], boxes[obstacles]))
    differ = outlines.occluder[one] != outlines.occluder[other]
    one, other = one[differ], other[differ]
    first, second = np.concatenate([pairs.first[asked], one]), np.concatenate([pairs.second[asked], other])
    ranks, known = ranks_of(outlines, first, second, drawing.intrinsics, drawing.supersample)
    doubtful = np.ones(len(pairs.first), dtype=bool)
    doubtful[asked] = ~known[: len(asked)]
    unknown = ~known[len(asked) :]
    if unknown.any():
        doubtful |= _behind_both(pairs, ranks, boxes, one[unknown], other[unknown])
    in_order = pairs.take(~np.isin(pairs.cluster, pairs.cluster[doubtful])) if doubtful.any() else pairs
    every = Spans.join([silhouettes, spans]).ordered() if len(spans.row) else silhouettes
    return OrderedClusters(in_order, ranks, every)


def _behind_both(pairs: ClusteredPairs, ranks: Indices, boxes: Array, one: Indices, other: Indices) -> Mask:
    """Mask of the pairs of an obstacle and a vessel behind it that may share pixels with a second obstacle too. The
    obstacles are rows `one` and `other`, both of shape (k,). Boxes (n, 4) are of whole pixels."""
    behind, in_front = (pairs.first, pairs.second), (pairs.second, pairs.first)
    vessel, obstacle = np.where(ranks[pairs.first] > ranks[pairs.second], behind, in_front)
    order = np.argsort(obstacle, kind="stable")
    first, count = extents(obstacle[order], one)
    pair, second = order[ranges(first, count)], np.repeat(other, count)
    three = boxes[np.stack([vessel[pair], obstacle[pair], second])]
    common = (three[..., :2].max(axis=0) < three[..., 2:].min(axis=0)).all(axis=1)
    mask = np.zeros(len(obstacle), dtype=bool)
    mask[pair[common]] = True
    return mask


def _drawn_alone(drawing: BufferDrawing, rows: Indices) -> list[Spans]:
    """The spans of silhouettes that are drawn, each at its own place; small ones share a buffer."""
    image_size_px = drawing.image.width, drawing.image.height
    small, batches = [], []
    for row in rows.tolist():
        tiles = tiles_of(Region.around(drawing.pixel_boxes[row], image_size_px))
        clusters = [Cluster(np.array([row]), tile) for tile in tiles]
        if len(tiles) <= 1:
            small += clusters
        else:  # of one silhouette, there must be only one tile in a buffer
            batches += [batch for cluster in clusters for batch in batches_of([cluster])]
    return [_drawn_in_buffer(drawing, batch) for batch in [*batches_of(small), *batches]]


def _drawn_in_buffer(drawing: BufferDrawing, batch: Batch) -> Spans:
    """The spans of the silhouettes of a batch, of which each cluster is one row."""
    spans = spans_of_ids(drawing.draw(batch.rows, batch.counts, batch.sheet))
    to_image = np.zeros((len(drawing.outlines), 2), dtype=np.int64)
    to_image[batch.rows] = batch.sheet.corners - batch.sheet.places
    return spans.moved(*to_image[spans.row].T)
