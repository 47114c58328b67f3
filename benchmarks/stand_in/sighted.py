"""A film's truth with what a detector put out for it, freed of what only a file or a format would tell.

A real detector's boxes and simulated ones are put on the same grid, cut at the image's edge, held against the same
least confidence and matched to the truth by the same rule before anything is measured in them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas, clip, errors_between, intersections, iou, sizes
from modsim3d.formats.labelled import LabelledSet, Results
from modsim3d.formats.matching import Rule, match
from modsim3d.runs.tracker_view import TrackerDetections

GRID_PX, CONFIDENCE_GRID = 0.5, 0.01
"""Files round boxes and confidences differently: both are rounded to these."""
RULE = Rule("confidence")
CONTINUES_IOU = 0.3
"""A false positive that overlaps one of the frame before by so much goes on."""
INSIDE = 0.7
"""A false positive with so much of its area inside a vessel's box is a part of that vessel."""


def shown_as(truth: LabelledSet, found: TrackerDetections) -> LabelledSet:
    """A film's truth with detections that are put out for its images, whose index is the frame."""
    return replace(truth, results=Results(found.frame, found.label, found.boxes_px, found.confidence).by_image())


def on_one_grid(labelled: LabelledSet, threshold: float) -> LabelledSet:
    """The detections on a common grid, inside the image and at or above a confidence, in an order of their own.

    Args:
        labelled: Images, truth and detections with confidences.
        threshold: Least confidence, compared after rounding.
    """
    results = labelled.results
    boxes_px = np.round(results.boxes_px / GRID_PX) * GRID_PX
    size_px = labelled.images.sizes_px[results.image]
    boxes_px = np.where(np.isnan(size_px[:, :1]), boxes_px, clip(boxes_px, size_px))
    confidence = np.round(results.confidence / CONFIDENCE_GRID) * CONFIDENCE_GRID
    kept = np.flatnonzero((confidence >= threshold - 1e-9) & np.all(sizes(boxes_px) > 0, axis=1))
    order = kept[np.lexsort((*boxes_px[kept].T, -confidence[kept], results.image[kept]))]
    found = Results(results.image[order], results.label[order], boxes_px[order], confidence[order])
    return replace(labelled, results=found)


@dataclass(frozen=True, eq=False)
class Sighted:
    """What became of each annotation of a film, T rows, and of each detection, D rows.

    Attributes:
        labelled: The film on the common grid; see `on_one_grid`.
        detection: Row of the detection of each annotation, −1 where missed, shape (T,).
        false: Rows of the false positives, shape (f,).
    """

    labelled: LabelledSet
    detection: Indices
    false: Indices

    @classmethod
    def of(cls, labelled: LabelledSet, threshold: float) -> Sighted:
        """Match the detections of a film at or above a confidence."""
        labelled = on_one_grid(labelled, threshold)
        matched = match(labelled, RULE, threshold - 1e-9)
        return cls(labelled, matched.detection, matched.false)

    @property
    def image(self) -> Indices:
        """Image of each annotation, shape (T,)."""
        return self.labelled.annotations.image

    @property
    def visible(self) -> Array:
        """Visible fraction of each annotation, NaN where unknown, shape (T,)."""
        return self.labelled.annotations.visible_fraction

    @property
    def boxes_px(self) -> Array:
        """Annotated boxes, shape (T, 4)."""
        return self.labelled.annotations.boxes_px

    @property
    def hit(self) -> Mask:
        """Whether each annotation was detected, shape (T,)."""
        return self.detection >= 0

    @cached_property
    def error(self) -> Array:
        """e_x, e_y, e_w, e_h in sides of the annotated box, NaN where missed, shape (T, 4)."""
        error, rows = np.full((len(self.image), 4), np.nan), np.flatnonzero(self.hit)
        boxes_px = self.boxes_px[rows]
        sides_px = np.tile(np.maximum(sizes(boxes_px), 1), 2)
        error[rows] = errors_between(self.labelled.results.boxes_px[self.detection[rows]], boxes_px) / sides_px
        return error

    @cached_property
    def overlap(self) -> Array:
        """IoU of each annotation with its detection, NaN where missed, shape (T,)."""
        overlap, rows = np.full(len(self.image), np.nan), np.flatnonzero(self.hit)
        overlap[rows] = iou(self.labelled.results.boxes_px[self.detection[rows]], self.boxes_px[rows])
        return overlap

    @cached_property
    def confidence(self) -> Array:
        """Confidence in each annotation, NaN where missed, shape (T,)."""
        confidence, rows = np.full(len(self.image), np.nan), np.flatnonzero(self.hit)
        confidence[rows] = self.labelled.results.confidence[self.detection[rows]]
        return confidence

    @cached_property
    def previous(self) -> Indices:
        """Row of the same vessel in the image before, −1 where it was not annotated there, shape (T,)."""
        annotations, images = self.labelled.annotations, self.labelled.images
        previous = np.full(len(self.image), -1)
        order = np.lexsort((self.image, annotations.identity))
        earlier, later = order[:-1], order[1:]
        same = (annotations.identity[earlier] == annotations.identity[later]) & (annotations.identity[later] >= 0)
        same &= self.image[later] == self.image[earlier] + 1
        same &= images.sequence[self.image[later]] == images.sequence[self.image[earlier]]
        previous[later[same]] = earlier[same]
        return previous

    @cached_property
    def false_boxes_px(self) -> Array:
        """Boxes of the false positives, shape (f, 4)."""
        return self.labelled.results.boxes_px[self.false]

    @cached_property
    def false_image(self) -> Indices:
        """Image of each false positive, shape (f,)."""
        return self.labelled.results.image[self.false]

    @cached_property
    def second(self) -> Mask:
        """Whether each false positive lies on a vessel: a second box for it or a part of it, shape (f,)."""
        first, vessel = pairs_of_images(self.false_image, self.image)
        ours_px, theirs_px = self.false_boxes_px[first], self.boxes_px[vessel]
        inside = intersections(ours_px, theirs_px) >= INSIDE * areas(ours_px)
        return _any_of(first[inside | (iou(ours_px, theirs_px) >= RULE.least_iou)], len(self.false))

    @cached_property
    def around_two(self) -> Mask:
        """Whether each detection holds most of two vessels or more, shape (D,)."""
        results = self.labelled.results
        found, vessel = pairs_of_images(results.image, self.image)
        theirs_px = self.boxes_px[vessel]
        holds = intersections(results.boxes_px[found], theirs_px) >= INSIDE * areas(theirs_px)
        around: Mask = np.bincount(found[holds], minlength=len(results)) >= 2
        return around

    @cached_property
    def goes_on(self) -> Mask:
        """Whether each false positive overlaps one of the image before, shape (f,)."""
        now, before = pairs_of_images(self.false_image, self.false_image + 1)
        again = iou(self.false_boxes_px[now], self.false_boxes_px[before]) >= CONTINUES_IOU
        return _any_of(now[again], len(self.false))


def pairs_of_images(first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """All pairs of rows of two tables that have the same image, given the image of each row, in any order."""
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second[order], first, side="left")
    count = np.searchsorted(second[order], first, side="right") - low
    ours = np.repeat(np.arange(len(first)), count)
    place = np.arange(len(ours)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    return ours, order[place]


def _any_of(rows: Indices, count: int) -> Mask:
    """A mask that is true at the rows given, shape (count,)."""
    mask = np.zeros(count, dtype=bool)
    mask[rows] = True
    return mask
