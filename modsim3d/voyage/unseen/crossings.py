"""Where a vessel without a transponder passes a known one: neither of the two tells anything there.

The truth knows nothing of the one in front, so the one behind is hidden without being known to be, and a detection of
either may match the known one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import areas, centres, intersections, iou
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched, Rule, image_pairs, match
from modsim3d.voyage.unseen.links import Links
from modsim3d.voyage.unseen.sides import AT_BORDER_PX

_SAME_IOU = 0.5
_NEAR, _LEAST_NEAR_PX = 0.25, 5.0
"""How far about a vessel its box may be off, in heights of it and in pixels."""
_PASSES = 0.5
"""The largest share of the life of what passes a vessel in which the two are close."""
_MOSTLY = 0.5
"""Share of a detection that lies in a box which it may be of."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Boxes of vessels without a transponder in each image from the first detection to the last, by image.

    Attributes:
        image: Shape (n,), non-decreasing.
        boxes_px: Shape (n, 4).
        thing: Number of the thing that each is of, shape (n,).
    """

    image: Indices
    boxes_px: Array
    thing: Indices

    @classmethod
    def of(cls, links: Links, chosen: Mask, labelled: LabelledSet) -> Tracks:
        """Those of some linked detections (n,), of which each thing is one vessel."""
        images, none = labelled.images, np.empty(0, dtype=np.int64)
        image, boxes_px, number = [none], [np.empty((0, 4))], [none]
        for thing in np.unique(links.link[chosen]):
            rows = np.flatnonzero(chosen & (links.link == thing))
            rows = rows[np.argsort(links.time_s[rows])]
            seen_s, seen_px = links.time_s[rows], labelled.results.boxes_px[links.rows[rows]]
            same = images.sequence == images.sequence[links.image[rows[0]]]
            there = np.flatnonzero(same & (images.time_s >= seen_s[0]) & (images.time_s <= seen_s[-1]))
            image.append(there)
            number.append(np.full(len(there), thing))
            boxes_px.append(np.column_stack([np.interp(images.time_s[there], seen_s, edge) for edge in seen_px.T]))
        order = np.argsort(np.concatenate(image), kind="stable")
        return cls(np.concatenate(image)[order], np.concatenate(boxes_px)[order], np.concatenate(number)[order])


@dataclass(frozen=True, eq=False)
class Crossings:
    """What tells nothing since a vessel without a transponder is there.

    Attributes:
        annotations: Which annotations, shape (T,).
        results: Which detections, shape (D,).
    """

    annotations: Mask
    results: Mask


def crossings(tracks: Tracks, links: Links, labelled: LabelledSet, matched: Matched) -> Crossings:
    """Known vessels whose box one of the tracks comes close to, and the detections about them; also those at borders.

    Args:
        tracks: The vessels without a transponder.
        links: The unmatched detections.
        labelled: The set.
        matched: Its matches.
    """
    known, results, number = labelled.annotations, labelled.results, len(labelled.images)
    rows, places = _meetings(tracks, labelled, matched.rule)
    met, beside = np.zeros(len(known), dtype=bool), np.zeros(len(tracks.image), dtype=bool)
    met[rows] = beside[places] = True
    found = np.append(met, False)[matched.annotation]
    for there_image, there_px in ((known.image[met], known.boxes_px[met]), _some(tracks, beside)):
        for row, place in image_pairs(results.image, there_image, number):
            boxes = results.boxes_px[row]
            inside = intersections(boxes, there_px[place]) >= _MOSTLY * areas(boxes)
            found[row[inside & (matched.annotation[row] < 0)]] = True
    found[links.rows[at_the_border(links, labelled)]] = True
    return Crossings(met & ~known.ignored, found)


def _meetings(tracks: Tracks, labelled: LabelledSet, rule: Rule) -> tuple[Indices, Indices]:
    """Annotations and places of a track that touch in an image, or of which a detection may match the other, (n,).

    What stays with one known vessel for most of its life does not pass it: its truth may be off.
    """
    known, none = labelled.annotations, np.empty(0, dtype=np.int64)
    pairs: list[tuple[Indices, Indices, Mask]] = [(none, none, np.empty(0, dtype=bool))]
    for row, track in image_pairs(known.image, tracks.image, len(labelled.images)):
        boxes, theirs = known.boxes_px[row], tracks.boxes_px[track]
        near = np.maximum(_NEAR * (boxes[:, 3:] - boxes[:, 1:2]), _LEAST_NEAR_PX)
        touch = np.asarray(((boxes[:, :2] - near < theirs[:, 2:]) & (theirs[:, :2] < boxes[:, 2:] + near)).all(axis=1))
        reach_px = rule.most_distance_px if rule.method == "centre" else 0.0
        meet = touch | (np.linalg.norm(centres(boxes) - centres(theirs), axis=1) <= reach_px)
        pairs.append((row[meet], track[meet], touch[meet]))
    rows, places, touch = (np.concatenate(each) for each in zip(*pairs, strict=True))
    two = np.column_stack([tracks.thing[places], known.identity[rows]])
    keys, key = np.unique(two, axis=0, return_inverse=True)
    most = _PASSES * np.bincount(tracks.thing, minlength=1)[keys[:, 0]]
    passes = np.zeros(len(rows), dtype=bool)
    for chosen in (touch, np.ones(len(rows), dtype=bool)):
        together = np.bincount(key.ravel()[chosen], minlength=len(keys))
        passes |= chosen & (together <= most)[key.ravel()]
    return rows[passes], places[passes]


def at_the_border(links: Links, labelled: LabelledSet) -> Indices:
    """Linked detections of known vessels that come into view or leave it, as places among the links.

    Where positions are not surely known, such a vessel may be in view a few frames earlier or later than the truth has
    it.
    """
    known, images = labelled.annotations, labelled.images
    of_known = _border(known.boxes_px, images.sizes_px[known.image])
    rows = np.flatnonzero(of_known.any(axis=1))
    rows = rows[np.argsort(images.time_s[known.image[rows]], kind="stable")]
    of_image = known.image[rows]
    time_s, below = images.time_s[of_image], _below_horizon(labelled, of_image, known.boxes_px[rows])
    found = []
    for place in np.flatnonzero(links.at_border & np.isfinite(links.time_s)).tolist():
        when, row = float(links.time_s[place]), links.rows[place]
        near = np.arange(*np.searchsorted(time_s, [when - links.longest_gap_s, when + links.longest_gap_s]))
        box, image = labelled.results.boxes_px[[row]], links.image[[place]]
        side, (top, bottom) = _border(box, images.sizes_px[image])[0], _below_horizon(labelled, image, box)[0]
        same = images.sequence[known.image[rows[near]]] == images.sequence[links.image[place]]
        same &= (of_known[rows[near]] & side).any(axis=1)
        common = np.minimum(below[near, 1], bottom) - np.maximum(below[near, 0], top)
        both = np.maximum(below[near, 1], bottom) - np.minimum(below[near, 0], top)
        if (same & (common >= _MOSTLY * both)).any():
            found.append(place)
    return np.array(found, dtype=np.int64)


def _below_horizon(labelled: LabelledSet, image: Indices, boxes_px: Array) -> Array:
    """How far the upper and the lower edge of boxes (n, 4) lie below the horizon of their images, shape (n, 2).

    On board, pitch moves the picture from frame to frame by more than the height of a far vessel. Where the horizon is
    unknown, edges are rows of the image.
    """
    a, b, c = labelled.images.half_planes[image].T
    with np.errstate(divide="ignore", invalid="ignore"):
        horizon = -(a * (boxes_px[:, 0] + boxes_px[:, 2]) / 2 + c) / b
    below: Array = boxes_px[:, [1, 3]] - np.where(np.isfinite(horizon), horizon, 0.0)[:, None]
    return below


def _border(boxes_px: Array, sizes_px: Array) -> Mask:
    """Whether boxes (n, 4) in images of a size (n, 2) lie at the left and at the right border, shape (n, 2)."""
    with np.errstate(invalid="ignore"):
        far = boxes_px[:, 2] >= sizes_px[:, 0] - AT_BORDER_PX
    at: Mask = np.column_stack([boxes_px[:, 0] <= AT_BORDER_PX, far])
    return at


def fainter(tracks: Tracks, labelled: LabelledSet, matched: Matched, threshold: float) -> Indices:
    """Rows of detections below the least confidence that lie where a vessel without a transponder is."""
    results = labelled.results
    faint = np.flatnonzero(results.confidence < threshold)
    if not len(faint) or not len(tracks.image):
        return faint[:0]
    faint = faint[match(labelled, replace(matched.rule, by_confidence=True)).annotation[faint] < 0]
    found = [
        faint[a][iou(results.boxes_px[faint[a]], tracks.boxes_px[b]) >= _SAME_IOU]
        for a, b in image_pairs(results.image[faint], tracks.image, len(labelled.images))
    ]
    return np.unique(np.concatenate([faint[:0], *found]))


def _some(tracks: Tracks, chosen: Mask) -> tuple[Indices, Array]:
    return tracks.image[chosen], tracks.boxes_px[chosen]
