"""What the estimators of a detector's parameters look at: matches, state by state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import errors_between, sizes
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.matching import Matched

_LEAST_SPREADS = 4.5
"""A box counts for its error if its sides and its distance to the image's edge are so many standard deviations."""


@dataclass(frozen=True, eq=False)
class Observed:
    """Truth that is to be found, and what became of it.

    Attributes:
        labelled: The sets.
        matched: Their matches.
        states: Names of the performance states.
        image_state: State of each image, −1 where it takes no part, shape (I,).
        rows: Rows of the truth that count, shape (n,).
        detection: Row of the detection of each, −1 where missed, shape (n,).
        false: Rows of false detections, shape (f,).
        threshold: Least confidence that took part.
    """

    labelled: LabelledSet
    matched: Matched
    states: tuple[str, ...]
    image_state: Indices
    rows: Indices
    detection: Indices
    false: Indices
    threshold: float

    @classmethod
    def of(
        cls, labelled: LabelledSet, matched: Matched, states: tuple[str, ...], image_state: Indices, threshold: float
    ) -> Observed:
        """From matches."""
        rows = np.flatnonzero(matched.sought & (image_state[labelled.annotations.image] >= 0))
        false = matched.false
        false = false[image_state[labelled.results.image[false]] >= 0]
        return cls(labelled, matched, states, image_state, rows, matched.detection[rows], false, threshold)

    @property
    def image(self) -> Indices:
        """Of each truth, shape (n,)."""
        return self.labelled.annotations.image[self.rows]

    @property
    def state(self) -> Indices:
        """Of each truth, shape (n,)."""
        return self.image_state[self.image]

    @property
    def label(self) -> Indices:
        """Of each truth, shape (n,)."""
        return self.labelled.annotations.label[self.rows]

    @property
    def missed(self) -> Mask:
        """Whether each truth was, shape (n,)."""
        return self.detection < 0

    @property
    def seen_as(self) -> Indices:
        """Label that each truth was taken for, k where missed, shape (n,)."""
        found = self.labelled.results.label
        label = found[self.detection] if len(found) else np.zeros(len(self.rows), dtype=np.int64)
        return np.where(self.missed, len(self.labelled.labels), label)

    def pairs(self) -> Pairs:
        """Truths that were found, with the errors of their boxes."""
        place = np.flatnonzero(~self.missed)
        rows, detection = self.rows[place], self.detection[place]
        truth_px = self.labelled.annotations.boxes_px[rows]
        error = errors_between(self.labelled.results.boxes_px[detection], truth_px)
        image = self.labelled.annotations.image[rows]
        return Pairs(rows, image, self.image_state[image], self.labelled.results.confidence[detection], truth_px, error)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Truths that were found, m rows.

    Attributes:
        rows: Of the truth, shape (m,).
        image: Shape (m,).
        state: Shape (m,).
        confidence: Of the detection, shape (m,).
        truth_px: Its box, shape (m, 4).
        error_px: Shape (m, 4).
    """

    rows: Indices
    image: Indices
    state: Indices
    confidence: Array
    truth_px: Array
    error_px: Array

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @property
    def sides_px(self) -> Array:
        """Width, height, width, height: what relative errors are relative to; at least a pixel; shape (m, 4)."""
        return np.tile(np.maximum(sizes(self.truth_px), 1.0), 2)

    def used(self, sizes_px: Array, unit: str, state: int) -> Mask:
        """Those that the box error of a state is learned from, by its unit in the words of `Form`, shape (m,)."""
        if "edge" in unit:
            return np.ones(len(self), dtype=bool)
        unclipped = self.unclipped(sizes_px, unit.endswith("relative"))
        return unclipped if "pooled" in unit else unclipped & (self.state == state)

    def unclipped(self, sizes_px: Array, relative: bool) -> Mask:
        """Boxes whose errors the image's edge or a least side of a pixel can hardly have cut, shape (m,).

        Which, is told from the true box alone: leaving out by what was detected would itself cut errors.
        """
        size = sizes_px[self.image]
        unit = self.sides_px if relative else np.ones_like(self.sides_px)
        inner = np.all((self.truth_px[:, :2] > 2) & (self.truth_px[:, 2:] < size - 2), axis=1) | np.isnan(size[:, 0])
        inner &= np.all(self.sides_px > 1, axis=1)
        chosen: Mask = inner
        if inner.sum() < 2:
            return chosen
        for _ in range(3):
            errors = self.error_px[chosen] / unit[chosen]
            reach = (np.abs(errors.mean(axis=0)) + _LEAST_SPREADS * errors.std(axis=0)) * unit
            along = reach[:, :2] + reach[:, 2:] / 2
            clear = np.all((self.truth_px[:, :2] >= along) & (self.truth_px[:, 2:] <= size - along), axis=1)
            large = np.all(self.sides_px[:, :2] - reach[:, 2:] >= 1, axis=1)
            chosen = inner & (clear | np.isnan(size[:, 0])) & large
            if chosen.sum() < 2:
                break
        return chosen
