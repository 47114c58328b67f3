"""What the estimators of a detector's parameters look at: annotations and detections, matched, state by state."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import errors_between, sizes
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched
from modsim3d.learn.persistence_fit import Steps, steps_between

_LEAST_SPREADS = 4.5
"""A box counts for its error if its sides and its distance to the image's edge are so many standard deviations."""


class ErrorSource(Enum):
    """Which pairs the box error of a state is learned from: the first that has enough."""

    OWN_STATE = "pairs of the state away from the image's edge"
    ALL_STATES = "pairs of all states away from the image's edge"
    ALL_PAIRS = "all pairs, those at the image's edge included"


@dataclass(frozen=True, eq=False)
class Observed:
    """Annotations that are to be detected, and what became of each at a least confidence.

    Each image has the index of a state, −1 where it takes no part, shape (I,).
    """

    labelled: LabelledSet
    matched: Matched
    states: tuple[str, ...]
    image_state: Indices
    threshold: float

    @cached_property
    def rows(self) -> Indices:
        """Rows of the annotations that count, shape (n,)."""
        return np.flatnonzero(self.matched.sought & (self.image_state[self.labelled.annotations.image] >= 0))

    @cached_property
    def detection(self) -> Indices:
        """Row of the result that detects each annotation, −1 where missed, shape (n,)."""
        return self.matched.detection[self.rows]

    @cached_property
    def false(self) -> Indices:
        """Rows of the results that are false detections, shape (f,)."""
        false = self.matched.false
        return false[self.image_state[self.labelled.results.image[false]] >= 0]

    @cached_property
    def image(self) -> Indices:
        """Image of each annotation, shape (n,)."""
        return self.labelled.annotations.image[self.rows]

    @cached_property
    def state(self) -> Indices:
        """State in the image of each annotation, shape (n,)."""
        return self.image_state[self.image]

    @cached_property
    def label(self) -> Indices:
        """True label of each annotation, shape (n,)."""
        return self.labelled.annotations.label[self.rows]

    @cached_property
    def missed(self) -> Mask:
        """Whether each annotation was missed, shape (n,)."""
        return self.detection < 0

    @cached_property
    def seen_as(self) -> Indices:
        """Label that each annotation was detected as, k where missed, shape (n,)."""
        found = self.labelled.results.label
        label = found[self.detection] if len(found) else np.zeros(len(self.rows), dtype=np.int64)
        return np.where(self.missed, len(self.labelled.labels), label)

    @cached_property
    def steps(self) -> Steps:
        """Consecutive annotations of the same thing, as places among `rows`."""
        return steps_between(self.labelled, self.rows)

    @cached_property
    def pairs(self) -> Pairs:
        """Annotations that were detected, with the errors of the detected boxes."""
        place = np.flatnonzero(~self.missed)
        rows, detection = self.rows[place], self.detection[place]
        annotations, results = self.labelled.annotations, self.labelled.results
        image, box_px = annotations.image[rows], annotations.boxes_px[rows]
        return Pairs(
            rows,
            image,
            self.image_state[image],
            results.confidence[detection],
            box_px,
            errors_between(results.boxes_px[detection], box_px),
            self.labelled.images.sizes_px[image],
        )


@dataclass(frozen=True, eq=False)
class Pairs:
    """Annotations that were detected: their rows, images, states and confidences, shapes (m,).

    Attributes:
        annotated_px: The annotated box, x_min, y_min, x_max, y_max, shape (m, 4).
        error_px: e_x, e_y, e_w, e_h of the detected box, shape (m, 4).
        image_px: Width and height of the image, NaN where unknown, shape (m, 2).
    """

    rows: Indices
    image: Indices
    state: Indices
    confidence: Array
    annotated_px: Array
    error_px: Array
    image_px: Array

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @cached_property
    def sides_px(self) -> Array:
        """Width, height, width, height, at least a pixel: what relative errors are relative to; shape (m, 4)."""
        return np.tile(np.maximum(sizes(self.annotated_px), 1.0), 2)

    def errors(self, chosen: Mask, relative: bool) -> Array:
        """Errors of some rows in pixels, or in sides of the box, shape (chosen, 4)."""
        result: Array = self.error_px[chosen] / (self.sides_px[chosen] if relative else 1.0)
        return result

    def of_source(self, source: ErrorSource, relative: bool, state: int) -> Mask:
        """Rows that the box error of a state is learned from, shape (m,)."""
        if source is ErrorSource.ALL_PAIRS:
            return np.ones(len(self), dtype=bool)
        unclipped = self.unclipped(relative)
        return unclipped if source is ErrorSource.ALL_STATES else unclipped & (self.state == state)

    def unclipped(self, relative: bool) -> Mask:
        """Rows whose errors the image's edge or a least side of a pixel can hardly have cut, shape (m,).

        The annotated box alone decides: leaving rows out by what was detected would itself cut errors.
        """
        return self._unclipped_by_unit[relative]

    @cached_property
    def _unclipped_by_unit(self) -> tuple[Mask, Mask]:
        return self._unclipped(np.ones_like(self.sides_px)), self._unclipped(self.sides_px)

    def _unclipped(self, unit_px: Array) -> Mask:
        low, high, size = self.annotated_px[:, :2], self.annotated_px[:, 2:], self.image_px
        unknown = np.isnan(size[:, 0])
        inner = np.all((low > 2) & (high < size - 2), axis=1) | unknown
        inner &= np.all(self.sides_px > 1, axis=1)
        chosen: Mask = inner
        if inner.sum() < 2:
            return chosen
        for _ in range(3):
            errors = self.error_px[chosen] / unit_px[chosen]
            reach = (np.abs(errors.mean(axis=0)) + _LEAST_SPREADS * errors.std(axis=0)) * unit_px
            along = reach[:, :2] + reach[:, 2:] / 2
            clear = np.all((low >= along) & (high <= size - along), axis=1)
            large = np.all(self.sides_px[:, :2] - reach[:, 2:] >= 1, axis=1)
            chosen = inner & (clear | unknown) & large
            if chosen.sum() < 2:
                break
        return chosen
