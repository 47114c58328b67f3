"""Effects on misses that performance states have for themselves, where one slope for all of them does not fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.display import counted
from modsim3d.learn.misses.dropout_fit import MISSES_FOR_EACH, Effect, MissFit, fit_misses
from modsim3d.learn.numbers.resampling import SIGNIFICANT, resample
from modsim3d.learn.observed.observed import Observed

OWN_ATTRIBUTES = ("size_px", "distance_m")


@dataclass(frozen=True, eq=False)
class SplitEffects:
    """Effects in which an attribute has a slope for each state, their fit, and twice the gain in log-likelihood."""

    name: str
    by_units: bool
    effects: tuple[Effect, ...]
    fit: MissFit
    gain: float


def own_effects(
    observed: Observed, effects: tuple[Effect, ...], fit: MissFit, inflation: Mapping[str, float], notes: list[str]
) -> tuple[tuple[Effect, ...], MissFit]:
    """Effects of which some have a slope for each state where misses are clearly likelier so, and the fit.

    The attribute that gains most comes first. Twice the gain in log-likelihood must exceed the logarithm of the number
    of annotations for each slope more (Bayesian information criterion), and what chance exceeds as rarely as one slope
    exceeds `SIGNIFICANT` standard errors.

    Args:
        observed: What was seen.
        effects: Effects that all states share.
        fit: The fit with them.
        inflation: Variance of the slope of each attribute over that of independent misses, by which gains are divided.
        notes: What was decided is added to them.
    """
    enough = _states_with_enough(observed, len(effects))
    left = [name for name in OWN_ATTRIBUTES if any(effect.attribute == name for effect in effects)]
    if left and len(observed.states) > 1 and len(enough) < 2:
        needed = f"{MISSES_FOR_EACH * len(effects)} misses and as many finds"
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
            notes += [f"states.NAME.dropout.{each}: the same in all states; {rest}" for each in left]
            break
        form = f"a slope for each state, by {'units' if best.by_units else 'doublings'}"
        notes.append(f"states.NAME.dropout.{name}: {form} (twice the log-likelihood {gain:.1f} larger)")
        effects, fit = best.effects, best.fit
        left.remove(name)
    return effects, fit


def _states_with_enough(observed: Observed, effects: int) -> list[int]:
    """States with enough misses and finds for slopes of their own, those with most annotations first."""
    states, missed = len(observed.states), observed.missed.astype(bool)
    misses = np.bincount(observed.state[missed], minlength=states)
    finds = np.bincount(observed.state[~missed], minlength=states)
    rarer = np.minimum(misses, finds)
    enough = np.flatnonzero(rarer >= max(MISSES_FOR_EACH * effects, 1))
    return [int(state) for state in enough[np.argsort(-(misses + finds)[enough], kind="stable")]]


def _splits(observed: Observed, effects: tuple[Effect, ...], name: str, enough: list[int]) -> list[SplitEffects]:
    """Fits in which states have a slope of an attribute for themselves, by doublings and by units.

    If some of all the states have too little, they share the slope of the state that has most. The gain counts from the
    likelier of both forms with one slope for all states, so that it is not the gain of another form.
    """
    once = resample(observed.labelled.images, 0, 0)
    place = next(k for k, effect in enumerate(effects) if effect.attribute == name)
    before, after, splits, shared_fits = effects[:place], effects[place + 1 :], [], []
    for by_units in (False, True):
        shared = replace(effects[place], by_units=by_units)
        shared_fits.append(fit_misses(observed, (*before, shared, *after), once))
        own = (*before, *_of_each(shared, enough, len(observed.states)), *after)
        fit = fit_misses(observed, own, once)
        if fit is not None:
            splits.append(SplitEffects(name, by_units, own, fit, 2 * fit.log_likelihood(observed.missed)))
    most = max((2 * fit.log_likelihood(observed.missed) for fit in shared_fits if fit is not None), default=-np.inf)
    return [replace(split, gain=split.gain - most) for split in splits]


def _of_each(shared: Effect, enough: list[int], states: int) -> list[Effect]:
    common = [] if len(enough) == states else [shared]
    return [*common, *(replace(shared, state=state) for state in sorted(enough[len(common) :]))]
