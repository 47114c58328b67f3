"""Annotations that were detected, with the errors of their boxes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes

_LEAST_SPREADS = 4.5
"""A box counts for its error if its sides and its distance to the image's edge are so many standard deviations."""


class ErrorSource(Enum):
    """Which pairs the box error of a state is learned from: the first that has enough."""

    OWN_STATE = "pairs of the state away from the image's edge"
    ALL_STATES = "pairs of all states away from the image's edge"
    ALL_PAIRS = "all pairs, those at the image's edge included"


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
