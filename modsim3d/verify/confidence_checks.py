"""Checks of confidence: mean, standard deviation and slopes of a normal law before clipping, others as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import sizes
from modsim3d.detector.confidence import SCORES, NormalScores, QuantileScores, Scores, StateConfidence
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part, model_name
from modsim3d.verify.clipped_checks import Clipped
from modsim3d.verify.evidence import Evidence, max_detections_note
from modsim3d.verify.law_measures import Law
from modsim3d.verify.measures import Exact, Measure
from modsim3d.verify.parameters import Parameter

LEAST_DETECTIONS = 50


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections of a state with what their confidence may depend on; shapes (n,).

    Attributes:
        scores: Their confidence.
        hidden: Share of the vessel that is hidden, 0 where there is none.
        halvings: Of the box's size below the reference.
    """

    scores: Array
    hidden: Array
    halvings: Array

    def __add__(self, other: Scored) -> Scored:
        """Both together."""
        columns = ("scores", "hidden", "halvings")
        return Scored(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in columns))


def confidence_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The confidence of every state, true and false detections together where the file has one law for both."""
    note = max_detections_note(model, evidence)
    threshold = model.confidence_threshold
    parameters = []
    for s, state in enumerate(model.states):
        law = state.confidence
        true, false = _scored(evidence, s, law)
        groups = (
            [("", law.true, true + false)]
            if law.true is law.false
            else [(".true", law.true, true), (".false", law.false, false)]
        )
        for name, scores, found in groups:
            path = f"states.{state.name}.confidence{name}"
            parameters += [
                Parameter(f"{path}.{entry}", Part.CONFIDENCE, measure, asked, state=state.name).unless(note)
                for entry, asked, measure in _measures(law, scores, found, threshold)
            ]
    every = np.concatenate([evidence.true_detections.confidence, evidence.false_detections.confidence])
    outside = int(((every < threshold) | (every > 1)).sum())
    return [*parameters, Parameter("confidence_threshold", Part.CONFIDENCE, Exact(outside, len(every)))]


def _scored(evidence: Evidence, s: int, law: StateConfidence) -> tuple[Scored, Scored]:
    """True and false detections of a state."""
    true_detections, clutter, instances = evidence.true_detections, evidence.false_detections, evidence.instances
    true, false = np.flatnonzero(instances.state[true_detections.instance] == s), np.flatnonzero(clutter.state == s)
    seen = np.append(instances.visible_fraction, np.nan)  # the last for chance −1: no vessel
    parts = []
    for scores, chance, boxes in (
        (true_detections.confidence[true], true_detections.instance[true], true_detections.boxes_px[true]),
        (clutter.confidence[false], clutter.instance[false], clutter.boxes_px[false]),
    ):
        visible = seen[chance]
        width, height = sizes(boxes).T
        smaller = np.minimum(np.sqrt(width * height) / law.size_reference_px, 1.0)
        parts.append(Scored(scores, np.where(np.isnan(visible), 0, 1 - visible), -np.log2(smaller)))
    return parts[0], parts[1]


Slope = tuple[str, float, Array]
"""Name of a slope, its value, and by how much it raises the mean of each detection for each unit."""
Number = tuple[str, float, Measure | None]
"""Name, asked value and measure of one of a law's numbers."""


def _measures(law: StateConfidence, scores: Scores, found: Scored, threshold: float) -> list[Number]:
    slopes = [
        (name, slope, -amount)
        for name, slope, amount in (
            ("visibility_slope", law.visibility_slope, found.hidden),
            ("size_slope", law.size_slope, found.halvings),
        )
        if slope
    ]
    check = SCORE_CHECKS.get(model_name(SCORES, scores))
    return [] if check is None else check(scores, slopes, found, threshold)


def _quantiles(scores: QuantileScores, slopes: list[Slope], found: Scored, threshold: float) -> list[Number]:
    if slopes or len(found.scores) < LEAST_DETECTIONS:
        return [("law", 0.0, None)]
    inside = scores.quantiles.clip(threshold, 1)
    return [("law", 0.0, Law.of(found.scores, inside))]


def _normal(scores: NormalScores, slopes: list[Slope], found: Scored, threshold: float) -> list[Number]:
    shift = sum((slope * amount for _, slope, amount in slopes), np.zeros(len(found.scores)))
    names = ["mean", "std", *(name for name, _, _ in slopes)]
    asked = [scores.mean, scores.std, *(slope for _, slope, _ in slopes)]
    if len(found.scores) < LEAST_DETECTIONS:
        return [(name, value, None) for name, value in zip(names, asked, strict=True)]
    if scores.std == 0:
        expected = np.clip(scores.mean + shift, threshold, 1)
        wrong = int((np.abs(found.scores - expected) > 1e-12).sum())
        return [("std", 0.0, Exact(wrong, len(found.scores)))]
    clipped = Clipped(found.scores, np.column_stack([np.ones(len(shift)), *(a for _, _, a in slopes)]), threshold)
    fitted = clipped.measures(np.array([scores.mean, *(slope for _, slope, _ in slopes)]), scores.std)
    return [(name, value, measure) for name, value, measure in zip(names, asked, fitted, strict=True)]


SCORE_CHECKS: Mapping[str, Callable[..., list[Number]]] = {"normal": _normal, "quantiles": _quantiles}
"""From scores, slopes, detections and threshold, by the name of the distribution."""
