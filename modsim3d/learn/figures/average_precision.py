"""Precision against recall, and the area under it (Jessen & Mohr (2023), section 5.7).

Every detection counts here, whatever its confidence: the curve runs over all thresholds. COCO's own tools average the
interpolated precision at 101 levels of recall; the sum over all points (eq. 5.44) is the exact area under the same
interpolated curve, and 11 points (eq. 5.43) a coarser average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched

COCO_POINTS, FEW_POINTS = 101, 11


@dataclass(frozen=True, eq=False)
class Curve:
    """Recall, which does not fall, precision and the least confidence that gives both, shapes (m,)."""

    recall: Array
    precision: Array
    confidence: Array

    @property
    def interpolated(self) -> Array:
        """Largest precision at this recall or a larger one (eq. 5.45), shape (m,)."""
        highest: Array = np.maximum.accumulate(self.precision[::-1])[::-1]
        return highest

    def at_points(self, points: int) -> float:
        """Mean interpolated precision at evenly spaced levels of recall (eq. 5.43 with 11 points)."""
        place = np.searchsorted(self.recall, np.linspace(0, 1, points), side="left")
        return float(np.append(self.interpolated, 0.0)[place].mean())

    def all_points(self) -> float:
        """Area under the interpolated curve (eq. 5.44)."""
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.interpolated))

    def area(self) -> float:
        """Area under the curve itself, by trapezia from the first point on; level before it."""
        if not len(self.recall):
            return 0.0
        recall, precision = np.append(0.0, self.recall), np.append(self.precision[0], self.precision)
        return float(np.trapezoid(precision, recall))

    def summaries(self) -> tuple[float, float, float, float]:
        """Average precision by all points, by 11 and by COCO's 101, and the area under the curve itself."""
        return self.all_points(), self.at_points(FEW_POINTS), self.at_points(COCO_POINTS), self.area()


@dataclass(frozen=True, eq=False)
class Ranking:
    """Detections of one label, the most confident first.

    Attributes:
        image: Image of each detection, shape (m,).
        right: Whether each matches an annotation, shape (m,).
        confidence: Non-increasing, shape (m,).
        annotation_image: Image of each annotation that is to be detected, shape (T,).
    """

    image: Indices
    right: Mask
    confidence: Array
    annotation_image: Indices

    @classmethod
    def of(cls, labelled: LabelledSet, matched: Matched, label: int, images: Mask) -> Ranking:
        """Detections of a label in some images, shape (I,), matched label by label at any confidence."""
        results, annotations = labelled.results, labelled.annotations
        rows = np.flatnonzero(matched.counts & (results.label == label) & images[results.image])
        rows = rows[np.argsort(-results.confidence[rows], kind="stable")]
        sought = matched.sought & (annotations.label == label) & images[annotations.image]
        return cls(
            results.image[rows], matched.annotation[rows] >= 0, results.confidence[rows], annotations.image[sought]
        )

    def curve(self, weights: Array | None = None) -> Curve | None:
        """The curve under weights of images, shape (I,), all one if None; None if there is nothing to detect."""
        each = np.ones(len(self.image)) if weights is None else weights[self.image]
        total = len(self.annotation_image) if weights is None else float(weights[self.annotation_image].sum())
        if total <= 0:
            return None
        right = np.cumsum(np.where(self.right, each, 0.0))
        every = np.cumsum(each)
        some = every > 0
        return Curve(right[some] / total, right[some] / every[some], self.confidence[some])


def average_precisions(ranking: Ranking, weights: Array) -> Array:
    """The summaries of the curve under each row of weights (rows, I), shape (rows, 4); NaN without annotations."""
    result = np.full((len(weights), 4), np.nan)
    for row, weight in enumerate(weights):
        curve = ranking.curve(None if row == 0 and np.all(weight == 1) else weight)
        if curve is not None:
            result[row] = curve.summaries()
    return result
