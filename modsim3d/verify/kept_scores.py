"""What confidence that persists does to its checks, and the check of how long it does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.confidence import SCORES
from modsim3d.detector.confidence_levels import LEVELS
from modsim3d.detector.confidence_pairs import pair_score
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import model_name
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import CORRELATION, Estimate
from modsim3d.verify.pairs import lag_pairs, turn_before

LEAST_PAIRS = 100
_STEP, _LEAST_LEVEL = 1e-4, 1e-12
_HARDLY_ANY = 0.02
_MOST_CORRELATION = 1 - 1e-9


@dataclass(frozen=True, eq=False)
class KeptScores:
    """Confidences that persist along tracks: rows of tracks (n, k), times (n,), and the correlation time."""

    tracks: Indices
    times_s: Array
    correlation_s: float

    def inflation(self, of_mean: Array, of_square: Array) -> Array:
        """Variances of sums over rows, over those of independent rows, shape (k,).

        Args:
            of_mean: Standard deviations of what each row adds in proportion to its normal number, with sign (n, k).
            of_square: The same of what it adds in proportion to the square, whose correlation is the square (n, k).
        """
        alone = (of_mean**2 + of_square**2).sum(axis=0)
        total = alone.copy()
        for later, earlier, apart in lag_pairs(self.tracks, self.times_s, self.correlation_s):
            kept = np.exp(-apart / self.correlation_s)
            total += 2 * (kept @ (of_mean[later] * of_mean[earlier]))
            total += 2 * (kept**2 @ (of_square[later] * of_square[earlier]))
        result: Array = np.maximum(total, _STEP * alone) / np.maximum(alone, 1e-300)
        return result

    @property
    def of_shares(self) -> float:
        """Most that the variance of a share of the rows grows."""
        ones = np.ones((len(self.times_s), 1))
        return float(self.inflation(ones, 0 * ones)[0])


def latent_bounds(model: DetectorModel, evidence: Evidence) -> tuple[Array, Array]:
    """Bounds of the normal number behind the confidence of each true detection, NaN without a law, shapes (m,).

    They are equal where the number is known. A clipped confidence leaves it open beyond a bound.
    """
    from modsim3d.verify.confidence_checks import scored  # which uses this module

    true = evidence.true_detections
    low, high = (np.full(len(true.confidence), np.nan) for _ in range(2))
    for s, state in enumerate(model.states):
        rows, law = np.flatnonzero(evidence.instances.state[true.instance] == s), state.confidence
        found, _ = scored(evidence, s, law)
        shift = -law.visibility_slope * found.hidden - law.size_slope * found.halvings
        check = LEVELS.get(model_name(SCORES, law.true))
        levels = None if check is None else check(law.true, found.scores, shift)
        if levels is None:
            continue
        below, above = levels
        middle = special.ndtri(np.clip((below + above) / 2, _LEAST_LEVEL, 1 - _LEAST_LEVEL))
        wide = above - below > _STEP
        low[rows] = np.where(wide, special.ndtri(below), middle)
        high[rows] = np.where(wide, special.ndtri(above), middle)
        clipped = (found.scores <= model.confidence_threshold) | (found.scores >= 1)
        if len(rows) and clipped.mean() < _HARDLY_ANY:  # a wrong mean or spread would look like a correlation
            own = middle[~clipped]
            low[rows], high[rows] = ((part[rows] - own.mean()) / max(own.std(), _STEP) for part in (low, high))
        low[rows[found.scores <= model.confidence_threshold]] = -np.inf
        high[rows[found.scores >= 1]] = np.inf
    return low, high


def score_persistence(model: DetectorModel, evidence: Evidence) -> Estimate | None:
    """Correlation of the normal numbers behind a vessel's confidence with those one frame before.

    Given a number that is known, the next has its own distribution whatever came before: the derivatives of its
    likelihood are independent of each other.
    """
    low, high = latent_bounds(model, evidence)
    place = np.full(len(evidence.instances.state), -1)
    place[evidence.true_detections.instance] = np.arange(len(low))
    turns = turn_before(model, evidence)[evidence.true_detections.instance]
    before = np.where(turns >= 0, place[turns], -1)
    now = np.flatnonzero((before >= 0) & ~np.isnan(low))
    now = now[low[before[now]] == high[before[now]]]
    before = before[now]
    if len(now) < LEAST_PAIRS:
        return None
    times_s = evidence.instances.time_s[evidence.true_detections.instance]
    tau = model.persistence.confidence_s
    kept = np.exp(-(times_s[now] - times_s[before]) / tau) if tau > 0 else np.zeros(len(now))
    score = pair_score(low[before], low[now], high[now], np.minimum(kept, _MOST_CORRELATION))
    information, asked = float((score**2).sum()), float(kept.mean())
    if information <= 0:
        return None
    step, skewness = float(score.sum()) / information, float((score**3).sum()) / information**1.5
    return Estimate(asked + step, asked, 1 / math.sqrt(information), len(now), skewness, possible=CORRELATION)
