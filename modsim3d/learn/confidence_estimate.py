"""Confidence: its distribution in each state, for true and false detections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.clipped_normal import clipped_sums, fit_clipped
from modsim3d.learn.entries import Entry, Key, digits, nested
from modsim3d.learn.form import LearnedPart
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import Column, Resampling, widened

SCORES_NEEDED = 20
"""Detections that a distribution of a state's own needs."""
QUANTILES_NEEDED = 200
"""Detections that quantiles need."""
QUANTILES = 21
_QUANTILE_REPLICATES = 200
_NORMAL_ENOUGH = 0.06
"""Largest difference of distribution functions at which confidence still counts as clipped normal."""
_PERCENT = tuple(f"{k / (QUANTILES - 1):.0%}" for k in range(QUANTILES))

Kind = Literal["true", "false"]
KINDS: tuple[Kind, Kind] = ("true", "false")
ScoreForm = Literal["normal", "quantiles", "shared"]
"""A normal distribution clipped to [threshold, 1], evenly spaced quantiles, or the normal one that all states share."""


@dataclass(frozen=True)
class ConfidenceForm:
    """The distributions of confidence of true and of false detections in each state."""

    true: tuple[ScoreForm, ...]
    false: tuple[ScoreForm, ...]
    notes: tuple[str, ...]

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedPart:
        """The distributions of each state."""
        learned: dict[Kind, list[LearnedScores]] = {"true": [], "false": []}
        for kind, forms in zip(KINDS, (self.true, self.false), strict=True):
            scores = Scores.of(observed, kind)
            for index, (state, form) in enumerate(zip(observed.states, forms, strict=True)):
                ours = scores if form == "shared" else scores.of_state(index)
                fit = _quantile_scores if form == "quantiles" else _normal_scores
                learned[kind].append(fit(ours, ("confidence", kind), state, observed.threshold, resampling))
        return LearnedConfidence(tuple(learned["true"]), tuple(learned["false"]))


@dataclass(frozen=True)
class NoConfidenceForm:
    """Detections without confidences."""

    notes: tuple[str, ...] = ("confidence: 1 for every detection; the detections have none (-1)",)

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedPart:
        """Nothing to estimate."""
        return SureOfEverything()


@dataclass(frozen=True)
class SureOfEverything:
    """A confidence of 1 for every detection, where none is known."""

    def sections(self) -> dict[str, dict[str, Any]]:
        """Nothing outside the states."""
        return {}

    def state_section(self, state: int) -> dict[str, Any]:
        """The same in every state."""
        return {"confidence": {"mean": 1.0, "std": 0.0}}


@dataclass(frozen=True, eq=False)
class Scores:
    """Confidences of detections of one kind: values, images and states, shapes (n,)."""

    values: Array
    image: Indices
    state: Indices

    @classmethod
    def of(cls, observed: Observed, kind: Kind) -> Scores:
        """Confidences of true or false detections."""
        pairs, results = observed.pairs, observed.labelled.results
        if kind == "true":
            return cls(pairs.confidence, pairs.image, pairs.state)
        image = results.image[observed.false]
        return cls(results.confidence[observed.false], image, observed.image_state[image])

    def of_state(self, state: int) -> Scores:
        """Those of one state."""
        ours = self.state == state
        return Scores(self.values[ours], self.image[ours], self.state[ours])


@dataclass(frozen=True, eq=False)
class NormalScores:
    """A normal distribution, clipped to [threshold, 1]."""

    mean: Entry
    std: Entry
    threshold: float

    def section(self) -> dict[str, Any]:
        """Mean and standard deviation; any confidence if none were seen."""
        if not np.isfinite(self.mean.estimate):
            return {"quantiles": [self.threshold, 1.0]}
        return {"mean": digits(self.mean.estimate), "std": digits(self.std.estimate)}


@dataclass(frozen=True, eq=False)
class QuantileScores:
    """Evenly spaced quantiles from 0 to 100 %, shape (QUANTILES,)."""

    quantiles: Entry
    threshold: float

    def section(self) -> dict[str, Any]:
        """Quantiles that do not fall and lie in [threshold, 1]."""
        return {"quantiles": nested(np.maximum.accumulate(np.clip(self.quantiles.estimate, self.threshold, 1)))}


LearnedScores = NormalScores | QuantileScores


@dataclass(frozen=True, eq=False)
class LearnedConfidence:
    """Distributions of confidence, of true and of false detections of each state."""

    true: tuple[LearnedScores, ...]
    false: tuple[LearnedScores, ...]

    def sections(self) -> dict[str, dict[str, Any]]:
        """Nothing outside the states."""
        return {}

    def state_section(self, state: int) -> dict[str, Any]:
        """Both distributions."""
        return {"confidence": {"true": self.true[state].section(), "false": self.false[state].section()}}


def choose_confidence(observed: Observed) -> ConfidenceForm | NoConfidenceForm:
    """Which distribution the confidences of each state and kind follow."""
    if not observed.labelled.scored:
        return NoConfidenceForm()
    notes: list[str] = []
    scores = {kind: Scores.of(observed, kind) for kind in KINDS}
    chosen: dict[Kind, list[ScoreForm]] = {"true": [], "false": []}
    for index, state in enumerate(observed.states):
        for kind in KINDS:
            values = scores[kind].of_state(index).values
            chosen[kind].append(_score_form(values, observed.threshold))
            if chosen[kind][-1] == "shared":
                notes.append(
                    f"states.{state}.confidence.{kind}: that of all states; had {len(values)} detections, "
                    f"needs {SCORES_NEEDED}"
                )
    return ConfidenceForm(tuple(chosen["true"]), tuple(chosen["false"]), tuple(notes))


def _score_form(values: Array, threshold: float) -> ScoreForm:
    if len(values) < SCORES_NEEDED:
        return "shared"
    normal = len(values) < QUANTILES_NEEDED or _distance(values, threshold) < _NORMAL_ENOUGH
    return "normal" if normal else "quantiles"


def _distance(values: Array, threshold: float) -> float:
    """Largest difference between the distribution function of values (n,) and that of their clipped normal fit."""
    mean, std = fit_clipped(clipped_sums(values, threshold, 1.0).sum(axis=0)[None], threshold, 1.0)
    ordered = np.sort(values)
    fitted = np.where(ordered >= 1, 1.0, special.ndtr((ordered - mean[0]) / max(std[0], 1e-9)))
    after = np.searchsorted(ordered, ordered, side="right") / len(values)
    before = np.searchsorted(ordered, ordered, side="left") / len(values)
    below = np.where(ordered <= threshold, 0.0, np.abs(fitted - before))
    above = np.abs(fitted - after)
    return float(max(below[ordered < 1].max(initial=0.0), above.max(initial=0.0)))


def _normal_scores(
    scores: Scores, names: tuple[str, ...], state: str, threshold: float, resampling: Resampling
) -> NormalScores:
    """The normal distribution behind clipped confidences; `names` are the keys of its section."""
    sums = resampling.sums(scores.image, clipped_sums(scores.values, threshold, 1.0))
    mean, std = fit_clipped(sums, threshold, 1.0)
    count = float(len(scores.values))
    root = np.sqrt(max(count, 1.0))
    return NormalScores(
        Entry(Key((*names, "mean"), state), Column(widened(mean, std[0] / root), "mean", np.array(count))),
        Entry(
            Key((*names, "std"), state),
            Column(widened(std, std[0] / root / np.sqrt(2)), "positive", np.array(count)),
        ),
        threshold,
    )


def _quantile_scores(
    scores: Scores, names: tuple[str, ...], state: str, threshold: float, resampling: Resampling
) -> QuantileScores:
    """Quantiles of confidences under each row of weights; `names` are the keys of their section."""
    order = np.argsort(scores.values, kind="stable")
    ordered, image = scores.values[order], scores.image[order]
    rows = resampling.weights[: 1 + _QUANTILE_REPLICATES]
    values, levels = np.full((len(rows), QUANTILES), np.nan), np.linspace(0, 1, QUANTILES)
    for row, of_images in enumerate(rows):
        weights = of_images[image]
        kept, mass = weights > 0, np.cumsum(weights)
        if kept.any():
            values[row] = np.interp(levels, (mass - weights / 2)[kept] / mass[-1], ordered[kept])
    column = Column(values, "mean", np.full(QUANTILES, float(len(scores.values))))
    return QuantileScores(Entry(Key((*names, "quantiles"), state, (_PERCENT,)), column), threshold)
