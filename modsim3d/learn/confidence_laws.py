"""Learned confidences: distributions, slopes and how long they persist, and how they are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.detector import confidence
from modsim3d.detector.chain import model_name
from modsim3d.detector.confidence import LEVELS, SCORES, clipped_sums, fit_clipped, pair_likelihood
from modsim3d.detector.confidence import ConfidenceLaw as Law
from modsim3d.io.validation import MIN_NUMBER
from modsim3d.learn.bootstrap import Column, Entry, Key, Resampling, digits, nested, widened
from modsim3d.learn.confidence_fit import ObservedConfidences, SlopeFit, SlopeForm, product_limit, shift_of
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.persistence import Consecutive, Steps, steps_between

QUANTILES = 21
_LIKELY = 0.975
_QUANTILE_REPLICATES = 200
_PERCENT = tuple(f"{k / (QUANTILES - 1):.0%}" for k in range(QUANTILES))

Sloped = tuple[SlopeFit, int] | None  # a fit with slopes and which of its kinds it is; None without slopes


@dataclass(frozen=True)
class Inflation:
    """Variances of estimated means and standard deviations over those from independent confidences."""

    mean: float = 1.0
    std: float = 1.0

    @classmethod
    def by_things(cls, values: Array, thing: Indices) -> Inflation:
        """Inflation where each thing keeps a part of its confidence: from the spread of the sums over things, given
        the thing of each value, shapes (n,). Few things tell their own spread poorly, hence Student's distribution."""
        _, of_thing = np.unique(thing, return_inverse=True)
        count = int(of_thing.max(initial=-1)) + 1
        if count < 2:
            return cls()
        wide = float(special.stdtrit(count - 1, _LIKELY) / special.ndtri(_LIKELY)) ** 2 * count / (count - 1)
        deviation = values - values.mean()
        parts = (deviation, deviation**2 - deviation.var())
        ratios = [(np.bincount(of_thing, part) ** 2).sum() / max((part**2).sum(), 1e-12) for part in parts]
        return cls(*(max(float(wide * ratio), 1.0) for ratio in ratios))


@dataclass(frozen=True)
class LawKeys:
    """The keys of the section of a distribution in the file, its state, and the least confidence."""

    names: tuple[str, ...]
    state: str
    threshold: float
    inflation: Inflation = Inflation()


@dataclass(frozen=True, eq=False)
class LearnedNormal:
    """A normal distribution, clipped to [threshold, 1]."""

    mean: Entry
    std: Entry
    threshold: float

    def section(self) -> dict[str, Any]:
        """Mean and standard deviation; any confidence if none were seen."""
        if not np.isfinite(self.mean.estimate):
            return {"quantiles": [self.threshold, 1.0]}
        std = digits(self.std.estimate)
        return {"mean": digits(self.mean.estimate), "std": std if std >= MIN_NUMBER else 0.0}

    @property
    def law(self) -> confidence.ConfidenceLaw:
        """The distribution before it is clipped."""
        return confidence.NormalScores(float(self.mean.estimate), float(self.std.estimate))


@dataclass(frozen=True, eq=False)
class LearnedQuantiles:
    """Evenly spaced quantiles from 0 to 100 %, shape (QUANTILES,)."""

    quantiles: Entry
    threshold: float

    def section(self) -> dict[str, Any]:
        """Quantiles that do not fall and lie in [threshold, 1]."""
        return {"quantiles": nested(self._rising)}

    @property
    def law(self) -> confidence.ConfidenceLaw:
        """The distribution before it is clipped."""
        return confidence.QuantileScores(self._rising)

    @property
    def _rising(self) -> Array:
        return np.maximum.accumulate(np.clip(self.quantiles.estimate, self.threshold, 1))


LearnedScores = LearnedNormal | LearnedQuantiles


@dataclass(frozen=True, eq=False)
class LearnedSlopes:
    """The slopes of a state; the reference size is fitted if there is an entry of it, and fixed if not."""

    form: SlopeForm
    entries: tuple[Entry, ...]

    @classmethod
    def of(cls, fit: SlopeFit, state: str, scores: ObservedConfidences, inflation: Inflation) -> LearnedSlopes:
        """From a fit, given the true detections."""
        entries, first = [], len(fit.errors) - len(fit.form.names)
        for place, name in enumerate(fit.form.names):
            values = widened(fit.slopes[:, place], fit.errors[first + place] * np.sqrt(inflation.mean))
            size = name == "size_reference_px"
            column = Column(2**values if size else values, "positive" if size else "mean", np.array(float(len(scores))))
            entries.append(Entry(Key(("confidence", name), state), column))
        return cls(fit.form, tuple(entries))

    def shift(self, scores: ObservedConfidences) -> Array:
        """Amount by which they lower each confidence, shape (n,)."""
        numbers = {entry.key.names[-1]: float(entry.estimate) for entry in self.entries}
        if "size_reference_px" in numbers:
            numbers["size_reference_px"] = float(np.log2(numbers["size_reference_px"]))
        return shift_of(scores, numbers, self.form)

    def section(self) -> dict[str, float]:
        """Their keys in the file."""
        fixed = {"size_reference_px": digits(2**self.form.log_reference)} if self.form.size else {}
        return fixed | {entry.key.names[-1]: max(digits(entry.estimate), 0.0) for entry in self.entries}


@dataclass(frozen=True, eq=False)
class LearnedConfidence:
    """Distributions of confidence, of true detections and of false positives of each state, and the slopes."""

    true: tuple[LearnedScores, ...]
    false: tuple[LearnedScores, ...]
    slopes: tuple[LearnedSlopes | None, ...]  # None without
    confidence_s: Entry | None = None  # correlation time of a vessel's confidence; None if it does not persist

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
    """A distribution of the confidence of all detections of each state; none where detections have no confidences."""

    states: tuple[LearnedNormal, ...]

    def sections(self) -> dict[str, dict[str, Any]]:
        """Nothing outside the states."""
        return {}

    def state_section(self, state: int) -> dict[str, Any]:
        """Mean and standard deviation; full confidence where nothing was detected, or no confidence is known."""
        section = self.states[state].section() if self.states else {}
        return {"confidence": section if "mean" in section else {"mean": 1.0, "std": 0.0}}


def normal_scores(scores: ObservedConfidences, keys: LawKeys, sloped: Sloped, resampling: Resampling) -> LearnedNormal:
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
    mean_column = Column(widened(mean, errors[0] * np.sqrt(keys.inflation.mean)), "mean", np.array(count))
    std_column = Column(widened(std, errors[1] * np.sqrt(keys.inflation.std)), "positive", np.array(count))
    mean_key, std_key = (Key((*keys.names, name), keys.state) for name in ("mean", "std"))
    return LearnedNormal(Entry(mean_key, mean_column), Entry(std_key, std_column), keys.threshold)


def quantile_scores(scores: ObservedConfidences, keys: LawKeys, sloped: Sloped, drawn: Resampling) -> LearnedQuantiles:
    """Quantiles of confidences under each row of weights; with slopes, of what they are without them."""
    rows = drawn.weights[: 1 + _QUANTILE_REPLICATES]
    scores = scores.take(np.argsort(scores.values, kind="stable"))
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
    return LearnedQuantiles(Entry(Key((*keys.names, "quantiles"), keys.state, (_PERCENT,)), column), keys.threshold)


# ---- How long the confidence of a vessel's detections persists ----

_STEP = 1e-4  # levels that a single confidence may have, above which its number counts as open between them
_GRID, _ROUNDS, _NEAR = 40, 30, 1e-3
_MAX_STEP, _SETTLED = 0.3, 1e-5
_MIN_TIMES, _MAX_TIMES = 0.05, 1000.0  # bounds of correlation times, in multiples of the usual time between sightings


@dataclass(frozen=True, eq=False)
class LatentScores:
    """Bounds of the normal numbers behind confidences, equal where known, NaN without a law; shapes (n,)."""

    low: Array
    high: Array

    @classmethod
    def of(cls, scores: ObservedConfidences, law: Law, shift: Array, threshold: float) -> LatentScores:
        """From a distribution that is shifted by (n,) before it is clipped."""
        check = LEVELS.get(model_name(SCORES, law))
        levels = None if check is None else check(law, scores.values, shift)
        if levels is None:
            return cls(np.full(len(scores), np.nan), np.full(len(scores), np.nan))
        middle, least = (levels[0] + levels[1]) / 2, 0.5 / max(len(scores), 1)
        wide = levels[1] - levels[0] > _STEP
        centre = special.ndtri(np.clip(middle, least, 1 - least))
        low = np.where(wide, special.ndtri(np.clip(levels[0], 0, 1 - least)), centre)
        high = np.where(wide, special.ndtri(np.clip(levels[1], least, 1)), centre)
        return cls(np.where(scores.values <= threshold, -np.inf, low), np.where(scores.values >= 1, np.inf, high))

    @property
    def known(self) -> Array:
        """Mask of the numbers that are known, shape (n,)."""
        return np.asarray(self.low == self.high)

    @property
    def expected(self) -> Array:
        """The numbers; those that are open by their expectation, shape (n,)."""
        chance = np.maximum(special.ndtr(self.high) - special.ndtr(self.low), 1e-12)
        density = [np.exp(-(edge**2) / 2) / np.sqrt(2 * np.pi) for edge in (self.low, self.high)]
        return np.where(self.known, self.low, (density[0] - density[1]) / chance)


@dataclass(frozen=True, eq=False)
class ConsecutiveScores:
    """Numbers behind the confidences of the same thing in consecutive sightings."""

    latent: LatentScores
    steps: Steps
    scores: ObservedConfidences

    @classmethod
    def of(cls, observed: Outcomes, scores: ObservedConfidences, latent: LatentScores) -> ConsecutiveScores:
        """Number behind each true detection, in the order of `observed.found`."""
        usable = np.flatnonzero(~np.isnan(latent.low))
        steps = steps_between(observed.labelled, observed.rows[observed.found[usable]])
        return cls(latent, Steps(usable[steps.earlier], usable[steps.later], steps.apart_s), scores)

    def products(self) -> Consecutive:
        """For the decision whether confidence persists."""
        expected, (a, b) = self.latent.expected, (self.steps.earlier, self.steps.later)
        return Consecutive(expected[a] * expected[b], expected[a] ** 2, self.steps.apart_s, self.scores.image[b])

    @property
    def _known_steps(self) -> Steps:
        known = self.latent.known[self.steps.earlier]
        return Steps(self.steps.earlier[known], self.steps.later[known], self.steps.apart_s[known])

    def _likelihood(self, steps: Steps, at: Array) -> Array:
        """Log-likelihood of each later sighting given the earlier one, shape (m,). At the logarithms of a correlation
        time and of a factor of all numbers, which a wrong spread makes."""
        a, b = steps.earlier, steps.later
        correlation = np.minimum(np.exp(-steps.apart_s / np.exp(at[0])), 1 - 1e-9)
        low, high = self.latent.low[b], self.latent.high[b]
        return pair_likelihood(self.latent.low[a], low, high, correlation, float(np.exp(at[1])))

    def _derivatives(self, steps: Steps, at: Array) -> tuple[Array, Array]:
        """Gradient (m, 2) and curvature (m, 2, 2) of each log-likelihood, by differences."""
        moves = _NEAR * np.eye(2)
        ahead, behind = ([self._likelihood(steps, at + sign * move) for move in moves] for sign in (1, -1))
        middle = self._likelihood(steps, at)
        both = self._likelihood(steps, at + moves[0] + moves[1]) + self._likelihood(steps, at - moves[0] - moves[1])
        gradient = np.column_stack([(ahead[k] - behind[k]) / (2 * _NEAR) for k in range(2)])
        curvature = np.empty((len(middle), 2, 2))
        for k in range(2):
            curvature[:, k, k] = (2 * middle - ahead[k] - behind[k]) / _NEAR**2
        mixed = (both - sum(ahead) - sum(behind) + 2 * middle) / (2 * _NEAR**2)
        curvature[:, 0, 1] = curvature[:, 1, 0] = -mixed
        return gradient, curvature

    def _likeliest(self) -> Array | None:
        """Logarithms of the likeliest correlation time and factor; None where no earlier number is known."""
        steps = self._known_steps
        if not len(steps):
            return None
        low, high = np.log(float(np.median(steps.apart_s)) * np.array([_MIN_TIMES, _MAX_TIMES]))
        tried = [np.array([at, 0.0]) for at in np.linspace(low, high, _GRID)]
        best = max(tried, key=lambda at: float(self._likelihood(steps, at).sum()))
        for _ in range(_ROUNDS):
            gradient, curvature = (part.sum(axis=0) for part in self._derivatives(steps, best))
            curvature = curvature + max(0.0, 1e-9 - 2 * float(np.linalg.eigvalsh(curvature)[0])) * np.eye(2)
            step = np.clip(np.linalg.solve(curvature, gradient), -_MAX_STEP, _MAX_STEP)
            best = np.clip(best + step, [low, -1.0], [high, 1.0])
            if np.abs(step).max() < _SETTLED:
                break
        return best

    def time_s(self) -> float:
        """The likeliest correlation time; 0 where no earlier number is known."""
        best = self._likeliest()
        return 0.0 if best is None else float(np.exp(best[0]))

    def column(self, resampling: Resampling) -> Column:
        """The correlation time; replicates by one Newton step of its logarithm and of the factor."""
        best, steps = self._likeliest(), self._known_steps
        if best is None:
            return Column(np.zeros(len(resampling.weights)), "positive", np.array(0.0))
        gradient, curvature = self._derivatives(steps, best)
        image, inverse = self.scores.image[steps.later], np.linalg.pinv(curvature.sum(axis=0))
        bends, slopes = resampling.sums(image, curvature), resampling.sums(image, gradient)
        sound = np.linalg.eigvalsh(bends)[:, 0] > np.linalg.eigvalsh(bends[0])[0] / 10
        own = np.linalg.solve(np.where(sound[:, None, None], bends, np.eye(2)), slopes[..., None])[:, 0, 0]
        moves = np.where(sound, own, slopes @ inverse[0])
        moves[0] = 0.0
        spread = np.sqrt(np.maximum((inverse @ (gradient.T @ gradient) @ inverse)[0, 0], 0))
        times = np.exp(best[0] + widened(np.clip(moves, -2, 2), np.array(spread)))
        return Column(times, "positive", np.array(float(len(steps))))
