"""Checks of confidence: mean, standard deviation and slopes of a normal law before clipping, others as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes
from modsim3d.detector.confidence import SCORES, NormalScores, QuantileScores, Scores, StateConfidence
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part, model_name
from modsim3d.verify.class_checks import correlation_note
from modsim3d.verify.clipped_checks import LEAST_DETECTIONS, Clipped
from modsim3d.verify.evidence import Evidence, FalseDetections, TrueDetections, unknown_rest_note
from modsim3d.verify.kept_scores import KeptScores, score_persistence
from modsim3d.verify.law_measures import Law
from modsim3d.verify.measures import Exact, Measure
from modsim3d.verify.parameters import Parameter


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections of a state with their confidence and what it may depend on; shapes (n,).

    `hidden` is the share of the vessel that is hidden, 0 where there is none; `halvings` says how often the reference
    size must be halved to give that of the box. Confidence persists among equal rows of `tracks`, shape (n, 2), which
    are those of a vessel in a camera or of a single false detection, at `times_s`.
    """

    scores: Array
    hidden: Array
    halvings: Array
    tracks: Indices
    times_s: Array

    def __add__(self, other: Scored) -> Scored:
        """The detections of both."""
        columns = zip(astuple(self), astuple(other), strict=True)
        return Scored(*(np.concatenate(pair) for pair in columns))


def confidence_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The confidence of every state, true and false detections together where the file has one law for both."""
    note = unknown_rest_note(model, evidence)
    threshold = model.confidence_threshold
    parameters = []
    for s, state in enumerate(model.states):
        law = state.confidence
        true, false = scored(evidence, s, law)
        groups = [(".true", law.true, true), (".false", law.false, false)]
        if law.true is law.false:
            groups = [("", law.true, true + false)]
        for name, scores, found in groups:
            path = f"states.{state.name}.confidence{name}"
            parameters += [
                Parameter(f"{path}.{entry}", Part.CONFIDENCE, measure, asked, state=state.name).unless(note)
                for entry, asked, measure in _measures(law, scores, found, threshold, model.persistence.confidence_s)
            ]
    persistence = None if note else score_persistence(model, evidence)
    about = note or correlation_note(persistence)
    parameters.append(Parameter("persistence.confidence_s", Part.CONFIDENCE, persistence, note=about))
    every = np.concatenate([evidence.true_detections.confidence, evidence.false_detections.confidence])
    asked = model.operating_threshold
    least, key = (threshold, "confidence_threshold") if asked is None else (asked, "operating_threshold")
    outside = int(((every < least) | (every > 1)).sum())
    return [*parameters, Parameter(key, Part.CONFIDENCE, Exact(outside, len(every)))]


def scored(evidence: Evidence, s: int, law: StateConfidence) -> tuple[Scored, Scored]:
    """True and false detections of a state, in the order in which the evidence has them."""
    true, false, instances = evidence.true_detections, evidence.false_detections, evidence.instances
    seen = np.append(instances.visible_fraction, np.nan)  # the last for instance −1: no vessel

    def of_rows(found: TrueDetections | FalseDetections, ours: Mask) -> Scored:
        visible = seen[found.instance[ours]]
        width, height = sizes(found.boxes_px[ours]).T
        smaller = np.minimum(np.sqrt(width * height) / law.size_reference_px, 1.0)
        if isinstance(found, TrueDetections):
            tracks, times_s = instances.tracks(found.instance[ours])
        else:
            tracks, times_s = np.full((int(ours.sum()), 2), -1), evidence.frames.time_s[found.frame_row[ours]]
            tracks[:, 1] = np.arange(len(tracks))
        hidden = np.where(np.isnan(visible), 0, 1 - visible)
        return Scored(found.confidence[ours], hidden, -np.log2(smaller), tracks, times_s)

    return of_rows(true, instances.state[true.instance] == s), of_rows(false, false.state == s)


Slope = tuple[str, float, Array]
"""Name of a slope, its value, and by how much it raises the mean of each detection for each unit."""
Number = tuple[str, float, Measure | None]
"""Name, asked value and measure of one of a law's numbers."""


def _measures(
    law: StateConfidence, scores: Scores, found: Scored, threshold: float, correlation_s: float
) -> list[Number]:
    slopes = [
        ("visibility_slope", law.visibility_slope, -found.hidden),
        ("size_slope", law.size_slope, -found.halvings),
    ]
    check = SCORE_CHECKS.get(model_name(SCORES, scores))
    kept = KeptScores(found.tracks, found.times_s, correlation_s) if correlation_s > 0 else None
    return [] if check is None else check(scores, [slope for slope in slopes if slope[1]], found, threshold, kept)


def _quantiles(
    scores: QuantileScores, slopes: list[Slope], found: Scored, threshold: float, kept: KeptScores | None
) -> list[Number]:
    independent = len(found.scores) / (1.0 if kept is None else kept.of_shares)
    if slopes or independent < LEAST_DETECTIONS:
        return [("law", 0.0, None)]
    law = Law.of(found.scores, scores.quantiles.clip(threshold, 1))
    return [("law", 0.0, law if kept is None else replace(law, count=independent))]


def _normal(
    scores: NormalScores, slopes: list[Slope], found: Scored, threshold: float, kept: KeptScores | None
) -> list[Number]:
    count, own = len(found.scores), [slope for _, slope, _ in slopes]
    names = ["mean", "std", *(name for name, _, _ in slopes)]
    measures: Sequence[Measure | None] = [None] * len(names)
    if scores.std == 0 and count >= LEAST_DETECTIONS:
        shift = sum((slope * amount for _, slope, amount in slopes), np.zeros(count))
        wrong = int((np.abs(found.scores - np.clip(scores.mean + shift, threshold, 1)) > 1e-12).sum())
        return [("std", 0.0, Exact(wrong, count))]
    if count >= LEAST_DETECTIONS:
        design = np.column_stack([np.ones(count), *(amount for _, _, amount in slopes)])
        measures = Clipped(found.scores, design, threshold, kept).measures(np.array([scores.mean, *own]), scores.std)
    return list(zip(names, [scores.mean, scores.std, *own], measures, strict=True))


SCORE_CHECKS: Mapping[str, Callable[..., list[Number]]] = {"normal": _normal, "quantiles": _quantiles}
"""The numbers of a distribution, given scores, slopes, detections and threshold, by the distribution's name."""
