"""Checks of confidence: mean, standard deviation and slopes of a normal law before clipping, others as a whole."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import sizes
from modsim3d.detector import confidence
from modsim3d.detector.chain import DetectorPart, model_name
from modsim3d.detector.confidence import ConfidenceLaw, NormalScores, QuantileScores, StateConfidence
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import LatentScore, Persistence
from modsim3d.verify.class_checks import correlation_note, lag_pairs, sum_over_pairs, turn_pairs
from modsim3d.verify.evidence import Evidence, FalsePositiveRows, TrueDetections, unknown_rest_note
from modsim3d.verify.measures import AMOUNT, ANY, CORRELATION, Estimate, Exact, Measure
from modsim3d.verify.parameters import Law, Parameter

MIN_PAIRS = 100
_STEP, _MIN_LEVEL = 1e-4, 1e-12
_HARDLY_ANY = 0.02
_MAX_CORRELATION = 1 - 1e-9


@dataclass(frozen=True, eq=False)
class KeptScores:
    """Confidences that persist along tracks: rows of tracks (n, k), times (n,), and the correlation time or the score.
    Of a score, confidences of detections correlate at most as the score does."""

    tracks: Indices
    times_s: Array
    correlation_s: float
    score: LatentScore | None = None

    def inflation(self, of_mean: Array, of_square: Array) -> Array:
        """Variances of sums over rows, over those of independent rows, shape (k,). `of_mean` are the standard
        deviations of what each row adds in proportion to its normal number, with sign; `of_square` those of what it
        adds in proportion to the square, whose correlation is the square; shapes (n, k)."""
        alone = (of_mean**2 + of_square**2).sum(axis=0)
        total = alone.copy()
        if self.score is not None and len(of_mean) > 1:
            of_score = self.score.correlation

            def value(later: Indices, earlier: Indices, apart_s: Array) -> Array:
                kept = of_score(apart_s)[:, None]
                return kept * of_mean[later] * of_mean[earlier] + kept**2 * of_square[later] * of_square[earlier]

            total = total + 2 * sum_over_pairs(self.tracks, self.times_s, value)
        elif self.score is None:
            total = total + self._of_time(of_mean, of_square)
        return np.asarray(np.maximum(total, _STEP * alone) / np.maximum(alone, 1e-300))

    def _of_time(self, of_mean: Array, of_square: Array) -> Array:
        """Covariances that a correlation time makes, shape (k,)."""
        total = np.zeros(of_mean.shape[1])
        for later, earlier, apart in lag_pairs(self.tracks, self.times_s, self.correlation_s):
            kept = np.exp(-apart / self.correlation_s)
            total += 2 * (kept @ (of_mean[later] * of_mean[earlier]))
            total += 2 * (kept**2 @ (of_square[later] * of_square[earlier]))
        return total

    @property
    def of_shares(self) -> float:
        """Most that the variance of a share of the rows grows."""
        ones = np.ones((len(self.times_s), 1))
        return float(self.inflation(ones, 0 * ones)[0])


def latent_bounds(model: DetectorModel, evidence: Evidence) -> tuple[Array, Array]:
    """Bounds (m,) of the normal number behind each true detection's confidence, equal unless clipped; NaN: no law."""
    true = evidence.true_detections
    low, high = (np.full(len(true.confidence), np.nan) for _ in range(2))
    for s, state in enumerate(model.states):
        rows, law = np.flatnonzero(evidence.instances.state[true.instance] == s), state.confidence
        hits, _ = scored(evidence, s, law)
        levels = levels_of(law, law.true, hits)
        if levels is None:
            continue
        below, above = levels
        middle = special.ndtri(np.clip((below + above) / 2, _MIN_LEVEL, 1 - _MIN_LEVEL))
        wide = above - below > _STEP
        low[rows] = np.where(wide, special.ndtri(below), middle)
        high[rows] = np.where(wide, special.ndtri(above), middle)
        clipped = (hits.scores <= model.confidence_threshold) | (hits.scores >= 1)
        if len(rows) and clipped.mean() < _HARDLY_ANY:  # a wrong mean or spread would look like a correlation
            own = middle[~clipped]
            low[rows], high[rows] = ((part[rows] - own.mean()) / max(own.std(), _STEP) for part in (low, high))
        low[rows[hits.scores <= model.confidence_threshold]] = -np.inf
        high[rows[hits.scores >= 1]] = np.inf
    return low, high


def score_persistence(model: DetectorModel, evidence: Evidence) -> Estimate | None:
    """Correlation of the normal numbers behind a vessel's confidence with those one frame before. Given a known number,
    the next has its own distribution whatever came before: derivatives of likelihoods are independent."""
    low, high = latent_bounds(model, evidence)
    now, before = turn_pairs(model, evidence, evidence.true_detections.instance)
    usable = ~np.isnan(low[now]) & (low[before] == high[before])
    now, before = now[usable], before[usable]
    if len(now) < MIN_PAIRS:
        return None
    times_s = evidence.instances.time_s[evidence.true_detections.instance]
    tau = model.persistence.confidence_s
    kept = np.exp(-(times_s[now] - times_s[before]) / tau) if tau > 0 else np.zeros(len(now))
    score = confidence.pair_score(low[before], low[now], high[now], np.minimum(kept, _MAX_CORRELATION))
    information, asked = float((score**2).sum()), float(kept.mean())
    if information <= 0:
        return None
    step, skewness = float(score.sum()) / information, float((score**3).sum()) / information**1.5
    return Estimate(asked + step, asked, 1 / math.sqrt(information), len(now), skewness, possible=CORRELATION)


_FAR, _STEPS = 4.5, 8  # an estimate farther off than this is refined by so many Newton steps
_SINGULAR = 1e10
MIN_DETECTIONS = 50  # independent detections that a number needs
_LEVELS = 100  # means at which the integrals are computed; those between are interpolated


@dataclass(frozen=True, eq=False)
class TobitModel:
    """Numbers (n,) clipped to [threshold, 1], whose means before clipping are the design (n, k) times coefficients.
    `kept` are those that keep a part of their deviation from one another, None for none."""

    scores: Array
    design: Array
    threshold: float
    kept: KeptScores | None = None

    def measures(self, coefficients: Array, std: float) -> Sequence[Estimate | None]:
        """Estimates of the first coefficient, the standard deviation, and the other coefficients, shape (k,) in all:
        one step from the asked values towards the maximum likelihood, which is also the score test of each with the
        others free; several steps for an estimate that is far off."""
        information = self._information(self.design @ coefficients, std)
        step, covariance, third = self._step(coefficients, std, information)
        if step is None:
            return [None] * (len(coefficients) + 1)
        inflation = self._inflation(information, covariance)
        errors = np.sqrt(np.diag(covariance) * inflation)
        third = third * inflation**2
        z = step / errors
        asked = np.concatenate([coefficients[:1], [std], coefficients[1:]])
        values = asked + step
        if np.abs(z).max() > _FAR:
            values = self._fitted(asked)
        estimates: list[Estimate | None] = []
        for k, wider in enumerate(inflation.tolist()):
            count = len(self.scores) if self.kept is None else len(self.scores) / wider
            skewness, possible = third[k] / errors[k] ** 3, AMOUNT if k == 1 else ANY
            estimate = Estimate(values[k], asked[k], errors[k], count, skewness, z[k], k == 1, possible)
            estimates.append(estimate if self.kept is None or count >= MIN_DETECTIONS else None)
        return estimates

    def _inflation(self, information: Array, covariance: Array) -> Array:
        """Variance of each estimate over that from independent numbers, in the order of `measures`."""
        if self.kept is None:
            return np.ones(len(covariance))
        of_mean = (np.insert(self.design, 1, 0.0, axis=1) @ covariance) * np.sqrt(information[:, :1])
        return self.kept.inflation(of_mean, np.sqrt(information[:, 2:]) * covariance[1])

    def _fitted(self, value: Array) -> Array:
        for _ in range(_STEPS):
            coefficients = np.concatenate([value[:1], value[2:]])
            step, _, _ = self._step(coefficients, value[1], self._information(self.design @ coefficients, value[1]))
            if step is None:
                break
            value = value + np.clip(step, -0.5 * value[1], 0.5 * value[1])
        return value

    def _step(self, coefficients: Array, std: float, information: Array) -> tuple[Array | None, Array, Array]:
        """Step from the law towards the maximum likelihood, its covariance, and its third cumulants."""
        means = self.design @ coefficients
        # In this order: first coefficient, standard deviation, the others.
        design = np.insert(self.design, 1, 1.0, axis=1)
        of_std = np.arange(design.shape[1]) == 1
        score = confidence.clipped_score(self.scores, means, std, self.threshold)
        total = (design * np.where(of_std, score[:, 1:], score[:, :1])).sum(axis=0)
        part = np.where(
            of_std[:, None] & of_std,
            information[:, 2, None, None],
            np.where(of_std[:, None] | of_std, information[:, 1, None, None], information[:, 0, None, None]),
        )
        matrix = np.einsum("ni,nj,nij->ij", design, design, part)
        if not np.all(np.isfinite(matrix)) or np.linalg.cond(matrix) > _SINGULAR:
            return None, matrix, total
        covariance = np.linalg.inv(matrix)
        # From a few rows, spread evenly, that stand for all.
        rows = np.linspace(0, len(means) - 1, min(len(means), 64)).astype(np.int64)
        third = np.zeros(len(total))
        for row, chances, scores in zip(rows, *self._laws(means[rows], std), strict=True):
            third += chances @ ((design[row] * np.where(of_std, scores[:, 1:], scores[:, :1])) @ covariance) ** 3
        return covariance @ total, covariance, third * len(means) / len(rows)

    def _information(self, means: Array, std: float) -> Array:
        """Fisher information of mean and standard deviation of each number: mm, ms, ss; shape (n, 3)."""
        low, high = float(means.min()), float(means.max())
        levels = np.linspace(low, high, _LEVELS if high - low > 1e-12 else 1)
        table = np.empty((len(levels), 3))
        for k, (chances, score) in enumerate(zip(*self._laws(levels, std), strict=True)):
            table[k] = chances @ (score[:, [0, 0, 1]] * score[:, [0, 1, 1]])
        return np.column_stack([np.interp(means, levels, column) for column in table.T])

    def _laws(self, means: Array, std: float) -> tuple[Array, Array]:
        """Probabilities and scores at the nodes of the law of each mean, shapes (n, nodes) and (n, nodes, 2)."""
        places, chances = confidence.clipped_laws(means, std, self.threshold)
        return chances, confidence.clipped_score(places, means[:, None], std, self.threshold)


@dataclass(frozen=True, eq=False)
class ScoredDetections(Columns):
    """Detections of a state with their confidence and what it may depend on; shapes (n,). `hidden` is the share of the
    vessel that is hidden, 0 where there is none; `halvings` says how often the reference size must be halved to give
    that of the box. Confidence persists among equal rows of `tracks`, shape (n, 2), which are those of a vessel in a
    camera or of a single false positive, at `times_s`."""

    scores: Array
    hidden: Array
    halvings: Array
    tracks: Indices
    times_s: Array


def confidence_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The confidence of every state, true and false positives together where the file has one law for both."""
    note = unknown_rest_note(model, evidence)
    threshold = model.confidence_threshold
    parameters = []
    for s, state in enumerate(model.states):
        law = state.confidence
        true, false = scored(evidence, s, law)
        groups = [(".true", law.true, true), (".false", law.false, false)]
        if law.true is law.false:
            groups = [("", law.true, ScoredDetections.join([true, false]))]
        for name, scores, sample in groups:
            path = f"states.{state.name}.confidence{name}"
            parameters += [
                Parameter(f"{path}.{entry}", DetectorPart.CONFIDENCE, measure, asked, state=state.name).unless(note)
                for entry, asked, measure in _measures(law, scores, sample, threshold, model.persistence)
            ]
    if model.persistence.score is None:
        persistence = None if note else score_persistence(model, evidence)
        about = note or correlation_note(persistence)
        parameters.append(Parameter("persistence.confidence_s", DetectorPart.CONFIDENCE, persistence, note=about))
    every = np.concatenate([evidence.true_detections.confidence, evidence.false_positives.confidence])
    asked = model.operating_threshold
    least, key = (threshold, "confidence_threshold") if asked is None else (asked, "operating_threshold")
    outside = int(((every < least) | (every > 1)).sum())
    return [*parameters, Parameter(key, DetectorPart.CONFIDENCE, Exact(outside, len(every)))]


def scored(evidence: Evidence, s: int, law: StateConfidence) -> tuple[ScoredDetections, ScoredDetections]:
    """True and false positives of a state, in the order in which the evidence has them."""
    true, false, instances = evidence.true_detections, evidence.false_positives, evidence.instances
    seen = np.append(instances.visible_fraction, np.nan)  # the last for instance −1: no vessel

    def of_rows(detections: TrueDetections | FalsePositiveRows, mask: Mask) -> ScoredDetections:
        visible = seen[detections.instance[mask]]
        width, height = sizes(detections.boxes_px[mask]).T
        smaller = np.minimum(np.sqrt(width * height) / law.size_reference_px, 1.0)
        if isinstance(detections, TrueDetections):
            tracks, times_s = instances.tracks(detections.instance[mask])
        else:
            tracks, times_s = np.full((int(mask.sum()), 2), -1), evidence.frames.time_s[detections.frame_row[mask]]
            tracks[:, 1] = np.arange(len(tracks))
        hidden = np.where(np.isnan(visible), 0, 1 - visible)
        return ScoredDetections(detections.confidence[mask], hidden, -np.log2(smaller), tracks, times_s)

    return of_rows(true, instances.state[true.instance] == s), of_rows(false, false.state == s)


def levels_of(law: StateConfidence, scores: ConfidenceLaw, sample: ScoredDetections) -> tuple[Array, Array] | None:
    """Least and greatest level of each score in one of a state's laws, shapes (n,); None if its levels are unknown."""
    check = confidence.LEVELS.get(model_name(confidence.SCORES, scores))
    shift = -law.visibility_slope * sample.hidden - law.size_slope * sample.halvings
    return None if check is None else check(scores, sample.scores, shift)


Slope = tuple[str, float, Array]  # name of a slope, its value, and what it adds to the mean of each detection per unit
Number = tuple[str, float, Measure | None]  # name, asked value and measure of one of a law's numbers


def _measures(
    law: StateConfidence, scores: ConfidenceLaw, sample: ScoredDetections, threshold: float, persistence: Persistence
) -> list[Number]:
    own = ("visibility_slope", law.visibility_slope, -sample.hidden), ("size_slope", law.size_slope, -sample.halvings)
    check = SCORE_CHECKS.get(model_name(confidence.SCORES, scores))
    persists = persistence.confidence_s > 0 or persistence.score is not None
    kept = KeptScores(sample.tracks, sample.times_s, persistence.confidence_s, persistence.score) if persists else None
    return [] if check is None else check(scores, [slope for slope in own if slope[1]], sample, threshold, kept)


def _quantiles(
    scores: QuantileScores, slopes: list[Slope], sample: ScoredDetections, threshold: float, kept: KeptScores | None
) -> list[Number]:
    independent = len(sample.scores) / (1.0 if kept is None else kept.of_shares)
    if slopes or independent < MIN_DETECTIONS:
        return [("law", 0.0, None)]
    law = Law.of(sample.scores, scores.quantiles.clip(threshold, 1))
    return [("law", 0.0, law if kept is None else replace(law, count=independent))]


def _normal(
    scores: NormalScores, slopes: list[Slope], sample: ScoredDetections, threshold: float, kept: KeptScores | None
) -> list[Number]:
    count, own = len(sample.scores), [slope for _, slope, _ in slopes]
    names = ["mean", "std", *(name for name, _, _ in slopes)]
    measures: Sequence[Measure | None] = [None] * len(names)
    if scores.std == 0 and count >= MIN_DETECTIONS:
        shift = sum((slope * amount for _, slope, amount in slopes), np.zeros(count))
        wrong = int((np.abs(sample.scores - np.clip(scores.mean + shift, threshold, 1)) > 1e-12).sum())
        return [("std", 0.0, Exact(wrong, count))]
    if count >= MIN_DETECTIONS:
        design = np.column_stack([np.ones(count), *(amount for _, _, amount in slopes)])
        model = TobitModel(sample.scores, design, threshold, kept)
        measures = model.measures(np.array([scores.mean, *own]), scores.std)
    return list(zip(names, [scores.mean, scores.std, *own], measures, strict=True))


SCORE_CHECKS: Mapping[str, Callable[..., list[Number]]] = {"normal": _normal, "quantiles": _quantiles}
"""The numbers of a distribution, given scores, slopes, detections and threshold, by the distribution's name."""
