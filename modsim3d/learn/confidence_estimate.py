"""Confidence: its distribution in each state, for true and false detections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.clipped_normal import clipped_sums, fit_clipped
from modsim3d.learn.confidence_fit import SlopeFit, SlopeForm, fit_slopes, product_limit
from modsim3d.learn.confidence_slopes import SCORES_NEEDED, choose_slopes, with_enough
from modsim3d.learn.entries import Entry, Key, digits, nested
from modsim3d.learn.form import LearnedPart
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import Column, Resampling, resample, widened
from modsim3d.learn.scores import KINDS, Kind, Scores

QUANTILES_NEEDED = 200
"""Detections that quantiles need."""
QUANTILES = 21
_QUANTILE_REPLICATES = 200
_NORMAL_ENOUGH = 0.06
"""Largest difference of distribution functions at which confidence still counts as clipped normal."""
_LEVELS = 500
_PERCENT = tuple(f"{k / (QUANTILES - 1):.0%}" for k in range(QUANTILES))

ScoreForm = Literal["normal", "quantiles", "shared"]
"""A normal distribution clipped to [threshold, 1], evenly spaced quantiles, or the normal one that all states share."""


Sloped = tuple[SlopeFit, int] | None
"""A fit with slopes and which of its kinds it is; None without slopes."""


@dataclass(frozen=True)
class ConfidenceForm:
    """The distributions of confidence of true and of false detections in each state, and its slopes, None without."""

    true: tuple[ScoreForm, ...]
    false: tuple[ScoreForm, ...]
    slopes: tuple[SlopeForm | None, ...]
    notes: tuple[str, ...]

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedPart:
        """The distributions of each state."""
        every = {kind: Scores.of(observed, kind) for kind in KINDS}
        learned: dict[Kind, list[LearnedScores]] = {"true": [], "false": []}
        slopes: list[LearnedSlopes | None] = []
        for index, (state, form) in enumerate(zip(observed.states, self.slopes, strict=True)):
            forms: dict[Kind, ScoreForm] = {"true": self.true[index], "false": self.false[index]}
            chosen = {kind: every[kind] if forms[kind] == "shared" else every[kind].of_state(index) for kind in KINDS}
            sloped: dict[Kind, Sloped] = {}
            fit = None
            if form is not None:
                samples = with_enough(chosen)
                quantiles = [forms[kind] == "quantiles" for kind in samples]
                fit = fit_slopes(list(samples.values()), quantiles, form, observed.threshold, resampling)
                if fit is not None:
                    sloped = {kind: (fit, place) for place, kind in enumerate(samples)}
            slopes.append(LearnedSlopes.of(fit, state, chosen["true"]) if fit is not None else None)
            for kind in KINDS:
                keys = ScoreKeys(("confidence", kind), state, observed.threshold)
                estimate = _quantile_scores if forms[kind] == "quantiles" else _normal_scores
                learned[kind].append(estimate(chosen[kind], keys, sloped.get(kind), resampling))
        return LearnedConfidence(tuple(learned["true"]), tuple(learned["false"]), tuple(slopes))


@dataclass(frozen=True)
class OneConfidenceForm:
    """One normal distribution of the confidence of true and false detections together in each state."""

    notes: tuple[str, ...] = ()

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedPart:
        """The distribution of each state; that of all states where one has too few detections."""
        every = Scores.of(observed, "true") + Scores.of(observed, "false")
        learned = []
        for index, state in enumerate(observed.states):
            ours = every.of_state(index)
            ours = ours if len(ours) >= SCORES_NEEDED else every
            learned.append(
                _normal_scores(ours, ScoreKeys(("confidence",), state, observed.threshold), None, resampling)
            )
        return LearnedConfidenceOfAll(tuple(learned))


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


@dataclass(frozen=True)
class ScoreKeys:
    """The keys of the section of a distribution in the file, its state, and the least confidence."""

    names: tuple[str, ...]
    state: str
    threshold: float


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
class LearnedSlopes:
    """The slopes of a state; the reference size is fitted if there is an entry of it, and fixed if not."""

    form: SlopeForm
    entries: tuple[Entry, ...]

    @classmethod
    def of(cls, fit: SlopeFit, state: str, scores: Scores) -> LearnedSlopes:
        """From a fit, given the true detections."""
        entries, first = [], len(fit.errors) - len(fit.form.names)
        for place, name in enumerate(fit.form.names):
            values = widened(fit.slopes[:, place], fit.errors[first + place])
            size = name == "size_reference_px"
            column = Column(2**values if size else values, "positive" if size else "mean", np.array(float(len(scores))))
            entries.append(Entry(Key(("confidence", name), state), column))
        return cls(fit.form, tuple(entries))

    def section(self) -> dict[str, float]:
        """Their keys in the file."""
        fixed = {"size_reference_px": digits(2**self.form.log_reference)} if self.form.size else {}
        return fixed | {entry.key.names[-1]: max(digits(entry.estimate), 0.0) for entry in self.entries}


@dataclass(frozen=True, eq=False)
class LearnedConfidence:
    """Distributions of confidence, of true and of false detections of each state, and the slopes, None without."""

    true: tuple[LearnedScores, ...]
    false: tuple[LearnedScores, ...]
    slopes: tuple[LearnedSlopes | None, ...]

    def sections(self) -> dict[str, dict[str, Any]]:
        """Nothing outside the states."""
        return {}

    def state_section(self, state: int) -> dict[str, Any]:
        """Both distributions and the slopes."""
        slopes = self.slopes[state]
        scores = {"true": self.true[state].section(), "false": self.false[state].section()}
        return {"confidence": {**scores, **({} if slopes is None else slopes.section())}}


@dataclass(frozen=True, eq=False)
class LearnedConfidenceOfAll:
    """A distribution of the confidence of all detections of each state."""

    states: tuple[NormalScores, ...]

    def sections(self) -> dict[str, dict[str, Any]]:
        """Nothing outside the states."""
        return {}

    def state_section(self, state: int) -> dict[str, Any]:
        """Mean and standard deviation; full confidence where nothing was detected."""
        found = self.states[state].section()
        return {"confidence": found if "mean" in found else {"mean": 1.0, "std": 0.0}}


def choose_confidence(observed: Observed) -> ConfidenceForm | OneConfidenceForm | NoConfidenceForm:
    """Which distribution the confidences of each state and kind follow, and which slopes they have."""
    if not observed.labelled.scored:
        return NoConfidenceForm()
    if "confidence" in observed.without:
        return OneConfidenceForm()
    notes: list[str] = []
    scores = {kind: Scores.of(observed, kind) for kind in KINDS}
    chosen: dict[Kind, list[ScoreForm]] = {"true": [], "false": []}
    slopes: list[SlopeForm | None] = []
    for index, state in enumerate(observed.states):
        ours = {kind: scores[kind].of_state(index) for kind in KINDS}
        samples = {kind: ours[kind] if len(ours[kind]) >= SCORES_NEEDED else scores[kind] for kind in KINDS}
        slopes.append(choose_slopes(observed, state, with_enough(samples), notes))
        fit = _normal_fit(samples, slopes[-1], observed)
        for place, kind in enumerate(KINDS):
            if len(ours[kind]) < SCORES_NEEDED:
                chosen[kind].append("shared")
                notes.append(
                    f"states.{state}.confidence.{kind}: that of all states; had {len(ours[kind])} detections, "
                    f"needs {SCORES_NEEDED}"
                )
            elif len(ours[kind]) < QUANTILES_NEEDED:
                chosen[kind].append("normal")
            else:
                far = (
                    _distance(ours[kind].values, observed.threshold)
                    if fit is None
                    else _sloped_distance(ours[kind], fit, place, observed.threshold)
                )
                chosen[kind].append("normal" if far < _NORMAL_ENOUGH else "quantiles")
    return ConfidenceForm(tuple(chosen["true"]), tuple(chosen["false"]), tuple(slopes), tuple(notes))


def _normal_fit(samples: Mapping[Kind, Scores], form: SlopeForm | None, observed: Observed) -> SlopeFit | None:
    """The slopes with normal distributions, without replicates; None without slopes."""
    if form is None:
        return None
    sloped, once = list(with_enough(samples).values()), resample(observed.labelled.images, 0, 0)
    return fit_slopes(sloped, [False] * len(sloped), form, observed.threshold, once)


def _sloped_distance(scores: Scores, fit: SlopeFit, kind: int, threshold: float) -> float:
    """Largest difference between the distribution function of the levels of confidences (n,) and that of uniform ones.

    A level is the probability of a smaller confidence in the fit. That of a clipped one is anywhere below or above that
    of its bound.
    """
    means, std = fit.means[0, kind] - fit.shift(scores), fit.stds[0, kind]
    level = special.ndtr((scores.values - means) / std)
    low = np.where(scores.values <= threshold, 0.0, level)
    high = np.where(scores.values >= 1, 1.0, level)
    grid = np.linspace(0, 1, _LEVELS + 1)
    known = np.searchsorted(np.sort(level[low == high]), grid, side="right")
    wide = np.flatnonzero(low < high)
    part = np.zeros(len(grid))
    for k, at in enumerate(grid.tolist()):
        part[k] = np.clip((at - low[wide]) / (high[wide] - low[wide]), 0, 1).sum()
    return float(np.abs((known + part) / len(level) - grid).max())


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


def _normal_scores(scores: Scores, keys: ScoreKeys, sloped: Sloped, resampling: Resampling) -> NormalScores:
    """The normal distribution behind clipped confidences."""
    count = float(len(scores))
    if sloped is None:
        sums = resampling.sums(scores.image, clipped_sums(scores.values, keys.threshold, 1.0))
        mean, std = fit_clipped(sums, keys.threshold, 1.0)
        root = np.sqrt(max(count, 1.0))
        errors = std[0] / root, std[0] / root / np.sqrt(2)
    else:
        fit, kind = sloped
        mean, std = fit.means[:, kind], fit.stds[:, kind]
        errors = fit.errors[2 * kind], fit.errors[2 * kind + 1]
    return NormalScores(
        Entry(Key((*keys.names, "mean"), keys.state), Column(widened(mean, errors[0]), "mean", np.array(count))),
        Entry(Key((*keys.names, "std"), keys.state), Column(widened(std, errors[1]), "positive", np.array(count))),
        keys.threshold,
    )


def _quantile_scores(scores: Scores, keys: ScoreKeys, sloped: Sloped, resampling: Resampling) -> QuantileScores:
    """Quantiles of confidences under each row of weights; with slopes, of what they are without them."""
    rows, scores = (
        resampling.weights[: 1 + _QUANTILE_REPLICATES],
        scores.chosen(np.argsort(scores.values, kind="stable")),
    )
    values, levels = np.full((len(rows), QUANTILES), np.nan), np.linspace(0, 1, QUANTILES)
    clipped = np.zeros(len(scores), dtype=bool) if sloped is None else scores.values <= keys.threshold
    for row, of_images in enumerate(rows):
        base = scores.values if sloped is None else scores.values + sloped[0].shift(scores, row)
        weights = of_images[scores.image]
        kept = weights > 0
        if kept.any():
            ordered, mass = product_limit(base[kept], clipped[kept], weights[kept])
            below = np.cumsum(mass)
            values[row] = np.interp(levels, (below - mass / 2) / below[-1], ordered)
    column = Column(values, "mean", np.full(QUANTILES, float(len(scores))))
    return QuantileScores(Entry(Key((*keys.names, "quantiles"), keys.state, (_PERCENT,)), column), keys.threshold)
