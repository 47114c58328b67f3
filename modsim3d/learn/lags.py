"""Memory of noise over all lags: shares that things keep, and shares that fade with several times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import optimize, special

from modsim3d.core.arrays import Array, Indices
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.bootstrap import SIGNIFICANT, Column, Kind, Resampling, from_scale, to_scale, widened

# ---- Noise of which each thing keeps a share for as long as it is seen ----

THINGS_NEEDED = 20  # things that a share which each of them keeps is learned from
_GRID, _BINS = 64, 256
_MAX_LEVEL = 0.99
_LONG = 3.0  # correlation times that the longest times between last, so that a share is told from a long memory

Compare = Callable[[Indices, Indices], tuple[Array, Array]]
"""Products of the residuals of pairs of rows, and what they would be if the noise were the same; shapes (m,)."""


@dataclass(frozen=True, eq=False)
class LagTable:
    """Products of the residuals of pairs of sightings, at so many sightings apart."""

    products: Array  # shape (m,)
    same: Array  # what the products would be if the noise were the same in both, shape (m,)
    apart_s: Array  # time between the two, shape (m,)
    lag: Indices  # which of the lags, shape (m,)
    thing: Indices  # whose sightings, shape (m,)
    image: Indices  # image of the later one, shape (m,)
    lag_s: Array  # usual time between, of each lag, shape (b,)
    things: int
    crowding: float  # part that fitted numbers take of a share that things keep: with a mean of n equal things, 1/n

    @classmethod
    def of(cls, labelled: LabelledSet, rows: Indices, group: Indices, compare: Compare, fitted: int = 0) -> LagTable:
        """Pairs of annotations (n,) of things with identities in frames with times, neighbours first; residuals (n,)
        are from means of groups (n,), and from so many other numbers that were `fitted`."""
        image, identity = labelled.annotations.image[rows], labelled.annotations.identity[rows]
        time_s, sequence = labelled.images.time_s[image], labelled.images.sequence[image]
        sightings = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
        number = sequence[sightings] * (identity.max(initial=0) + 1) + identity[sightings]
        series = np.unique(number, return_inverse=True)[1]
        order = np.lexsort((time_s[sightings], series))
        place, series = sightings[order], series[order]
        count = np.bincount(series)
        columns: list[tuple[Any, ...]] = []
        lag_s: list[float] = []
        for apart in _lags(int(count.max(initial=0))):
            near = np.flatnonzero(series[apart:] == series[:-apart])
            earlier, later = place[near], place[near + apart]
            products, same = compare(earlier, later)
            apart_s = time_s[later] - time_s[earlier]
            columns.append((products, same, apart_s, np.full(len(near), len(lag_s)), series[near], image[later]))
            lag_s.append(float(np.median(apart_s)))
        joined = [np.concatenate(parts) for parts in zip(*columns, strict=True)] or [np.empty(0)] * 6
        products, same, apart_s, lag, thing, images = joined
        cells, sizes = np.unique(np.column_stack([group[place], series]), axis=0, return_counts=True)
        whole = np.bincount(cells[:, 0], sizes)[cells[:, 0]]
        crowding = min(float((sizes**2 / whole).sum()) / max(len(place), 1) + fitted / max(len(count), 1), 0.9)
        indices = lag.astype(np.int64), thing.astype(np.int64), images.astype(np.int64)
        return cls(products, same, apart_s, *indices, np.array(lag_s), len(count), crowding)

    def fit(self, resampling: Resampling) -> Fits:
        """The fit of each row of the resampling."""
        return self._fits(self.ratios(resampling))

    def without_each(self) -> Fits:
        """The fits without each of the things."""
        return self._fits(self.ratios_without_each())

    def ratios(self, resampling: Resampling) -> Array:
        """Sum of the products over that of the same noise at each lag, of each row of the resampling, (rows, b)."""
        both = np.column_stack([self.products, self.same])
        cell = (self.lag[:, None] * 2 + np.arange(2)).ravel()
        return _ratios(resampling.counts(np.repeat(self.image, 2), cell, (len(self.lag_s), 2), both.ravel()))

    def ratios_without_each(self) -> Array:
        """Ratios of that kind without each of the things, shape (things, b)."""
        shape = self.things, len(self.lag_s)
        cell = self.thing * shape[1] + self.lag
        sums = np.stack(
            [np.bincount(cell, column, minlength=shape[0] * shape[1]) for column in (self.products, self.same)], axis=-1
        ).reshape(*shape, 2)
        return _ratios(sums.sum(axis=0) - sums)

    @cached_property
    def weight(self) -> Array:
        """Number of things that have each lag, as equal ones, shape (b,)."""
        whole = np.bincount(self.lag, self.same, len(self.lag_s)).astype(np.float64)
        by_thing = np.bincount(self.thing * len(self.lag_s) + self.lag, self.same, minlength=self.things * len(whole))
        return np.asarray(whole**2 / np.maximum((by_thing.reshape(self.things, -1) ** 2).sum(axis=0), 1e-300))

    def uncrowded(self, ratios: Array) -> Array:
        """Ratios (rows, b) with what the mean of all sightings took: its part of the longest third's level is added."""
        late = slice(-max(len(self.lag_s) // 3, 1), None)
        level = np.clip(np.average(ratios[:, late], axis=1, weights=self.weight[late]), 0, _MAX_LEVEL)
        taken = (self.crowding * level / (1 - self.crowding * (1 - level)))[:, None]
        return ratios * (1 - taken) + taken

    def _fits(self, ratios: Array) -> Fits:
        """Least squares over the lags, weighed by how many things have each; ratios have shape (rows, b)."""
        whole, weight = np.bincount(self.lag, self.same, len(self.lag_s)).astype(np.float64), self.weight
        grid = np.geomspace(0.2 * self.lag_s[0], max(self.lag_s[-1] / _LONG, self.lag_s[0]), _GRID)
        kept = self._decay(grid, whole)
        lost = 1 - kept
        level = (ratios @ (weight * lost).T - (weight * lost * kept).sum(axis=1)) / (weight * lost**2).sum(axis=1)
        level = np.clip(level, 0, _MAX_LEVEL)
        misfit = (weight * (ratios[:, None] - kept - level[..., None] * lost) ** 2).sum(axis=-1)
        best = misfit.argmin(axis=1)
        rows, inner = np.arange(len(ratios)), np.clip(best, 1, _GRID - 2)
        below, here, above = (misfit[rows, inner + k] for k in (-1, 0, 1))
        bend = below - 2 * here + above
        move = np.where(bend > 0, np.clip((below - above) / np.where(bend > 0, 2 * bend, 1), -1, 1), 0)
        move = np.where(inner == best, move, best - inner)
        times = np.exp(np.interp(inner + move, np.arange(_GRID), np.log(grid)))
        side = np.where(move < 0, inner - 1, inner + 1)
        level = level[rows, inner] + np.abs(move) * (level[rows, side] - level[rows, inner])
        # The mean of all sightings takes its part of what things keep.
        return Fits(times, level / (1 - self.crowding * (1 - level)))

    def _decay(self, times_s: Array, whole: Array) -> Array:
        """Mean of e^(−Δt/τ) over the pairs of each lag, some of which have sightings lacking between; shape (g, b)."""
        log_s = np.log(np.maximum(self.apart_s, 1e-9))
        edges = np.linspace(log_s.min(), log_s.max() + 1e-9, _BINS + 1)
        cell = self.lag * _BINS + np.clip(np.searchsorted(edges, log_s, side="right") - 1, 0, _BINS - 1)
        size = len(whole) * _BINS
        weight, time_s = np.bincount(cell, self.same, size), np.bincount(cell, self.same * self.apart_s, size)
        decays = np.exp(-(time_s / np.maximum(weight, 1e-300)) / times_s[:, None]) * weight
        return np.asarray(decays.reshape(len(times_s), len(whole), _BINS).sum(axis=2) / np.maximum(whole, 1e-300))


def _ratios(sums: Array) -> Array:
    return sums[..., 0] / np.where(sums[..., 1] > 0, sums[..., 1], np.inf)


@dataclass(frozen=True, eq=False)
class Fits:
    """Correlation times in seconds, and shares of the variance of residuals that things keep; shapes (rows,)."""

    times_s: Array
    levels: Array


@dataclass(frozen=True, eq=False)
class LearnedVesselNoise:
    """Columns of a correlation time and of the share of latent noise that things keep, and the level of residuals."""

    time_s: Column
    share: Column
    level: float


def vessel_noise(table: LagTable, resampling: Resampling, latent: Callable[[Array], Array]) -> LearnedVesselNoise:
    """The two numbers with replicates, given the share of the latent noise that leaves a level of correlation. They
    spread at least as they do when single things are left out: runs of frames have the same things."""
    fits, without = table.fit(resampling), table.without_each()
    count = np.array(float(table.things))

    def column(values: Array, left_out: Array, kind: Kind) -> Column:
        scaled, least = to_scale(values, kind), jackknife(to_scale(left_out, kind))
        return Column(from_scale(widened(scaled, least), kind), kind, count)

    share = column(latent(fits.levels), latent(without.levels), "fraction")
    return LearnedVesselNoise(column(fits.times_s, without.times_s, "positive"), share, float(fits.levels[0]))


def why_none(table: LagTable) -> str:
    """Reason why no share that things keep is learned; empty if one is."""
    if table.things < THINGS_NEEDED:
        return f"had {table.things:,} things with times and identities, needs {THINGS_NEEDED}"
    if len(table.lag_s) < 2 * _LONG or not np.any(table.same > 0):
        return "nothing is seen often enough"
    level = table.fit(Resampling(np.ones((1, int(table.image.max()) + 1)), np.zeros(0, dtype=np.int64))).levels[0]
    errors = level / max(float(jackknife(table.without_each().levels)), 1e-12)
    if errors < SIGNIFICANT:
        return f"{errors:.1f} standard errors from 0 with {table.things:,} things, needs {SIGNIFICANT}"
    return ""


def jackknife(left_out: Array) -> Array:
    """Standard errors (...) from values without each of several things, shape (v, ...)."""
    count = len(left_out)
    return np.asarray(np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)))


def _lags(longest: int) -> list[int]:
    """1, 2, 3, 4, 6, 8, 12, 16, ... sightings apart, where things are seen so often."""
    lags = {1} | {scale * 2**power for scale in (2, 3) for power in range(longest.bit_length())}
    return [lag for lag in sorted(lags) if lag < longest]


# ---- The correlation of numbers behind what happens or does not, and how they fade ----

LATENT_SHARES = np.linspace(0, 0.99, 100)
_CHANCES = 50
_TIMES_APART = 4.0
_MIN_TIMES = 3.0  # correlation times that the longest times between must last
_EXACT = 1e3  # weight of the sum of all shares, which is one, against that of the lags
MAX_SHARE = 0.95


def latent_share(chance: Array) -> Callable[[Array], Array]:
    """Function from the correlation of misses to the share of the latent normal number that things keep. With a share s
    two misses of a chance p have the probability p − 2·T(z, √((1 − s)/(1 + s))), with z the normal number of p and T
    the function of Owen (1956), "Tables for computing bivariate normal probabilities"."""
    return lambda correlation: np.interp(correlation, level_of(chance), LATENT_SHARES)


def level_of(chance: Array) -> Array:
    """Correlation of misses for each of `LATENT_SHARES`, shape (100,)."""
    p = np.quantile(chance[(chance > 0) & (chance < 1)], (np.arange(_CHANCES) + 0.5) / _CHANCES)[:, None]
    return np.asarray((both_missed(p) - p**2).sum(axis=0) / (p - p**2).sum())


def both_missed(p: Array) -> Array:
    """Probability that two misses of a chance (n, 1) happen together, for each of `LATENT_SHARES`, shape (n, 100)."""
    return np.asarray(p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - LATENT_SHARES) / (1 + LATENT_SHARES))))


def memory_shares(table: LagTable, latent: Callable[[Array], Array], resampling: Resampling) -> tuple[Array, Column]:
    """Times of the autoregressive parts (parts,), and the share that things keep, then those of the parts. `latent`
    turns the correlation of residuals into that of the numbers behind them. Replicates spread at least as when single
    things are left out."""
    first = float(table.lag_s[0])
    parts = 1 + int(np.log(max(table.lag_s[-1] / _MIN_TIMES / first, 1.0)) / np.log(_TIMES_APART))
    times_s = first * np.array([_TIMES_APART**part for part in range(parts)])
    shares, without = (
        _shares(table, latent(table.uncrowded(ratios)), times_s)
        for ratios in (table.ratios(resampling), table.ratios_without_each())
    )
    values = widened(shares, jackknife(without))
    return times_s, Column(values, "capped", np.full(values.shape[1:], float(table.things)))


def replace_values(column: Column, values: Array) -> Column:
    """A column with some of its values; they rest on as much."""
    return Column(values, column.kind, np.broadcast_to(column.counts.flat[0], values.shape[1:]))


def in_seconds(times_s: Array) -> tuple[str, ...]:
    """Names of parts by their correlation times (parts,)."""
    return tuple(f"{time_s:.3g} s" for time_s in times_s)


def _shares(table: LagTable, correlation: Array, times_s: Array) -> Array:
    """Shares kept, then of each time, from correlations of scores (rows, b), (rows, 1 + parts); the rest is white."""
    decays = np.exp(-table.lag_s[:, None] / times_s)
    design = np.column_stack([np.ones(len(decays)), decays, np.zeros(len(decays))])
    weight = np.sqrt(table.weight / table.weight.max())[:, None]
    system = np.vstack([weight * design, np.full((1, design.shape[1]), _EXACT)])
    shares = np.stack([optimize.nnls(system, np.append(weight[:, 0] * row, _EXACT))[0][:-1] for row in correlation])
    shares = np.asarray(shares / np.maximum(shares.sum(axis=1), 1.0)[:, None])
    shares[:, 0] = np.minimum(shares[:, 0], MAX_SHARE)
    return shares
