"""The confidence of detections, and the distributions of it that a detector file can choose from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.random_streams import grid_normals, on_grid
from modsim3d.detector.draws import log2

CURVE_POINTS = 2049


class ConfidenceLaw(Protocol):
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
    """An empirical distribution, straight between its quantiles."""

    quantiles: Array  # at probabilities evenly spaced from 0 to 1, ascending, shape (at least 2,)

    def at(self, uniforms: Array) -> Array:
        """Interpolated between two quantiles, shape (n,)."""
        place = uniforms * (len(self.quantiles) - 1)
        below = np.minimum(place.astype(np.int64), len(self.quantiles) - 2)
        start = self.quantiles[below]
        return np.asarray(start + (place - below) * (self.quantiles[below + 1] - start))


SCORES: Mapping[str, type[ConfidenceLaw]] = {"normal": NormalScores, "quantiles": QuantileScores}
"""Distributions of confidence by name; a precision-recall curve is turned into quantiles."""


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve, straight between points and level before them; ascending recall, and precision (n,)."""

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
        """False positives per target among the most confident that reach a recall: r·(1 − p)/p, same shape."""
        precision = self.at(recall)
        return recall * (1 - precision) / precision

    def falls(self) -> tuple[float, float] | None:
        """Two recalls between which false positives would have to vanish; None if scores can make this curve."""
        recall = np.linspace(0, self.recall[-1], CURVE_POINTS)
        falling = np.flatnonzero(np.diff(self.false_per_target(recall)) < -1e-9)
        return (float(recall[falling[0]]), float(recall[falling[0] + 1])) if len(falling) else None

    def scores(self, threshold: float) -> tuple[QuantileScores, QuantileScores]:
        """Distributions of the confidence of true detections and of false positives that make this curve. A true one is
        spread evenly over [threshold, 1], so the share q of the true ones is above the confidence c(q) = 1 − q·(1 −
        threshold), and recall there is q times the last recall R. Precision is right if the share of false ones above
        c(q) is F(q·R) / F(R) with F the false positives for each target."""
        recall = np.linspace(0, self.recall[-1], CURVE_POINTS)
        false = np.maximum.accumulate(self.false_per_target(recall))
        confidence = 1 - (1 - threshold) * recall / recall[-1]
        even = np.linspace(0, 1, CURVE_POINTS)
        true = QuantileScores(confidence[::-1].copy())
        if false[-1] == 0:
            return true, true
        return true, QuantileScores(on_grid(np.interp(even, 1 - (false / false[-1])[::-1], confidence[::-1])))


@dataclass(frozen=True, eq=False)
class StateConfidence:
    """The confidence of one performance state."""

    true: ConfidenceLaw
    false: ConfidenceLaw
    visibility_slope: float = 0.0  # loss of a wholly hidden vessel; others lose in proportion to the hidden share
    size_slope: float = 0.0  # loss for each halving of a box's size below the reference
    size_reference_px: float = 64.0  # side of a square as large as the box

    def score(self, uniforms: Array, false: Mask, visible_fraction: Array, size_px: Array) -> Array:
        """Confidence before clipping, shapes (n,)."""
        score = self.true.at(uniforms)
        if self.false is not self.true:
            score[false] = self.false.at(uniforms[false])
        if self.visibility_slope:
            score = score - self.visibility_slope * np.where(np.isnan(visible_fraction), 0, 1 - visible_fraction)
        if self.size_slope:
            score = score - self.size_slope * -log2(np.minimum(size_px / self.size_reference_px, 1.0))
        return score


@dataclass(frozen=True, eq=False)
class Confidence:
    """Scores by state, moved to the nearer end of [threshold, 1] where outside (Jessen & Mohr (2023), section 7.6.2),
    so the threshold is the least confidence of an output detection, and drops none."""

    states: Sequence[StateConfidence]
    threshold: float

    def score(self, state: Indices, false: Mask, visible_fraction: Array, size_px: Array, uniforms: Array) -> Array:
        """Confidence of detections from one uniform number each, shapes (m,). `visible_fraction` is NaN without a
        vessel or where unknown; `size_px` is the side of a square as large as the box."""
        score = np.empty(len(state))
        for index, confidence in enumerate(self.states):
            rows = (state == index).nonzero()[0]
            if not len(rows):
                continue
            score[rows] = confidence.score(uniforms[rows], false[rows], visible_fraction[rows], size_px[rows])
        return np.clip(score, self.threshold, 1.0)


# ---- Normal numbers clipped to a range ----

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_REACH = 9.0  # standard deviations that the integrals go to
_MAX_ROUNDS, _SETTLED = 400, 1e-10


def clipped_score(scores: Array, means: Array | float, std: float, threshold: float) -> Array:
    """Derivatives of the log-likelihood of scores (...) by mean and standard deviation, shape (..., 2)."""
    z = (scores - means) / std
    low, high = (threshold - np.asarray(means)) / std, (1 - np.asarray(means)) / std
    below, above = -_hazard(-low), _hazard(high)
    first = np.where(scores <= threshold, below, np.where(scores >= 1, above, z))
    second = np.where(scores <= threshold, below * low, np.where(scores >= 1, above * high, z**2 - 1))
    return np.stack([first, second], axis=-1) / std


def _hazard(z: Array) -> Array:
    """Normal density over the tail above z."""
    return np.asarray(np.exp(-(z**2) / 2 - special.log_ndtr(-z)) / np.sqrt(2 * np.pi))


def clipped_laws(means: Array, std: float, threshold: float) -> tuple[Array, Array]:
    """Quadrature nodes of the clipped law of each mean (n,), and their probabilities, shapes (n, nodes)."""
    mean = means[:, None]
    low, high = np.maximum((threshold - mean) / std, -_REACH), np.minimum((1 - mean) / std, _REACH)
    half = np.maximum((high - low) / 2, 0)  # none where all is clipped
    nodes = (low + high) / 2 + half * _NODES
    weights = half * _WEIGHTS * np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi)
    inside = np.clip(mean + std * nodes, threshold + 1e-15, 1 - 1e-15)
    places = np.hstack([np.full_like(mean, threshold), inside, np.ones_like(mean)])
    chances = np.hstack([special.ndtr((threshold - mean) / std), weights, special.ndtr(-(1 - mean) / std)])
    return places, chances


def clipped_sums(values: Array, low: float, high: float) -> Array:
    """Parts of the numbers (n,) in sums for the fit, (n, 5): at the low end, the high end, between; value, square."""
    at_low, at_high = values <= low, values >= high
    inside = ~(at_low | at_high)
    return np.column_stack([at_low, at_high, inside, inside * values, inside * values**2]) * 1.0


def fit_clipped(sums: Array, low: float, high: float) -> tuple[Array, Array]:
    """Mean and standard deviation of maximum likelihood, by expectation and maximisation (Dempster et al. (1977)), for
    each row of sums from `clipped_sums`, shape (rows, 5); results (rows,) are NaN where there are no numbers."""
    below, above, inside, first, second = sums.T
    number = below + above + inside
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (below * low + above * high + first) / number
        std = np.sqrt(np.maximum((below * low**2 + above * high**2 + second) / number - mean**2, 1e-12))
        for _ in range(_MAX_ROUNDS):
            m_low, s_low = _tail((low - mean) / std, -1)
            m_high, s_high = _tail((high - mean) / std, 1)
            total = below * (mean + std * m_low) + above * (mean + std * m_high) + first
            squares = (
                below * (mean**2 + 2 * mean * std * m_low + std**2 * s_low)
                + above * (mean**2 + 2 * mean * std * m_high + std**2 * s_high)
                + second
            )
            new_mean = total / number
            new_std = np.sqrt(np.maximum(squares / number - new_mean**2, 1e-12))
            change = np.nanmax(np.abs(new_mean - mean) + np.abs(new_std - std), initial=0.0)
            mean, std = new_mean, new_std
            if change < _SETTLED:
                break
    return mean, std


def _tail(edge: Array, side: int) -> tuple[Array, Array]:
    """Mean and mean square of a standard normal number below (−1) or above (1) an edge, shapes of the edge."""
    away = side * edge
    hazard = _hazard(away)
    return side * hazard, 1 + away * hazard


# ---- Between which probabilities of its law each confidence lies ----

Levels = tuple[Array, Array]  # probability of a smaller confidence, and of one that is not larger, shapes (n,)

_ROUNDING = 1e-9  # a value less its shift may miss a step of its law by rounding


def _normal(law: NormalScores, values: Array, shift: Array) -> Levels | None:
    if law.std == 0:
        return None
    level = special.ndtr((values - law.mean - shift) / law.std)
    return level, level


def _quantiles(law: QuantileScores, values: Array, shift: Array) -> Levels | None:
    if not np.ptp(law.quantiles):
        return None
    before = values - shift
    return _level(law.quantiles, before - _ROUNDING, "left"), _level(law.quantiles, before + _ROUNDING, "right")


def _level(quantiles: Array, values: Array, side: Literal["left", "right"]) -> Array:
    """Probability of less than each value, or with `right` of no more, under a law straight between quantiles."""
    count = np.searchsorted(quantiles, values, side=side)
    above = np.clip(count, 1, len(quantiles) - 1)
    step = np.diff(quantiles)[above - 1]
    part = (values - quantiles[above - 1]) / np.where(step > 0, step, 1)
    between = (above - 1 + part) / (len(quantiles) - 1)
    return np.where(count == 0, 0.0, np.where(count == len(quantiles), 1.0, between))


LEVELS: Mapping[str, Callable[..., Levels | None]] = {"normal": _normal, "quantiles": _quantiles}
"""The levels of values before clipping whose law is shifted, by the name of the distribution; None if it is a point."""


def drawn_levels(levels: Levels, confidence: Array, threshold: float, rng: np.random.Generator) -> Array:
    """One level for each confidence, uniform if they follow their law, shape (n,). Where several levels give one
    confidence, as at both ends of the range, one of them is drawn."""
    low = np.where(confidence <= threshold, 0.0, levels[0])
    return np.asarray(low + rng.random(len(low)) * (np.where(confidence >= 1, 1.0, levels[1]) - low))


# ---- What is known ----

_MIN_CHANCE, _NEAR = 1e-300, 1e-4


def pair_likelihood(before: Array, low: Array, high: Array, correlation: Array, factor: float = 1.0) -> Array:
    """Log-likelihood of correlations below 1, shapes (n,), of numbers between bounds; equal bounds are the number."""
    spread = np.sqrt(1 - correlation**2)
    below, above = (part / factor for part in _standard(before, low, high, correlation))
    exact = low == high
    density = -(np.where(exact, below, 0.0) ** 2) / 2 - np.log(spread * factor)
    return np.where(exact, density, np.log(np.maximum(special.ndtr(above) - special.ndtr(below), _MIN_CHANCE)))


def pair_score(before: Array, low: Array, high: Array, correlation: Array) -> Array:
    """Derivatives of `pair_likelihood` by the correlation, less what a factor explains as well, shape (n,)."""
    reach = np.minimum(_NEAR, (1 - correlation) / 2)

    def at(moved: Array, factor: float = 1.0) -> Array:
        return pair_likelihood(before, low, high, moved, factor)

    by_correlation = (at(correlation + reach) - at(correlation - reach)) / (2 * reach)
    by_factor = (at(correlation, 1 + _NEAR) - at(correlation, 1 - _NEAR)) / (2 * _NEAR)
    squares = float((by_factor**2).sum())
    share = float((by_correlation * by_factor).sum()) / squares if squares > 0 else 0.0
    return np.asarray(by_correlation - share * by_factor)


def _standard(before: Array, low: Array, high: Array, correlation: Array) -> tuple[Array, Array]:
    """Both bounds in standard deviations from the mean that the number before gives."""
    spread = np.sqrt(1 - correlation**2)
    return (low - correlation * before) / spread, (high - correlation * before) / spread
