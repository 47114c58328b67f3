"""Whitened box errors of the same thing in consecutive frames: how far they persist."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.error_laws import LAWS
from modsim3d.learn.mean_bias import stretches_of
from modsim3d.learn.persistence_fit import Consecutive, Steps, steps_between

_ROUNDS = 4
"""Rounds in which a correlation time and what follows from it settle."""
_STEPS_NEEDED = 20
"""Steps within a state that its errors are whitened from, instead of from the errors themselves."""
_LEAST_CHANGE = 1e-6


@dataclass(frozen=True, eq=False)
class WhiteErrors:
    """Box errors without their state's mean, scaled to unit covariance.

    Attributes:
        rows: Their annotations, shape (n,).
        white: The errors, shape (n, 4).
        state: State of each, shape (n,).
        laws: Name in `LAWS` of the law of each state; of Student's t errors, `white` has directions alone.
    """

    rows: Indices
    white: Array
    state: Indices
    laws: tuple[str, ...]


def compared(labelled: LabelledSet, errors: WhiteErrors) -> Consecutive:
    """Errors of the same thing in consecutive frames; products are means over the four components."""
    return _whitened_by_changes(labelled, errors)[1]


def whitened_by_changes(labelled: LabelledSet, errors: WhiteErrors) -> WhiteErrors:
    """The errors, scaled so that their changes from frame to frame have a covariance in proportion to 1.

    Few errors that persist do not tell their covariance well, and whitened by it they look less alike from frame to
    frame than they are. Changes from frame to frame are independent of each other. So errors are whitened by the
    covariance of changes, which depends on the correlation time: both are found in a few rounds.
    """
    return _whitened_by_changes(labelled, errors)[0]


def _whitened_by_changes(labelled: LabelledSet, errors: WhiteErrors) -> tuple[WhiteErrors, Consecutive]:
    steps = steps_between(labelled, errors.rows)
    image = labelled.annotations.image[errors.rows][steps.later]
    stretches = stretches_of(labelled, errors.rows, errors.state)
    found = replace(_products(steps, errors.white, image), stretches=stretches)
    if not len(steps):
        return errors, found
    ways = [LAWS[law] for law in errors.laws]
    directions = np.array([law != "normal" for law in errors.laws])[errors.state]
    later, white = np.arange(len(steps)), errors.white
    for _ in range(_ROUNDS):
        correlation = np.exp(-steps.apart_s / max(found.rough_time_s(), 1e-9))
        left = np.stack([law.correlation_left(correlation) for law in ways])[errors.state[steps.later], later]
        white = _whitened_again(errors.white, errors.state, steps, correlation * left, directions)
        found = replace(_products(steps, white, image), stretches=stretches)
        found = replace(found, expected=found.expected * left)
    return replace(errors, white=white), found


def _products(steps: Steps, white: Array, image: Indices) -> Consecutive:
    earlier, later = white[steps.earlier], white[steps.later]
    return Consecutive((earlier * later).mean(axis=1), (earlier**2).mean(axis=1), steps.apart_s, image)


def _whitened_again(white: Array, state: Indices, steps: Steps, correlation: Array, directions: Mask) -> Array:
    """Errors (n, 4) whitened by the covariance of their changes, given the correlation of each step, shape (m,)."""
    result = white.copy()
    change = white[steps.later] - correlation[:, None] * white[steps.earlier]
    change /= np.sqrt(np.maximum(1 - correlation**2, _LEAST_CHANGE))[:, None]
    for each in np.unique(state):
        within = (state[steps.earlier] == each) & (state[steps.later] == each)
        if within.sum() < _STEPS_NEEDED:
            continue
        values, vectors = np.linalg.eigh(change[within].T @ change[within] / within.sum())
        ours = state == each
        result[ours] = white[ours] @ (vectors / np.sqrt(np.maximum(values, 1e-12))) @ vectors.T
    lengths = np.linalg.norm(result[directions], axis=1, keepdims=True)
    result[directions] *= 2 / np.maximum(lengths, 1e-300)
    return result
