"""Where a vessel without a transponder passes a known one: neither of the two tells anything there.

The truth knows nothing of the one in front, so the one behind is hidden without being known to be, and a detection of
either may match the known one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import areas, intersections, iou
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched, image_pairs, match
from modsim3d.voyage.unseen.links import Links

_SAME_IOU = 0.5
_NEAR, _LEAST_NEAR_PX = 0.25, 5.0
"""How far about a vessel its box may be off, in heights of it and in pixels."""
_MOSTLY = 0.5
"""Share of a detection that lies in a box which it may be of."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Boxes of vessels without a transponder in each image from the first detection to the last, by image.

    Attributes:
        image: Shape (n,), non-decreasing.
        boxes_px: Shape (n, 4).
    """

    image: Indices
    boxes_px: Array

    @classmethod
    def of(cls, links: Links, chosen: Mask, labelled: LabelledSet) -> Tracks:
        """Those of some linked detections (n,), of which each thing is one vessel."""
        images, image, boxes_px = labelled.images, [np.empty(0, dtype=np.int64)], [np.empty((0, 4))]
        for thing in np.unique(links.link[chosen]):
            rows = np.flatnonzero(chosen & (links.link == thing))
            rows = rows[np.argsort(links.time_s[rows])]
            seen_s, seen_px = links.time_s[rows], labelled.results.boxes_px[links.rows[rows]]
            same = images.sequence == images.sequence[links.image[rows[0]]]
            there = np.flatnonzero(same & (images.time_s >= seen_s[0]) & (images.time_s <= seen_s[-1]))
            image.append(there)
            boxes_px.append(np.column_stack([np.interp(images.time_s[there], seen_s, edge) for edge in seen_px.T]))
        order = np.argsort(np.concatenate(image), kind="stable")
        return cls(np.concatenate(image)[order], np.concatenate(boxes_px)[order])


@dataclass(frozen=True, eq=False)
class Crossings:
    """What tells nothing since a vessel without a transponder is there.

    Attributes:
        annotations: Which annotations, shape (T,).
        results: Which detections, shape (D,).
    """

    annotations: Mask
    results: Mask


def crossings(tracks: Tracks, labelled: LabelledSet, matched: Matched) -> Crossings:
    """Known vessels whose box one of the tracks comes close to, and the detections about them."""
    known, results, number = labelled.annotations, labelled.results, len(labelled.images)
    met, beside = np.zeros(len(known), dtype=bool), np.zeros(len(tracks.image), dtype=bool)
    for row, track in image_pairs(known.image, tracks.image, number):
        boxes, theirs = known.boxes_px[row], tracks.boxes_px[track]
        near = np.maximum(_NEAR * (boxes[:, 3:] - boxes[:, 1:2]), _LEAST_NEAR_PX)
        meets = ((boxes[:, :2] - near < theirs[:, 2:]) & (theirs[:, :2] < boxes[:, 2:] + near)).all(axis=1)
        met[row[meets]] = beside[track[meets]] = True
    found = met[matched.annotation] & (matched.annotation >= 0)
    for there_image, there_px in ((known.image[met], known.boxes_px[met]), _some(tracks, beside)):
        for row, place in image_pairs(results.image, there_image, number):
            boxes = results.boxes_px[row]
            inside = intersections(boxes, there_px[place]) >= _MOSTLY * areas(boxes)
            found[row[inside & (matched.annotation[row] < 0)]] = True
    return Crossings(met & ~known.ignored, found)


def fainter(tracks: Tracks, labelled: LabelledSet, matched: Matched, threshold: float) -> Indices:
    """Rows of detections below the least confidence that lie where a vessel without a transponder is."""
    results = labelled.results
    faint = np.flatnonzero(results.confidence < threshold)
    if not len(faint) or not len(tracks.image):
        return faint[:0]
    faint = faint[match(labelled, matched.rule).annotation[faint] < 0]
    found = [
        faint[a][iou(results.boxes_px[faint[a]], tracks.boxes_px[b]) >= _SAME_IOU]
        for a, b in image_pairs(results.image[faint], tracks.image, len(labelled.images))
    ]
    return np.unique(np.concatenate([faint[:0], *found]))


def _some(tracks: Tracks, chosen: Mask) -> tuple[Indices, Array]:
    return tracks.image[chosen], tracks.boxes_px[chosen]
