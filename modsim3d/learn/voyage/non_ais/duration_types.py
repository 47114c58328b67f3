"""Two kinds of durations of what no vessel is matched with: what lasts as vessels do, and flicker that stays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.learn.voyage.non_ais.linking import Tracklets

MIN_S = 30.0  # what lasts as vessels do lasts so long on average at least
MIN_RATIO = 3.0  # and so many times as long as flicker that stays, whose mean is at most the least over this
_STEPS = 60
_SURE = 6.0  # gain of log-likelihood by which the longer kind is there: by chance it is as large in one of 400 sets
_MIN_WEIGHT = 0.05  # in a replicate without any of the few things that last, they are still known to be there
_SINGLE, _SHORT, _LONG = range(3)


@dataclass(frozen=True, eq=False)
class DurationTypes:
    """Durations that are alike, and the mixture fitted to them in each replicate. Things of a `longer` one move like a
    vessel, for longer than flicker on average; `unsteady` ones last, but jump: false, and perhaps vessels."""

    of_thing: Indices  # which duration each of N things has, (N,)
    lasting: Array  # probability that a thing of each duration is of the longer kind, (rows, durations)
    short_s: Array  # mean lifetime of flicker that stays, (rows,)
    long_s: Array  # mean lifetime of the longer kind, (rows,)
    found: bool  # whether the data show a longer kind; else `lasting` is 0
    longer: Mask  # (durations,)
    unsteady: Mask  # (durations,)
    inflation: float  # factor by which flicker that stays raises the variance of the number of its detections

    def at_least(self, probability: float) -> Mask:
        """Durations that may be of vessels with such a probability, (durations,): long ones, where the data show no
        longer kind, and always those of things that last and jump."""
        likely: Mask = self.lasting[0] >= probability
        return (likely if self.found else self.longer) | self.unsteady


def kinds_of(tracklets: Tracklets, weights: Array, gap_s: float, least_s: float = MIN_S) -> DurationTypes:
    """Fit the mixture to durations of N things with weights (rows, N), one in the first row. What does not move like a
    vessel is of no longer kind, however long it lasts. Given usual gaps between frames, and the least mean lifetime."""
    perhaps = tracklets.perhaps_vessel
    keys = np.column_stack([tracklets.frames, tracklets.cut, perhaps, tracklets.unsteady]).astype(np.int64)
    values, of_thing = np.unique(keys.reshape(-1, 4), axis=0, return_inverse=True)
    of_thing = of_thing.ravel()
    counts: Array = np.zeros((len(weights), len(values)))
    for row in range(len(weights)):
        counts[row] = np.bincount(of_thing, perhaps * np.maximum(weights[row], _MIN_WEIGHT), minlength=len(values))
    durations = _Durations(values[:, 0], values[:, 1], values[:, 2].astype(bool), counts, least_s / gap_s)
    two, both = durations.fit(with_long=False, rows=1), durations.fit(with_long=True)
    found = bool(len(values)) and bool(both.value[0] >= two.value[0] + _SURE)
    fit = both if found else durations.fit(with_long=False)
    lasting = fit.shares[_LONG] if found else np.zeros_like(counts)
    long_s = fit.long * gap_s if found else np.full(len(weights), np.nan)
    lasted_s = (durations.frames - 1) * gap_s
    longer = durations.perhaps & (lasted_s > least_s / MIN_RATIO)
    unsteady = values[:, 3].astype(bool) & (lasted_s >= least_s)
    inflation = durations.inflation(fit)
    return DurationTypes(of_thing, lasting, fit.short * gap_s, long_s, found, longer, unsteady, inflation)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Shares of the kinds in each duration, (3, rows, D); mean lifetimes in frames and log-likelihood, (rows,)."""

    shares: Array
    short: Array
    long: Array
    value: Array


@dataclass(frozen=True, eq=False)
class _Durations:
    """D durations: frames, whether they are cut and may be a vessel's, shape (D,), and how often each is, (rows, D)."""

    frames: Indices
    cut: Indices
    perhaps: Mask
    counts: Array
    least: float

    def fit(self, with_long: bool, rows: int | None = None) -> _Fit:
        """The likeliest mixture of each row, with or without the longer kind."""
        counts = self.counts[:rows]
        amount: Array = np.tile([[0.5], [0.4], [0.1 if with_long else 0.0]], (1, len(counts)))
        middle = max(1 + self.least / (2 * MIN_RATIO), 1.1)
        short, long = np.full(len(counts), middle), np.full(len(counts), 4 * self.least + 2)
        shares, value = np.zeros((3, *counts.shape)), np.zeros(len(counts))
        for _ in range(_STEPS):
            single = np.broadcast_to(np.log(np.where(self.frames == 1, 1.0, 1e-300)), counts.shape)
            lasting = np.where(self.perhaps & with_long, self._log_density(long), -np.inf)
            density = np.stack([single, self._log_density(short), lasting])
            joint = density + np.log(np.maximum(amount, 1e-300))[..., None]
            top = joint.max(axis=0)
            whole = np.exp(joint - top).sum(axis=0)
            shares = np.exp(joint - top) / whole
            value = (counts * (top + np.log(whole))).sum(axis=1)
            weighted = counts * shares
            amount = weighted.sum(axis=2) / np.maximum(counts.sum(axis=1), 1e-12)
            short = np.clip(self._mean(weighted[_SHORT]), 1.05, max(self.least / MIN_RATIO, 1.1))
            long = np.maximum(self._mean(weighted[_LONG]), np.maximum(self.least, MIN_RATIO * short))
        return _Fit(shares, short, long, value)

    def inflation(self, fit: _Fit) -> float:
        """Inflation, see `DurationTypes`: 1 + share · 2 Σ q^k over k > 0, q the chance to be in the next frame."""
        seen = self.counts[0] * self.frames
        stays, flickers = (float((seen * fit.shares[kinds, 0]).sum()) for kinds in (_SHORT, slice(_SINGLE, _LONG)))
        return 1 + 2 * max(float(fit.short[0]) - 1, 0.0) * stays / max(flickers, 1e-12)

    def _log_density(self, mean: Array) -> Array:
        """Log-probability of each duration with a mean number of frames (rows,), shape (rows, D)."""
        end = 1 / np.maximum(mean, 1.0)[:, None]
        return np.multiply(self.frames - 1, np.log(np.maximum(1 - end, 1e-12))) + (1 - self.cut) * np.log(end)

    def _mean(self, weights: Array) -> Array:
        """Mean number of frames: all frames after which each could have ended over all ends, (rows,)."""
        ends = (weights * (1 - self.cut)).sum(axis=1)
        trials = np.subtract(self.frames, self.cut, dtype=np.float64)
        return np.asarray((weights * trials).sum(axis=1) / np.maximum(ends, 0.5))
