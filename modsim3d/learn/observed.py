"""What the estimators of a detector's parameters look at: annotations and detections, matched, state by state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Indices, Mask
from modsim3d.boxes import errors_between
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched
from modsim3d.learn.pairs import Pairs
from modsim3d.learn.persistence_fit import Steps, steps_between


@dataclass(frozen=True, eq=False)
class Observed:
    """Annotations that are to be detected, and what became of each at a least confidence.

    Each image has the index of a state, −1 where it takes no part, shape (I,). `without` are the models of
    `form.RICHER` that are left out whatever the data carry.
    """

    labelled: LabelledSet
    matched: Matched
    states: tuple[str, ...]
    image_state: Indices
    threshold: float
    without: frozenset[str] = frozenset()

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
    def false_positives(self) -> Indices:
        """Rows of the false detections that are neither a second box nor a part of a vessel, shape (g,)."""
        return self.false

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
            self.matched.rule,
        )
