"""Detections of which one part is another detector's: misses, box errors, confidence, or false positives.

Where scores differ behind two detectors, the part whose exchange closes the gap is where it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.stand_in.scores import OpenFilm, found_vessels
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import at_least_a_pixel, clip, errors_between, move, sizes
from modsim3d.runs.tracker_view import TrackerDetections, anonymised

PARTS = ("misses", "confidence", "box errors", "false positives")
EXCHANGES: tuple[frozenset[str], ...] = (
    frozenset(),
    *(frozenset({part}) for part in PARTS),
    frozenset({"misses", "confidence"}),
)
"""What is exchanged; nothing at first, which says what taking detections apart changes by itself."""
SCORES = ("hota", "assa", "id_switches")
"""What is compared."""


@dataclass(frozen=True, eq=False)
class Parts:
    """What is told of detections, for the n rows of the truth; the values of a row that was missed are those of the
    same appearance of the vessel at the nearest time, and unknown where all of it was missed.

    Attributes:
        found: Whether each row is detected, shape (n,).
        known: Whether its values are known, shape (n,).
        errors: Of centre, width and height, in sides of the true box, shape (n, 4).
        confidence: Shape (n,).
        false: The detections of no vessel.
    """

    found: Mask
    known: Mask
    errors: Array
    confidence: Array
    false: TrackerDetections

    @classmethod
    def of(cls, opened: OpenFilm, detections: TrackerDetections) -> Parts:
        """Take detections apart."""
        truth = opened.truth
        found, row = found_vessels(opened, detections)
        detection = np.zeros(len(truth), dtype=np.int64)
        on_vessel = np.flatnonzero(row >= 0)
        detection[row[on_vessel]] = on_vessel
        source, known = _nearest(truth.identity, truth.frame, found)
        sides = np.tile(sizes(truth.boxes_px[source]), 2)
        boxes_px = np.vstack([detections.boxes_px, np.zeros((1, 4))])  # the last stands for none where there are none
        errors = errors_between(boxes_px[detection[source]], truth.boxes_px[source]) / sides
        confidence = np.append(detections.confidence, 0.0)[detection[source]]
        return cls(found, known, errors, confidence, detections.take(row < 0))


def _nearest(identity: Indices, frame: Indices, found: Mask) -> tuple[Indices, Mask]:
    """The found row of the same identity that is nearest in time to each row, and whether there is one."""
    source, known = np.arange(len(frame)), np.zeros(len(frame), dtype=bool)
    for number in np.unique(identity[found]):
        rows = np.flatnonzero(identity == number)
        seen = rows[found[rows]]
        source[rows] = seen[np.abs(frame[rows][:, None] - frame[seen]).argmin(axis=1)]
        known[rows] = True
    return source, known


def exchanged(opened: OpenFilm, usual: Parts, other: Parts, chosen: frozenset[str]) -> TrackerDetections:
    """Detections as `usual`, with some of `PARTS` of `other`."""
    misses, confident, boxes, false = (other if name in chosen else usual for name in PARTS)
    rows = np.flatnonzero(misses.found)
    truth = opened.truth
    errors = np.where(boxes.known[rows, None], boxes.errors[rows], misses.errors[rows])
    confidence = np.where(confident.known[rows], confident.confidence[rows], misses.confidence[rows])
    true_px = truth.boxes_px[rows]
    moved = move(true_px, errors * np.tile(sizes(true_px), 2))
    image_size_px = opened.rows.scene.cameras[0].intrinsics.image_size_px
    boxes_px = clip(at_least_a_pixel(moved, image_size_px), image_size_px)
    return anonymised(
        np.concatenate([np.searchsorted(opened.rows.frames, truth.frame[rows]), false.false.frame]),
        np.concatenate([truth.label[rows], false.false.label]),
        np.concatenate([boxes_px, false.false.boxes_px]),
        np.concatenate([confidence, false.false.confidence]),
    )
