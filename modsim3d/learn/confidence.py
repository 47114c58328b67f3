"""Confidence: its distribution in each state, for true detections and false positives."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array
from modsim3d.detector.confidence import clipped_sums, fit_clipped
from modsim3d.learn import confidence_fit, confidence_laws
from modsim3d.learn.bootstrap import SIGNIFICANT, Entry, Key, Resampling, resample, spread
from modsim3d.learn.confidence_fit import KINDS, Kind, ObservedConfidences, SlopeFit, SlopeForm
from modsim3d.learn.confidence_laws import ConsecutiveScores, Inflation, LatentScores, LawKeys, LearnedConfidence
from modsim3d.learn.matches import Outcomes, usual_run_s
from modsim3d.learn.persistence import inflation, steps_between

# ---- Whether confidence falls ----

SCORES_NEEDED = 20  # detections that a state's own distribution needs, and partly hidden ones a slope on visibility
SLOPE_NEEDS = 50  # detections that a slope needs
_TRIALS = 200
_HIDDEN = 0.05
_EQUAL = 1e-3


def with_enough(samples: Mapping[Kind, ObservedConfidences]) -> dict[Kind, ObservedConfidences]:
    """The kinds whose confidences are enough, and differ enough, to tell a slope."""
    return {
        kind: scores
        for kind, scores in samples.items()
        if len(scores) >= SCORES_NEEDED and float(scores.values.std()) > _EQUAL
    }


def choose_slopes(
    observed: Outcomes, state: str, samples: Mapping[Kind, ObservedConfidences], notes: list[str]
) -> SlopeForm | None:
    """The slopes of a state that are surely above 0, or None. Whether confidence follows size is tested with the median
    size as the reference: the best of many would look significant too often. A slope has the likeliest reference."""
    if "slopes" in observed.without:
        return None
    path = f"states.{state}.confidence"
    if "true" not in samples or len(samples["true"]) < SLOPE_NEEDS:
        count = len(samples["true"]) if "true" in samples else 0
        notes.append(f"{path}: no slopes; had {count:,} true detections of different confidence, needs {SLOPE_NEEDS}")
        return None
    visibility = _why_not_visibility(samples["true"])
    size = "all boxes have one size" if np.ptp(samples["true"].log_size) < _EQUAL else ""
    for key, reason in (("visibility_slope", visibility), ("size_slope", size)):
        if reason:
            notes.append(f"{path}.{key}: 0; {reason}")
    median = float(f"{2 ** float(np.median(samples['true'].log_size)):.2g}")
    form = _significant(observed, path, samples, SlopeForm(not visibility, not size, float(np.log2(median))), notes)
    if not form.names:
        return None
    if not form.size:
        return form
    return confidence_fit.likeliest_reference(list(samples.values()), form, observed.threshold, SCORES_NEEDED)


def _why_not_visibility(scores: ObservedConfidences) -> str:
    """Reason why there is no slope on visibility; empty if there may be one."""
    known = np.isfinite(scores.visible_fraction)
    if not known.all():
        return "visibility is not given everywhere" if known.any() else "visibility is not given"
    hidden = int((scores.hidden > _HIDDEN).sum())
    return "" if hidden >= SCORES_NEEDED else f"had {hidden} partly hidden true detections, needs {SCORES_NEEDED}"


def _significant(
    observed: Outcomes, path: str, samples: Mapping[Kind, ObservedConfidences], form: SlopeForm, notes: list[str]
) -> SlopeForm:
    """The form without the slopes that are not surely above 0; the least certain one is left out first."""
    runs = resample(observed.labelled.images, _TRIALS, 0, usual_run_s(observed))
    scores = list(samples.values())
    while form.names:
        fit = confidence_fit.fit_slopes(scores, [False] * len(scores), form, observed.threshold, runs)
        if fit is None:
            notes.append(f"{path}: no slopes; {sum(map(len, scores))} detections do not determine them")
            return SlopeForm(False, False)
        strength = fit.slopes[0] / np.maximum(fit.errors[-len(form.names) :], spread(fit.slopes[1:]))
        weakest = int(strength.argmin())
        if strength[weakest] >= SIGNIFICANT:
            break
        key = form.names[weakest]
        below = ", and only slopes above 0 are simulated" if strength[weakest] <= -SIGNIFICANT else ""
        notes.append(
            f"{path}.{key}: 0; {strength[weakest]:.1f} standard errors above 0 in {len(samples['true']):,} true "
            f"detections, needs {SIGNIFICANT}{below}"
        )
        form = replace(form, **{"visibility" if key == "visibility_slope" else "size": False})
    return form


QUANTILES_NEEDED = 200  # detections that quantiles need
_NORMAL_ENOUGH = 0.06  # largest difference of distribution functions at which confidence still counts as clipped normal
_LEVELS = 500

ScoreForm = Literal["normal", "quantiles", "shared"]
"""A normal distribution clipped to [threshold, 1], evenly spaced quantiles, or the normal one that all states share."""


@dataclass(frozen=True)
class ConfidenceForm:
    """The distributions of confidence of true and false positives in each state, and its slopes, None without.
    `scored` says that confidence persists with the score behind misses, and has no correlation time of its own."""

    true: tuple[ScoreForm, ...]
    false: tuple[ScoreForm, ...]
    slopes: tuple[SlopeForm | None, ...]
    notes: tuple[str, ...]
    confidence_s: float = 0.0
    scored: bool = False

    def estimate(self, observed: Outcomes, resampling: Resampling) -> LearnedConfidence:
        """The distributions of each state, the slopes, and the correlation time."""
        learned = self.laws(observed, resampling)
        if self.confidence_s <= 0 or self.scored:
            return learned
        column = consecutive_scores(observed, learned).column(resampling)
        return replace(learned, confidence_s=Entry(Key(("persistence", "confidence_s")), column))

    def laws(self, observed: Outcomes, resampling: Resampling) -> LearnedConfidence:
        """All but the correlation time."""
        persistent = self._inflation(observed)
        every = {kind: ObservedConfidences.of(observed, kind) for kind in KINDS}
        learned: dict[Kind, list[confidence_laws.LearnedScores]] = {"true": [], "false": []}
        slopes: list[confidence_laws.LearnedSlopes | None] = []
        for index, (state, form) in enumerate(zip(observed.states, self.slopes, strict=True)):
            forms: dict[Kind, ScoreForm] = {"true": self.true[index], "false": self.false[index]}
            chosen = {kind: every[kind] if forms[kind] == "shared" else every[kind].of_state(index) for kind in KINDS}
            sloped: dict[Kind, confidence_laws.Sloped] = {}
            fit = None
            if form is not None:
                samples = with_enough(chosen)
                kinds, quantiles = list(samples.values()), [forms[kind] == "quantiles" for kind in samples]
                fit = confidence_fit.fit_slopes(kinds, quantiles, form, observed.threshold, resampling)
                if fit is not None:
                    sloped = {kind: (fit, place) for place, kind in enumerate(samples)}
            of_state = None if fit is None else confidence_laws.LearnedSlopes.of(fit, state, chosen["true"], persistent)
            slopes.append(of_state)
            kept = Inflation()
            if self.scored:
                base = chosen["true"].values + (0.0 if of_state is None else of_state.shift(chosen["true"]))
                kept = Inflation.by_things(base, chosen["true"].thing)
            for kind in KINDS:
                larger = Inflation(max(persistent.mean, kept.mean), max(persistent.std, kept.std))
                persists = larger if kind == "true" else Inflation()
                keys = LawKeys(("confidence", kind), state, observed.threshold, persists)
                quantile = forms[kind] == "quantiles"
                estimate = confidence_laws.quantile_scores if quantile else confidence_laws.normal_scores
                learned[kind].append(estimate(chosen[kind], keys, sloped.get(kind), resampling))
        return LearnedConfidence(tuple(learned["true"]), tuple(learned["false"]), tuple(slopes))

    def _inflation(self, observed: Outcomes) -> Inflation:
        """Inflation of means by confidence that persists; deviations from a standard deviation persist half as long."""
        if self.confidence_s <= 0:
            return Inflation()
        steps, count = steps_between(observed.labelled, observed.rows[observed.found]), len(observed.found)
        return Inflation(*(inflation(steps, count, self.confidence_s / part) for part in (1, 2)))


@dataclass(frozen=True)
class OneConfidenceForm:
    """One normal distribution of the confidence of true and false positives in each state, if any is given."""

    notes: tuple[str, ...] = ()
    confidence_s: float = 0.0

    def estimate(self, observed: Outcomes, resampling: Resampling) -> confidence_laws.LearnedConfidenceOfAll:
        """The distribution of each state; that of all states where one has too few detections."""
        if not observed.labelled.scored:
            return confidence_laws.LearnedConfidenceOfAll(())
        every = ObservedConfidences.join([ObservedConfidences.of(observed, kind) for kind in KINDS])
        learned = []
        for index, state in enumerate(observed.states):
            scores = every.of_state(index)
            scores = scores if len(scores) >= SCORES_NEEDED else every
            keys = LawKeys(("confidence",), state, observed.threshold)
            learned.append(confidence_laws.normal_scores(scores, keys, None, resampling))
        return confidence_laws.LearnedConfidenceOfAll(tuple(learned))


def choose_confidence(observed: Outcomes, scored: bool = False) -> ConfidenceForm | OneConfidenceForm:
    """Choose law and slopes of confidences of each state and kind; `scored`: the score behind misses is behind them."""
    if not observed.labelled.scored:
        return OneConfidenceForm(("confidence: 1 for every detection; the detections have none (-1)",))
    if "confidence" in observed.without:
        return OneConfidenceForm()
    notes: list[str] = []
    scores = {kind: ObservedConfidences.of(observed, kind) for kind in KINDS}
    chosen: dict[Kind, list[ScoreForm]] = {"true": [], "false": []}
    slopes: list[SlopeForm | None] = []
    for index, state in enumerate(observed.states):
        by_kind = {kind: scores[kind].of_state(index) for kind in KINDS}
        samples = {kind: by_kind[kind] if len(by_kind[kind]) >= SCORES_NEEDED else scores[kind] for kind in KINDS}
        slopes.append(choose_slopes(observed, state, with_enough(samples), notes))
        fit = _normal_fit(samples, slopes[-1], observed)
        for place, kind in enumerate(KINDS):
            if len(by_kind[kind]) < SCORES_NEEDED:
                chosen[kind].append("shared")
                notes.append(
                    f"states.{state}.confidence.{kind}: that of all states; had {len(by_kind[kind])} detections, "
                    f"needs {SCORES_NEEDED}"
                )
            elif len(by_kind[kind]) < QUANTILES_NEEDED:
                chosen[kind].append("normal")
            else:
                far = _distance(by_kind[kind], fit, place, observed.threshold)
                chosen[kind].append("normal" if far < _NORMAL_ENOUGH else "quantiles")
    form = ConfidenceForm(tuple(chosen["true"]), tuple(chosen["false"]), tuple(slopes), ())
    confidence_s = 0.0 if "persistence" in observed.without else _persistence_s(observed, form, notes)
    return replace(form, notes=tuple(notes), confidence_s=confidence_s, scored=scored)


def consecutive_scores(observed: Outcomes, learned: LearnedConfidence) -> ConsecutiveScores:
    """The numbers behind the confidences of true detections, under what was learned."""
    scores = ObservedConfidences.of(observed, "true")
    low, high = np.full(len(scores), np.nan), np.full(len(scores), np.nan)
    for index, (law, slopes) in enumerate(zip(learned.true, learned.slopes, strict=True)):
        rows = np.flatnonzero(scores.state == index)
        sample = scores.take(rows)
        if with_enough({"true": sample}):
            shift = np.zeros(len(rows)) if slopes is None else -slopes.shift(sample)
            latent = LatentScores.of(sample, law.law, shift, observed.threshold)
            low[rows], high[rows] = latent.low, latent.high
    return ConsecutiveScores.of(observed, scores, LatentScores(low, high))


def _persistence_s(observed: Outcomes, form: ConfidenceForm, notes: list[str]) -> float:
    """Rough correlation time of confidence; 0 with a note if it does not persist, or that is not sure."""
    if not len(observed.steps):
        return 0.0  # which the note on misses says
    given = tuple(slopes and replace(slopes, reference_fitted=False) for slopes in form.slopes)
    form = replace(form, slopes=given)  # the likeliest reference changes little here, and takes a while to find
    consecutive = consecutive_scores(observed, form.laws(observed, resample(observed.labelled.images, 0, 0)))
    products = consecutive.products()
    correlation = products.correlation()
    if correlation.persists:
        return consecutive.time_s()
    why = correlation.doubt if len(products) else "nothing has two true detections whose confidences vary"
    notes.append(f"persistence.confidence_s: 0; {why}")
    return 0.0


def _normal_fit(
    samples: Mapping[Kind, ObservedConfidences], form: SlopeForm | None, observed: Outcomes
) -> SlopeFit | None:
    """The slopes with normal distributions and a given reference, without replicates; None without slopes."""
    if form is None:
        return None
    form = replace(form, reference_fitted=False)
    sloped, once = list(with_enough(samples).values()), resample(observed.labelled.images, 0, 0)
    return confidence_fit.fit_slopes(sloped, [False] * len(sloped), form, observed.threshold, once)


def _distance(scores: ObservedConfidences, fit: SlopeFit | None, kind: int, threshold: float) -> float:
    """Largest difference between the distribution function of the levels (n,) of confidences, the probability of
    smaller ones in the fit, and that of uniform ones. Clipped ones lie beyond their bound's."""
    if fit is None:
        return _normal_distance(scores.values, threshold)
    means, std = fit.means[0, kind] - fit.shift(scores), fit.stds[0, kind]
    level = special.ndtr((scores.values - means) / std)
    low = np.where(scores.values <= threshold, 0.0, level)
    high = np.where(scores.values >= 1, 1.0, level)
    grid = np.linspace(0, 1, _LEVELS + 1)
    counts = np.searchsorted(np.sort(level[low == high]), grid, side="right")
    wide = np.flatnonzero(low < high)
    part = np.zeros(len(grid))
    for k, at in enumerate(grid.tolist()):
        part[k] = np.clip((at - low[wide]) / (high[wide] - low[wide]), 0, 1).sum()
    return float(np.abs((counts + part) / len(level) - grid).max())


def _normal_distance(values: Array, threshold: float) -> float:
    """Largest difference between the distribution function of values (n,) and that of their clipped normal fit."""
    mean, std = fit_clipped(clipped_sums(values, threshold, 1.0).sum(axis=0)[None], threshold, 1.0)
    ordered = np.sort(values)
    fitted = np.where(ordered >= 1, 1.0, special.ndtr((ordered - mean[0]) / max(std[0], 1e-9)))
    after = np.searchsorted(ordered, ordered, side="right") / len(values)
    before = np.searchsorted(ordered, ordered, side="left") / len(values)
    below = np.where(ordered <= threshold, 0.0, np.abs(fitted - before))
    return float(max(below[ordered < 1].max(initial=0.0), np.abs(fitted - after).max(initial=0.0)))
