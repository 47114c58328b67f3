"""What is learned of confidence: distributions, slopes and how long it persists, and how they are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector import confidence
from modsim3d.detector.clipped_normal import clipped_sums, fit_clipped
from modsim3d.inputs.validation import LEAST
from modsim3d.learn.confidence.confidence_fit import SlopeFit, SlopeForm, product_limit, shift_of
from modsim3d.learn.confidence.scores import Scores
from modsim3d.learn.numbers.entries import Entry, Key, digits, nested
from modsim3d.learn.numbers.resampling import Column, Resampling, widened

QUANTILES = 21
_QUANTILE_REPLICATES = 200
_PERCENT = tuple(f"{k / (QUANTILES - 1):.0%}" for k in range(QUANTILES))

Sloped = tuple[SlopeFit, int] | None
"""A fit with slopes and which of its kinds it is; None without slopes."""


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
class Inflation:
    """Variances of estimated means and standard deviations over those from independent confidences."""

    mean: float = 1.0
    std: float = 1.0


@dataclass(frozen=True)
class ScoreKeys:
    """The keys of the section of a distribution in the file, its state, and the least confidence."""

    names: tuple[str, ...]
    state: str
    threshold: float
    inflation: Inflation = Inflation()


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
        std = digits(self.std.estimate)
        return {"mean": digits(self.mean.estimate), "std": std if std >= LEAST else 0.0}

    @property
    def law(self) -> confidence.Scores:
        """The distribution before it is clipped."""
        return confidence.NormalScores(float(self.mean.estimate), float(self.std.estimate))


@dataclass(frozen=True, eq=False)
class QuantileScores:
    """Evenly spaced quantiles from 0 to 100 %, shape (QUANTILES,)."""

    quantiles: Entry
    threshold: float

    def section(self) -> dict[str, Any]:
        """Quantiles that do not fall and lie in [threshold, 1]."""
        return {"quantiles": nested(self._rising)}

    @property
    def law(self) -> confidence.Scores:
        """The distribution before it is clipped."""
        return confidence.QuantileScores(self._rising)

    @property
    def _rising(self) -> Array:
        rising: Array = np.maximum.accumulate(np.clip(self.quantiles.estimate, self.threshold, 1))
        return rising


LearnedScores = NormalScores | QuantileScores


@dataclass(frozen=True, eq=False)
class LearnedSlopes:
    """The slopes of a state; the reference size is fitted if there is an entry of it, and fixed if not."""

    form: SlopeForm
    entries: tuple[Entry, ...]

    @classmethod
    def of(cls, fit: SlopeFit, state: str, scores: Scores, inflation: Inflation) -> LearnedSlopes:
        """From a fit, given the true detections."""
        entries, first = [], len(fit.errors) - len(fit.form.names)
        for place, name in enumerate(fit.form.names):
            values = widened(fit.slopes[:, place], fit.errors[first + place] * np.sqrt(inflation.mean))
            size = name == "size_reference_px"
            column = Column(2**values if size else values, "positive" if size else "mean", np.array(float(len(scores))))
            entries.append(Entry(Key(("confidence", name), state), column))
        return cls(fit.form, tuple(entries))

    def shift(self, scores: Scores) -> Array:
        """By how much they lower each confidence, shape (n,)."""
        found = {entry.key.names[-1]: float(entry.estimate) for entry in self.entries}
        if "size_reference_px" in found:
            found["size_reference_px"] = float(np.log2(found["size_reference_px"]))
        return shift_of(scores, found, self.form)

    def section(self) -> dict[str, float]:
        """Their keys in the file."""
        fixed = {"size_reference_px": digits(2**self.form.log_reference)} if self.form.size else {}
        return fixed | {entry.key.names[-1]: max(digits(entry.estimate), 0.0) for entry in self.entries}


@dataclass(frozen=True, eq=False)
class LearnedConfidence:
    """Distributions of confidence, of true and of false detections of each state, and the slopes, None without.

    `confidence_s` is the correlation time of a vessel's confidence, None if it does not persist.
    """

    true: tuple[LearnedScores, ...]
    false: tuple[LearnedScores, ...]
    slopes: tuple[LearnedSlopes | None, ...]
    confidence_s: Entry | None = None

    def sections(self) -> dict[str, dict[str, Any]]:
        """The persistence of confidence."""
        if self.confidence_s is None or self.confidence_s.estimate <= 0:
            return {}
        return {"persistence": {"confidence_s": digits(self.confidence_s.estimate)}}

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


def normal_scores(scores: Scores, keys: ScoreKeys, sloped: Sloped, resampling: Resampling) -> NormalScores:
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
    stretch = np.sqrt(keys.inflation.mean), np.sqrt(keys.inflation.std)
    return NormalScores(
        Entry(
            Key((*keys.names, "mean"), keys.state),
            Column(widened(mean, errors[0] * stretch[0]), "mean", np.array(count)),
        ),
        Entry(
            Key((*keys.names, "std"), keys.state),
            Column(widened(std, errors[1] * stretch[1]), "positive", np.array(count)),
        ),
        keys.threshold,
    )


def quantile_scores(scores: Scores, keys: ScoreKeys, sloped: Sloped, resampling: Resampling) -> QuantileScores:
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
