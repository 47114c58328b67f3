"""Box errors of which each thing keeps a share for as long as it is seen: some boxes are always off to one side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.box_errors.error_persistence import WhiteErrors, correlation_left
from modsim3d.learn.numbers.entries import Entry, entries_of, with_entries
from modsim3d.learn.numbers.resampling import from_scale, spread, to_scale
from modsim3d.learn.persistence.vessel_noise import LagTable

T = TypeVar("T")
_SHARES = np.linspace(0, 0.99, 100)
_MEAN, _STD, _CORRELATION = "box_error_mean", "box_error_std", "box_error_correlation"


def error_lags(labelled: LabelledSet, errors: WhiteErrors) -> LagTable:
    """Products of whitened errors at all times between, means over the four components."""
    white = errors.white
    square = (white**2).mean(axis=1)

    def compare(earlier: Indices, later: Indices) -> tuple[Array, Array]:
        return (white[earlier] * white[later]).mean(axis=1), (square[earlier] + square[later]) / 2

    return LagTable.of(labelled, errors.rows, errors.state, compare)


def latent_share(errors: WhiteErrors) -> Callable[[Array], Array]:
    """What share of the latent normal numbers things keep, from the correlation that it leaves."""
    heavy = errors.heavy[int(np.bincount(errors.state).argmax())]
    level = _SHARES * correlation_left(_SHARES, np.full(len(_SHARES), 4)) if heavy else _SHARES
    return lambda found: np.interp(found, level, _SHARES)


def with_things(learned: T, labelled: LabelledSet, errors: WhiteErrors, states: tuple[str, ...], share: float) -> T:
    """Learned errors whose replicates spread as far as things that keep a share make the numbers stray.

    Means stray by the share of a variance, and spreads and correlations, which are made of squares, by its square, each
    over as many things as there are in the state. Runs of frames that are resampled have the same things.
    """
    annotations, images = labelled.annotations, labelled.images
    thing = np.column_stack(
        [errors.state, images.sequence[annotations.image[errors.rows]], annotations.identity[errors.rows]]
    )
    keys, count = np.unique(thing, axis=0, return_counts=True)
    squares, whole = (np.bincount(keys[:, 0], count**power, minlength=len(states)) for power in (2, 1))
    crowding = dict(zip(states, squares / np.maximum(whole, 1) ** 2, strict=True))
    stds = {entry.key.state: entry.estimate for entry in entries_of(learned) if entry.key.names == (_STD,)}

    def change(entry: Entry) -> Entry:
        state, name = entry.key.state, entry.key.names[0]
        if state is None or name not in (_MEAN, _STD, _CORRELATION):
            return entry
        each = {_MEAN: share * stds[state] ** 2, _STD: share**2 / 2, _CORRELATION: share**2}[name]
        column = entry.column
        scaled = to_scale(column.values, column.kind)
        found = spread(scaled[1:]) ** 2
        usable = np.isfinite(found) & (found > 0)
        wider = np.where(usable, np.sqrt(1 + each * crowding[state] / np.where(usable, found, 1.0)), 1.0)
        values = from_scale(scaled[0] + wider * (scaled - scaled[0]), column.kind)
        return Entry(entry.key, replace(column, values=values))

    return with_entries(learned, change)
