"""Effects on misses that performance states have for themselves, where one slope for all of them does not fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from modsim3d.learn.dropout_fit import MISSES_FOR_EACH, Effect, MissFit, fit_misses
from modsim3d.learn.form import SIGNIFICANT
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import resample

OWN_ATTRIBUTES = ("size_px", "distance_m")


def own_effects(
    observed: Observed, effects: tuple[Effect, ...], fit: MissFit, inflation: float, notes: list[str]
) -> tuple[tuple[Effect, ...], MissFit]:
    """Effects of which some have a slope for each state where misses are clearly likelier so, and the fit.

    The attribute that gains most comes first. Twice the gain in log-likelihood must exceed the logarithm of the number
    of annotations for each slope more (Bayesian information criterion), and the square of `SIGNIFICANT`.

    Args:
        observed: What was seen.
        effects: Effects that all states share.
        fit: The fit with them.
        inflation: Variance of the slopes over that of independent misses, by which the gain is divided.
        notes: What was decided is added to them.
    """
    once = resample(observed.labelled.images, 0, 0)
    enough = _states_with_enough(observed, len(effects))
    left = [name for name in OWN_ATTRIBUTES if any(effect.attribute == name for effect in effects)]
    if left and len(observed.states) > 1 and len(enough) < 2:
        needed = f"{MISSES_FOR_EACH * len(effects)} misses and as many finds"
        notes.append(f"states.dropout: none of a state's own; {len(enough)} states have {needed}, needs 2")
    needed_gain = max((len(enough) - 1) * np.log(max(len(observed.rows), 1)), SIGNIFICANT**2)
    while left and len(enough) > 1:
        gains = []
        for name in left:
            for split in _split(effects, name, enough, len(observed.states)):
                other = fit_misses(observed, split, once)
                if other is not None:
                    gain = other.log_likelihood(observed.missed) - fit.log_likelihood(observed.missed)
                    gains.append((2 * gain / inflation, name, split, other))
        if not gains:
            break
        gain, name, split, other = max(gains, key=lambda each: each[0])
        if gain < needed_gain:
            rest = f"{gain:.1f} likelier (twice the log-likelihood), needs {needed_gain:.1f}"
            notes += [f"states.dropout.{each}: the same in all states; at most {rest}" for each in left]
            break
        by_units = any(effect.attribute == name and effect.by_units for effect in split)
        form = f"a slope for each state, by {'units' if by_units else 'doublings'}"
        notes.append(f"states.dropout.{name}: {form} (twice the log-likelihood {gain:.1f} larger)")
        effects, fit = split, other
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


def _split(effects: tuple[Effect, ...], name: str, enough: list[int], states: int) -> Iterator[tuple[Effect, ...]]:
    """Effects in which states have a slope of an attribute for themselves, by doublings and by units.

    If some of all the states have too little, they share the slope of the state that has most.
    """
    place = next(k for k, effect in enumerate(effects) if effect.attribute == name)
    for by_units in (False, True):
        shared = replace(effects[place], by_units=by_units)
        yield (*effects[:place], *_of_each(shared, enough, states), *effects[place + 1 :])


def _of_each(shared: Effect, enough: list[int], states: int) -> list[Effect]:
    common = [] if len(enough) == states else [shared]
    return [*common, *(replace(shared, state=state) for state in sorted(enough[len(common) :]))]
