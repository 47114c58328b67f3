"""What the estimators of a detector's parameters look at: annotations and detections, matched, state by state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Indices, Mask
from modsim3d.boxes import errors_between
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched
from modsim3d.learn.kinds.counted_kinds import CountedAs, counted_as
from modsim3d.learn.observed.pairs import Pairs
from modsim3d.learn.persistence.persistence_fit import Steps, steps_between

if TYPE_CHECKING:
    from modsim3d.learn.observed.false_sightings import FalseSightings


@dataclass(frozen=True, eq=False)
class Observed:
    """Annotations that are to be detected, and what became of each at a least confidence.

    Each image has the index of a state, −1 where it takes no part, shape (I,). `without` are the models of
    `form.RICHER` that are left out whatever the data carry. `shown` are the kinds of `counted_kinds.NAMES` that are
    there, with their thresholds, where that is known; else the data decide.
    """

    labelled: LabelledSet
    matched: Matched
    states: tuple[str, ...]
    image_state: Indices
    threshold: float
    without: frozenset[str] = frozenset()
    shown: Mapping[str, float | None] | None = None

    @cached_property
    def kinds(self) -> CountedAs:
        """What each detection counts as: second boxes, parts of vessels and boxes around two are told from others."""
        return counted_as(self.labelled, self.matched, self.image_state >= 0, self.without, self.shown)

    @cached_property
    def rows(self) -> Indices:
        """Rows of the annotations that count, shape (n,)."""
        return np.flatnonzero(self.matched.sought & (self.image_state[self.labelled.annotations.image] >= 0))

    @cached_property
    def detection(self) -> Indices:
        """Row of the result that detects each annotation, −1 where none does, shape (n,)."""
        return self.kinds.detection[self.rows]

    @cached_property
    def in_merged_box(self) -> Mask:
        """Whether each annotation is in the box of another one, so that it counts as detected, shape (n,)."""
        return self.kinds.in_merged_box[self.rows]

    @cached_property
    def false(self) -> Indices:
        """Rows of the results that are false detections, second boxes and parts of vessels included, shape (f,)."""
        return self.kinds.false

    @cached_property
    def false_positives(self) -> Indices:
        """Rows of the false detections that are neither a second box nor a part of a vessel, shape (g,)."""
        return self.kinds.false_positives

    @cached_property
    def found(self) -> Indices:
        """Places of the annotations that have a detection of their own; of two in one box the larger, shape (m,)."""
        return np.flatnonzero(self.detection >= 0)

    @cached_property
    def true(self) -> Indices:
        """Rows of the results that are the one detection of an annotation, or of two in one box, shape (m,)."""
        return np.sort(self.detection[self.detection >= 0])

    @cached_property
    def unambiguous(self) -> Mask:
        """Whether each annotation would be known to be missed if it were, shape (n,).

        One that overlaps a larger one may be in its box without a trace, where boxes merge.
        """
        return ~self.kinds.ambiguous[self.rows]

    @cached_property
    def false_sightings(self) -> FalseSightings:
        """The false positives with their places relative to the horizon."""
        from modsim3d.learn.observed.false_sightings import FalseSightings

        return FalseSightings.of(self)

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
    def thing(self) -> Indices:
        """Number of the thing that each annotation is of, in its sequence, −1 where it has no identity, shape (n,)."""
        identity = self.labelled.annotations.identity[self.rows]
        keys = np.column_stack([self.labelled.images.sequence[self.image], identity])
        number: Indices = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        return np.where(identity >= 0, number, -1)

    @cached_property
    def missed(self) -> Mask:
        """Whether each annotation was missed, shape (n,)."""
        return (self.detection < 0) & ~self.in_merged_box

    @cached_property
    def seen_as(self) -> Indices:
        """Label that each annotation was detected as, k where missed, k + 1 in the box of another, shape (n,)."""
        found, k = self.labelled.results.label, len(self.labelled.labels)
        label = found[self.detection] if len(found) else np.zeros(len(self.rows), dtype=np.int64)
        return np.where(self.missed, k, np.where(self.in_merged_box, k + 1, label))

    @cached_property
    def steps(self) -> Steps:
        """Consecutive annotations of the same thing, of those that are unambiguous, as places among `rows`."""
        place = np.flatnonzero(self.unambiguous)
        steps = steps_between(self.labelled, self.rows[place])
        return Steps(place[steps.earlier], place[steps.later], steps.apart_s)

    @cached_property
    def pairs(self) -> Pairs:
        """Annotations that were detected by a box of their own, with the errors of the detected boxes."""
        place = self.found[self.kinds.one_vessel[self.detection[self.found]]]
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
            None if annotations.unsure_box is None else annotations.unsure_box[rows],
        )
