"""The confidence of detections, and the distributions of it that a detector file can choose from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.draws import log2
from modsim3d.random_streams import grid_normals, on_grid

CURVE_POINTS = 2049


class Scores(Protocol):
    """A distribution of confidence before it is clipped."""

    def at(self, uniforms: Array) -> Array:
        """Its inverse distribution function, shape (n,)."""


@dataclass(frozen=True)
class NormalScores:
    """Normal (Jessen & Mohr (2023), section 7.6.2)."""

    mean: float
    std: float

    def at(self, uniforms: Array) -> Array:
        """Mean plus a normal number of standard deviations, shape (n,)."""
        return self.mean + self.std * grid_normals(uniforms)


@dataclass(frozen=True, eq=False)
class QuantileScores:
    """An empirical distribution, straight between its quantiles.

    Attributes:
        quantiles: At probabilities evenly spaced from 0 to 1, ascending, shape (at least 2,).
    """

    quantiles: Array

    def at(self, uniforms: Array) -> Array:
        """Interpolated between two quantiles, shape (n,)."""
        place = uniforms * (len(self.quantiles) - 1)
        below = np.minimum(place.astype(np.int64), len(self.quantiles) - 2)
        start = self.quantiles[below]
        value: Array = start + (place - below) * (self.quantiles[below + 1] - start)
        return value


SCORES: Mapping[str, type[Scores]] = {"normal": NormalScores, "quantiles": QuantileScores}
"""Distributions of confidence by name; a precision-recall curve is turned into quantiles."""


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve, straight between its points and level before the first.

    Recall, ascending, and precision are above 0, shapes (n,).
    """

    recall: Array
    precision: Array

    @classmethod
    def through(cls, points: Sequence[Sequence[float]]) -> PrecisionRecall:
        """The curve through (recall, precision) points."""
        recall, precision = np.array(points, dtype=np.float64).T
        return cls(recall, precision)

    def at(self, recall: Array) -> Array:
        """Precision at recalls, same shape."""
        return np.interp(recall, self.recall, self.precision)

    def false_per_target(self, recall: Array) -> Array:
        """False detections per target among the most confident that reach a recall: r·(1 − p)/p, same shape."""
        precision = self.at(recall)
        found: Array = recall * (1 - precision) / precision
        return found

    def falls(self) -> tuple[float, float] | None:
        """Two recalls between which false detections would have to vanish; None if scores can make this curve."""
        recall = np.linspace(0, self.recall[-1], CURVE_POINTS)
        falling = np.flatnonzero(np.diff(self.false_per_target(recall)) < -1e-9)
        return (float(recall[falling[0]]), float(recall[falling[0] + 1])) if len(falling) else None

    def scores(self, threshold: float) -> tuple[QuantileScores, QuantileScores]:
        """Distributions of the confidence of true and of false detections that make this curve.

        A true one is spread evenly over [threshold, 1], so the share q of the true ones is above the confidence
        c(q) = 1 − q·(1 − threshold), and recall there is q times the last recall R. Precision is right if the
        share of false ones above c(q) is F(q·R) / F(R) with F the false detections for each target.
        """
        recall = np.linspace(0, self.recall[-1], CURVE_POINTS)
        false = np.maximum.accumulate(self.false_per_target(recall))
        confidence = 1 - (1 - threshold) * recall / recall[-1]
        even = np.linspace(0, 1, CURVE_POINTS)
        true = QuantileScores(confidence[::-1].copy())
        if false[-1] == 0:
            return true, true
        share_above = false / false[-1]
        return true, QuantileScores(on_grid(np.interp(even, 1 - share_above[::-1], confidence[::-1])))


@dataclass(frozen=True, eq=False)
class StateConfidence:
    """The confidence of one performance state.

    Attributes:
        visibility_slope: Confidence that a wholly hidden vessel loses; others lose in proportion to the hidden share.
        size_slope: Confidence that a box loses for each halving of its size below the reference.
        size_reference_px: Reference size: the side of a square as large as the box.
    """

    true: Scores
    false: Scores
    visibility_slope: float = 0.0
    size_slope: float = 0.0
    size_reference_px: float = 64.0

    def score(self, uniforms: Array, false: Mask, visible_fraction: Array, size_px: Array) -> Array:
        """Confidence before clipping, shapes (n,)."""
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

    So the threshold is the least confidence of an output detection, and drops none.
    """

    states: Sequence[StateConfidence]
    threshold: float

    def score(self, state: Indices, false: Mask, visible_fraction: Array, size_px: Array, uniforms: Array) -> Array:
        """Confidence of detections from one uniform number each, shapes (m,).

        `visible_fraction` is NaN without a vessel or where unknown; `size_px` is the side of a square as large as the
        box.
        """
        score = np.empty(len(state))
        for index, confidence in enumerate(self.states):
            rows = (state == index).nonzero()[0]
            if not len(rows):
                continue
            score[rows] = confidence.score(uniforms[rows], false[rows], visible_fraction[rows], size_px[rows])
        return np.clip(score, self.threshold, 1.0)
