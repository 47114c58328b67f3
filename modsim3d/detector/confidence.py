"""The confidence of detections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.draws import log2
from modsim3d.detector.scores import Scores


@dataclass(frozen=True, eq=False)
class StateConfidence:
    """The confidence of one performance state.

    Attributes:
        true: Of detections of a vessel.
        false: Of false ones.
        visibility_slope: Confidence that a wholly hidden vessel loses; others lose in proportion to the hidden share.
        size_slope: Confidence that a box loses for each halving of its size below the reference.
        size_reference_px: Side of a square as large as the box above which size does not matter.
    """

    true: Scores
    false: Scores
    visibility_slope: float = 0.0
    size_slope: float = 0.0
    size_reference_px: float = 64.0

    def score(self, uniforms: Array, false: Mask, visible_fraction: Array, size_px: Array) -> Array:
        """Confidence before clipping, shape (n,)."""
        score = self.true.at(uniforms)
        if self.false is not self.true:
            score[false] = self.false.at(uniforms[false])
        if self.visibility_slope:
            score = score - self.visibility_slope * np.where(np.isnan(visible_fraction), 0, 1 - visible_fraction)
        if self.size_slope:
            halvings = -log2(np.minimum(size_px / self.size_reference_px, 1.0))
            score = score - self.size_slope * halvings
        return score


@dataclass(frozen=True, eq=False)
class Confidence:
    """Scores by state, moved to the nearer end of [threshold, 1] where outside (Jessen & Mohr (2023), section 7.6.2).

    Attributes:
        states: In their order.
        threshold: Least confidence of an output detection; it drops none.
    """

    states: Sequence[StateConfidence]
    threshold: float

    def score(self, state: Indices, false: Mask, visible_fraction: Array, size_px: Array, uniforms: Array) -> Array:
        """Confidence of detections, from one uniform number each.

        Args:
            state: Performance state, shape (m,).
            false: Whether each is a false detection, shape (m,).
            visible_fraction: Of the vessel; NaN without a vessel or where unknown, shape (m,).
            size_px: Side of a square as large as the box, shape (m,).
            uniforms: Shape (m,).
        """
        score = np.empty(len(state))
        for index, confidence in enumerate(self.states):
            rows = np.flatnonzero(state == index)
            score[rows] = confidence.score(uniforms[rows], false[rows], visible_fraction[rows], size_px[rows])
        return np.clip(score, self.threshold, 1.0)
