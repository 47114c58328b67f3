"""Annotations that were detected, with the errors of their boxes."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import move, sizes
from modsim3d.formats.matching import Rule
from modsim3d.learn.box_error_fits.error_fits import ErrorFits
from modsim3d.learn.box_error_fits.matched_edges import MatchedEdges


class ErrorSource(Enum):
    """Which pairs the box error of a state is learned from: the first that has enough with all sides in the image."""

    OWN_STATE = "pairs of the state"
    ALL_STATES = "pairs of all states"
    ALL_PAIRS = "pairs of all states, with sides that the image's edge cuts as they were measured"


@dataclass(frozen=True, eq=False)
class Pairs:
    """Annotations that were detected: their rows, images, states and confidences, shapes (m,).

    Attributes:
        annotated_px: The annotated box, x_min, y_min, x_max, y_max, shape (m, 4).
        error_px: e_x, e_y, e_w, e_h of the detected box, shape (m, 4).
        image_px: Width and height of the image, NaN where unknown, shape (m, 2).
        rule: The rule by which they match.
        unsure: Whether the annotated box tells nothing of box errors, shape (m,); None if that is so of none.
    """

    rows: Indices
    image: Indices
    state: Indices
    confidence: Array
    annotated_px: Array
    error_px: Array
    image_px: Array
    rule: Rule
    unsure: Mask | None = None
    _fits: dict[tuple[ErrorSource, int], ErrorFits] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @cached_property
    def sides_px(self) -> Array:
        """Width, height, width, height, at least a pixel: what relative errors are relative to; shape (m, 4)."""
        return np.tile(np.maximum(sizes(self.annotated_px), 1.0), 2)

    @cached_property
    def edges(self) -> MatchedEdges:
        """What each edge of the boxes says about their errors."""
        found = move(self.annotated_px, self.error_px)
        edges = MatchedEdges.of(self.annotated_px, found, self.image_px, self.image, self.rule)
        return edges if self.unsure is None else edges.without(self.unsure)

    @property
    def sure(self) -> Mask:
        """Which annotated boxes tell something of box errors, shape (n,); all if fewer than two do."""
        unsure = np.zeros(len(self), dtype=bool) if self.unsure is None else self.unsure
        return ~unsure if np.count_nonzero(~unsure) > 1 else np.ones(len(self), dtype=bool)

    def errors(self, chosen: Mask, relative: bool) -> Array:
        """Errors of some rows in pixels, or in sides of the box, shape (chosen, 4)."""
        result: Array = self.error_px[chosen] / (self.sides_px[chosen] if relative else 1.0)
        return result

    def fits(self, source: ErrorSource, state: int) -> ErrorFits:
        """Distributions of the errors that those of a state are learned from."""
        key = (source, state if source is ErrorSource.OWN_STATE else -1)
        if key not in self._fits:
            self._fits[key] = ErrorFits(self._edges_of(source, state))
        return self._fits[key]

    def _edges_of(self, source: ErrorSource, state: int) -> MatchedEdges:
        if source is ErrorSource.ALL_PAIRS:
            return self.edges[self.sure].as_measured()
        ours = self.edges.usable
        return self.edges[ours & (self.state == state) if source is ErrorSource.OWN_STATE else ours]
