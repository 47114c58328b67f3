"""Dropout and class: confusion matrices, what the odds of a miss follow, and how long misses persist."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array
from modsim3d.core.text import counted
from modsim3d.learn import bootstrap, dropout_fit
from modsim3d.learn.bootstrap import SIGNIFICANT, Column, Entry, Key, Resampling, digits, nested, resample, widened
from modsim3d.learn.dropout_fit import EffectTerm, MissFit, fit_misses, miss_lags
from modsim3d.learn.lags import latent_share, vessel_noise, why_none
from modsim3d.learn.matches import Outcomes, kept_share, usual_run_s
from modsim3d.learn.persistence import Consecutive, why_no_steps

# ---- Effects on misses that performance states have for themselves ----

OWN_ATTRIBUTES = ("size_px", "distance_m")


@dataclass(frozen=True, eq=False)
class SplitEffects:
    """Effects in which an attribute has a slope for each state, their fit, and twice the gain in log-likelihood."""

    name: str
    by_units: bool
    effects: tuple[EffectTerm, ...]
    fit: MissFit
    gain: float


def own_effects(
    observed: Outcomes, effects: tuple[EffectTerm, ...], fit: MissFit, inflation: Mapping[str, float], notes: list[str]
) -> tuple[tuple[EffectTerm, ...], MissFit]:
    """Effects of which some have a slope for each state where misses are clearly likelier so, and the fit, begun with
    the attribute that gains most. Twice the gain in log-likelihood must exceed the logarithm of the number of
    annotations for each slope more (Bayesian information criterion), and what chance exceeds as rarely as one slope
    exceeds `SIGNIFICANT` standard errors. Gains are over `inflation`, that of the slope's variance. Notes say so."""
    enough = _states_with_enough(observed, len(effects))
    left = [name for name in OWN_ATTRIBUTES if any(effect.attribute == name for effect in effects)]
    if left and len(observed.states) > 1 and len(enough) < 2:
        needed = f"{dropout_fit.MISSES_FOR_EACH * len(effects)} misses and as many finds"
        notes.append(f"states.NAME.dropout: none; had {counted(len(enough), 'state')} with {needed}, needs 2")
    more = max(len(enough) - 1, 1)
    by_chance = float(special.chdtri(more, 2 * special.ndtr(-SIGNIFICANT)))
    needed_gain = max(more * np.log(max(len(observed.rows), 1)), by_chance)
    while left and len(enough) > 1:
        splits = [split for name in left for split in _splits(observed, effects, name, enough)]
        if not splits:
            break
        best = max(splits, key=lambda split: split.gain / inflation[split.name])
        gain, name = best.gain / inflation[best.name], best.name
        if gain < needed_gain:
            rest = f"a slope for each makes twice the log-likelihood {gain:.1f} larger, needs {needed_gain:.1f}"
            notes += [f"states.NAME.dropout.{attribute}: the same in all states; {rest}" for attribute in left]
            break
        form = f"a slope for each state, by {'units' if best.by_units else 'doublings'}"
        notes.append(f"states.NAME.dropout.{name}: {form} (twice the log-likelihood {gain:.1f} larger)")
        effects, fit = best.effects, best.fit
        left.remove(name)
    return effects, fit


def _states_with_enough(observed: Outcomes, effects: int) -> list[int]:
    states, missed = len(observed.states), observed.missed.astype(bool)
    misses = np.bincount(observed.state[missed], minlength=states)
    finds = np.bincount(observed.state[~missed], minlength=states)
    enough = np.flatnonzero(np.minimum(misses, finds) >= max(dropout_fit.MISSES_FOR_EACH * effects, 1))
    return [int(state) for state in enough[np.argsort(-(misses + finds)[enough], kind="stable")]]


def _splits(observed: Outcomes, effects: tuple[EffectTerm, ...], name: str, enough: list[int]) -> list[SplitEffects]:
    """Fits in which states have a slope of an attribute for themselves, by doublings and by units, and gains from the
    likelier of both forms with one slope for all. States that have too little share the slope of the one with most."""
    once = resample(observed.labelled.images, 0, 0)
    place = next(k for k, effect in enumerate(effects) if effect.attribute == name)
    before, after, splits, shared_fits = effects[:place], effects[place + 1 :], [], []
    for by_units in (False, True):
        shared = replace(effects[place], by_units=by_units)
        shared_fits.append(fit_misses(observed, (*before, shared, *after), once))
        common = [] if len(enough) == len(observed.states) else [shared]
        of_states = [replace(shared, state=state) for state in sorted(enough[len(common) :])]
        own = (*before, *common, *of_states, *after)
        fit = fit_misses(observed, own, once)
        if fit is not None:
            splits.append(SplitEffects(name, by_units, own, fit, 2 * fit.log_likelihood(observed.missed)))
    values = [2 * fit.log_likelihood(observed.missed) for fit in shared_fits if fit is not None]
    return [replace(split, gain=split.gain - max(values, default=-np.inf)) for split in splits]


def crowds(observed: Outcomes, labels: int) -> Array:
    """Mean number of sightings of the same thing in the same state, of each sighting, shape (states, labels)."""
    thing = np.where(observed.thing >= 0, observed.thing, -1 - np.arange(len(observed.rows)))
    cell = observed.state * labels + observed.label
    keys, count = np.unique(np.column_stack([cell, thing]), axis=0, return_counts=True)
    size = len(observed.states) * labels
    squares, whole = (np.bincount(keys[:, 0], count**power, minlength=size) for power in (2, 1))
    return (squares / np.maximum(whole, 1)).reshape(len(observed.states), labels)


_TRIALS = 200


@dataclass(frozen=True)
class ClassForm:
    """Effects on the odds of a miss, and the rough correlation time of misses, 0 if they do not persist. `things_keep`
    says whether things keep a share of the noise, `scored` whether one score stands behind misses and confidence."""

    effects: tuple[EffectTerm, ...]
    class_s: float
    notes: tuple[str, ...]
    things_keep: bool = False
    scored: bool = False

    def estimate(self, observed: Outcomes, resampling: Resampling) -> LearnedClasses:
        """Confusion matrices of each state, slopes of the effects, and the correlation time of misses."""
        fit = fit_misses(observed, self.effects, resampling) if self.effects else None
        class_s, share, kept, level, score = None, None, 0.0, 0.0, None
        chances = fit if self.effects else _plain_fit(observed)
        if self.scored and chances is not None:
            score = dropout_fit.learned_score(observed, chances.chance, len(self.effects), resampling)
            kept, level = kept_share(observed, self.class_s), score.level
        elif self.class_s > 0:
            if self.things_keep and chances is not None:
                table = miss_lags(observed, chances.chance, len(self.effects))
                noise = vessel_noise(table, resampling, latent_share(chances.chance))
                share, level = Entry(Key(("persistence", "class_vessel_share")), noise.share), noise.level
                time_s = noise.time_s
            else:
                time_s = consecutive_misses(observed, chances).column(resampling)
            class_s = Entry(Key(("persistence", "class_s")), time_s)
            kept = kept_share(observed, float(class_s.estimate))
        by_label = (1 - level) * (1 + kept) / (1 - kept) + level * crowds(observed, len(observed.labelled.labels))
        inflation = float(by_label.max())
        slopes = () if fit is None else _slopes(observed, self.effects, fit, inflation)
        confusion = _confusion(observed, fit, resampling, by_label)
        intercepts = () if fit is None else _intercepts(observed, fit)
        log_odds = None if fit is None else fit.log_odds
        return LearnedClasses(slopes, class_s, share, score, intercepts, confusion, inflation, log_odds)


@dataclass(frozen=True, eq=False)
class LearnedEffect:
    """An effect on the odds of a miss with its slope, in log-odds for each unit or doubling."""

    effect: EffectTerm
    slope: Entry


@dataclass(frozen=True, eq=False)
class LearnedClasses:
    """Numbers of dropout and class."""

    effects: tuple[LearnedEffect, ...]
    class_s: Entry | None  # correlation time of misses; None if they do not persist
    class_vessel_share: Entry | None  # share of the latent noise that each thing keeps; None if there is none
    score: dropout_fit.LearnedScore | None  # behind misses and confidence; None if they are drawn apart
    intercepts: tuple[Entry, ...]  # log-odds of a miss at the references less those of the mean rate, by state, (k,)
    confusion: tuple[Entry, ...]  # of each state, shape (k + 1, k); NaN in columns of labels that were never there
    inflation: float  # variance of the number of frames with a miss or confusion of a thing, over independent frames
    log_odds: Array | None  # quantiles of what the effects add in the learning set, shape (states, k, quantiles)

    def sections(self) -> dict[str, dict[str, Any]]:
        """Dropout and the persistence of misses."""
        sections: dict[str, dict[str, Any]] = {}
        if self.effects:
            sections["dropout"] = {"model": "logistic"} | self._effects_of(None)
        if self.class_s is not None and self.class_s.estimate > 0:
            sections["persistence"] = {"class_s": digits(self.class_s.estimate)}
            if self.class_vessel_share is not None:
                sections["persistence"]["class_vessel_share"] = digits(self.class_vessel_share.estimate)
        if self.score is not None:
            memory = {"class_s": digits(self.score.label_s)} if self.score.label_s else {}
            sections["persistence"] = memory | {"score": self.score.section()}
        return sections

    def state_section(self, state: int) -> dict[str, Any]:
        """The confusion matrix, effects that are the state's own, and the intercepts."""
        own = self._effects_of(state)
        if self.log_odds is not None:
            own |= {
                "intercept": nested(self.intercepts[state].estimate),
                "learned_log_odds": [[round(float(value), 3) for value in row] for row in self.log_odds[state]],
            }
        confusion = {"confusion": bootstrap.columns_of_one(filled(self.confusion[state].estimate))}
        return confusion | ({"dropout": own} if own else {})

    def _effects_of(self, state: int | None) -> dict[str, Any]:
        """Effects of a state alone; of None, those that states share."""
        return {
            term.effect.attribute: {
                term.effect.slope_key: digits(term.slope.estimate),
                "reference": digits(term.effect.reference),
            }
            for term in self.effects
            if term.effect.state == state
        }


def choose_classes(observed: Outcomes) -> ClassForm:
    """Choose the effects on misses that the data can carry, and whether misses persist."""
    notes: list[str] = []
    candidates = () if "effects" in observed.without else _candidates(observed, notes)
    effects, fit = _significant(observed, candidates, notes)
    chances = fit if effects else _plain_fit(observed)
    class_s = 0.0 if "persistence" in observed.without else _persistence_s(observed, chances, notes)
    scored = class_s > 0 and chances is not None and dropout_fit.behaves_like_a_score(observed, chances.chance, notes)
    things_keep = class_s > 0 and not scored and _things_keep(observed, len(effects), chances, notes)
    return ClassForm(effects, class_s, (*notes, *_empty_columns(observed)), things_keep, scored)


def _candidates(observed: Outcomes, notes: list[str]) -> tuple[EffectTerm, ...]:
    """Attributes that are given for every annotation and vary, if there are enough misses for them."""
    chosen = []
    for name, column in dropout_fit.attribute_values(observed).items():
        values = column[np.isfinite(column)]
        if not len(values):
            notes.append(f"dropout.{name}: none; it is not given")
        elif len(values) < len(column):
            notes.append(f"dropout.{name}: none; not given everywhere")
        elif np.ptp(values) < 1e-6 * max(abs(float(values.max())), 1.0):
            notes.append(f"dropout.{name}: none; constant")
        else:
            chosen.append(EffectTerm(name, dropout_fit.REFERENCES.get(name, float(f"{np.median(values):.3g}"))))
    misses = int(observed.missed.sum())
    rarer, needed = min(misses, len(observed.rows) - misses), dropout_fit.MISSES_FOR_EACH * len(chosen)
    if rarer >= needed:
        return tuple(chosen)
    rare = "misses" if misses == rarer else "finds"
    notes.append(f"dropout: as in the confusion matrix; had {rarer:,} {rare}, needs {needed}")
    return ()


def _significant(
    observed: Outcomes, effects: tuple[EffectTerm, ...], notes: list[str]
) -> tuple[tuple[EffectTerm, ...], MissFit | None]:
    """Effects after the least certain ones were left out one by one, and the fit with those that remain."""
    runs = resample(observed.labelled.images, _TRIALS, 0, usual_run_s(observed)) if effects else None
    while effects and runs is not None:
        fit = fit_misses(observed, effects, runs)
        hidden = next((effect for effect in effects if effect.attribute == "partly_hidden"), None)
        if fit is None and hidden is not None and len(effects) > 1:
            notes.append("dropout.partly_hidden: none; the visible fraction says as much")
            effects = tuple(effect for effect in effects if effect is not hidden)
            continue
        if fit is None:
            count = len(observed.rows)
            notes.append(f"dropout: as in the confusion matrix; {count} annotations do not determine the effects")
            break
        errors = np.maximum(bootstrap.spread(fit.slopes[1:]), fit.errors_of_things)
        strength = np.abs(fit.slopes[0]) / np.maximum(fit.errors, errors)
        weakest = int(strength.argmin())
        if strength[weakest] >= SIGNIFICANT:
            wider = np.maximum(errors / fit.errors, 1.0) ** 2
            inflation = {effect.attribute: float(ratio) for effect, ratio in zip(effects, wider, strict=True)}
            return own_effects(observed, *_in_units(observed, effects, fit, inflation, notes), inflation, notes)
        notes.append(
            f"dropout.{effects[weakest].attribute}: none; {strength[weakest]:.1f} standard errors from 0 in "
            f"{len(observed.rows):,} annotations, needs {SIGNIFICANT}"
        )
        effects = effects[:weakest] + effects[weakest + 1 :]
    return (), None


def _in_units(
    observed: Outcomes, effects: tuple[EffectTerm, ...], fit: MissFit, inflation: Mapping[str, float], notes: list[str]
) -> tuple[tuple[EffectTerm, ...], MissFit]:
    """Effects by units instead of doublings where misses are clearly likelier with them, gains over the inflation of
    the slope's variance, and the fit."""
    once = resample(observed.labelled.images, 0, 0)
    for place, effect in enumerate(effects):
        if not effect.doublings:
            continue
        changed = (*effects[:place], replace(effect, by_units=True), *effects[place + 1 :])
        other = fit_misses(observed, changed, once)
        if other is None:
            continue
        gain = other.log_likelihood(observed.missed) - fit.log_likelihood(observed.missed)
        gain /= inflation[effect.attribute]
        if gain > SIGNIFICANT**2 / 2:
            notes.append(f"dropout.{effect.attribute}: by units, not doublings (log-likelihood {gain:.1f} larger)")
            effects, fit = changed, other
    return effects, fit


def _persistence_s(observed: Outcomes, chances: MissFit | None, notes: list[str]) -> float:
    """Rough correlation time of misses; 0 with a note if they do not persist, or that is not sure."""
    if not len(observed.steps):
        notes.append(f"persistence: none; {why_no_steps(observed.labelled)}")
        return 0.0
    consecutive = consecutive_misses(observed, chances)
    correlation = consecutive.correlation()
    if correlation.persists:
        return consecutive.rough_time_s()
    varies = consecutive.expected.sum() > 0
    reason = correlation.doubt if varies else "of each label in each state either everything or nothing was missed"
    notes.append(f"persistence.class_s: 0; {reason}")
    return 0.0


def _things_keep(observed: Outcomes, slopes: int, chances: MissFit | None, notes: list[str]) -> bool:
    """Whether each thing surely keeps a share of the noise of misses; a note if not."""
    if chances is None or "vessels" in observed.without:
        return False
    why = why_none(miss_lags(observed, chances.chance, slopes))
    if why:
        notes.append(f"persistence.class_vessel_share: 0; {why}")
    return not why


def _empty_columns(observed: Outcomes) -> list[str]:
    notes, k = [], len(observed.labelled.labels)
    counts = np.bincount(observed.state * k + observed.label, minlength=len(observed.states) * k).reshape(-1, k)
    for state, label in np.argwhere(counts == 0):
        if counts[:, label].any():
            instead = "that of all states"
        else:
            instead = "found as often as the other labels, always by its name"
        column = f"states.{observed.states[state]}.confusion, column {observed.labelled.labels[label]}"
        notes.append(f"{column}: {instead}; had 0 of it")
    return notes


def _plain_fit(observed: Outcomes) -> MissFit | None:
    """Misses by state and label alone, without replicates."""
    return fit_misses(observed, (), resample(observed.labelled.images, 0, 0))


def consecutive_misses(observed: Outcomes, fit: MissFit | None) -> Consecutive:
    """Residuals of misses in consecutive frames from fitted chances of a miss, or one chance for all if None. A pair's
    expected product is that of two misses read from the same draw, scaled by how large the earlier squared residual
    was. Runs of frames with more misses than others then have larger products and larger expected products alike, and
    do not change the correlation time."""
    rate = np.full(len(observed.rows), observed.missed[observed.unambiguous].mean()) if fit is None else fit.chance
    residual = observed.missed - rate
    a, b = observed.steps.earlier, observed.steps.later
    size = residual[a] ** 2 / np.maximum(rate[a] * (1 - rate[a]), 1e-12)
    expected = (np.minimum(rate[a], rate[b]) - rate[a] * rate[b]) * size
    return Consecutive(residual[a] * residual[b], expected, observed.steps.apart_s, observed.image[b])


def _slopes(
    observed: Outcomes, effects: tuple[EffectTerm, ...], fit: MissFit, inflation: float
) -> tuple[LearnedEffect, ...]:
    learned = []
    for place, effect in enumerate(effects):
        slopes = widened(fit.slopes[:, place], fit.errors[place] * np.sqrt(inflation))
        column = Column(slopes, "mean", np.array(float(len(observed.rows))))
        state = None if effect.state is None else observed.states[effect.state]
        key = Key(("dropout", effect.attribute, effect.slope_key), state)
        learned.append(LearnedEffect(effect, Entry(key, column)))
    return tuple(learned)


def _intercepts(observed: Outcomes, fit: MissFit) -> tuple[Entry, ...]:
    labels, count = observed.labelled.labels, np.array(float(len(observed.rows)))
    keys = [Key(("dropout", "intercept"), name, (labels,)) for name in observed.states]
    columns = [Column(fit.intercepts[:, index], "mean", np.full(len(labels), count)) for index in range(len(keys))]
    return tuple(Entry(key, column) for key, column in zip(keys, columns, strict=True))


def _confusion(observed: Outcomes, fit: MissFit | None, resampling: Resampling, inflation: Array) -> tuple[Entry, ...]:
    """Confusion matrix of each state, at rates that effects leave; counts have an inflation (states, labels)."""
    labels = observed.labelled.labels
    k, states = len(labels), len(observed.states)
    cell = (observed.state * (k + 1) + observed.detected_label) * k + observed.label
    unambiguous = observed.unambiguous
    counts = resampling.counts(observed.image[unambiguous], cell[unambiguous], (states, k + 1, k))
    whole = counts.sum(axis=2, keepdims=True)
    rates = bootstrap.ratio(counts, whole)
    if fit is not None:
        detected = np.maximum(1 - rates[:, :, k], 1e-12)
        held = np.where(np.isfinite(fit.rates), fit.rates, rates[:, :, k])
        rates[:, :, :k] *= ((1 - held) / detected)[:, :, None]
        rates[:, :, k] = held
    everywhere = bootstrap.ratio(counts.sum(axis=1), whole.sum(axis=1))
    entries = []
    for index, name in enumerate(observed.states):
        table = np.where(np.isfinite(rates[:, index]), rates[:, index], everywhere)
        key = Key(("confusion",), name, ((*labels, "missed"), labels), own_table=True)
        entries.append(Entry(key, Column(table, "share", np.tile(whole[0, index], (k + 1, 1)), inflation[index])))
    return tuple(entries)


def filled(confusion: Array) -> Array:
    """A matrix in which labels that never occurred are found as often as the others on average, by their own name."""
    table = confusion.copy()
    k = table.shape[1]
    unseen = ~np.isfinite(table).all(axis=0)
    miss = float(table[k, ~unseen].mean()) if not unseen.all() else 0.0
    for label in np.flatnonzero(unseen):
        table[:, label] = 0.0
        table[label, label], table[k, label] = 1 - miss, miss
    return table
