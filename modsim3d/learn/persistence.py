"""Persistence of misses and box errors of a thing, from frame to frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import optimize, special

from modsim3d.core.arrays import Array, Indices
from modsim3d.formats.labelled import Images, LabelledSet
from modsim3d.learn.bootstrap import SIGNIFICANT, Column, Kind, Resampling, from_scale, to_scale, widened

# ---- Noise of which each thing keeps a share for as long as it is seen ----

THINGS_NEEDED = 20
"""Things that a share which each of them keeps is learned from."""
_GRID, _BINS = 64, 256
_LARGEST = 0.99
_LONG = 3.0
"""Correlation times that the longest times between last, so that a share is told from a long memory."""

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
        """Pairs of annotations (n,) of things with identities in frames with times, neighbours first. Residuals are
        from a mean of each group, shape (n,), and from so many other numbers that were `fitted`."""
        image, identity = labelled.annotations.image[rows], labelled.annotations.identity[rows]
        time_s, sequence = labelled.images.time_s[image], labelled.images.sequence[image]
        known = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
        _, series = np.unique(np.column_stack([sequence, identity])[known], axis=0, return_inverse=True)
        order = np.lexsort((time_s[known], series.ravel()))
        place, series = known[order], series.ravel()[order]
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
        joined = [np.concatenate(each) for each in zip(*columns, strict=True)] or [np.empty(0)] * 6
        products, same, apart_s, lag, thing, images = joined
        cells, ours = np.unique(np.column_stack([group[place], series]), axis=0, return_counts=True)
        whole = np.bincount(cells[:, 0], ours)[cells[:, 0]]
        crowding = min(float((ours**2 / whole).sum()) / max(len(place), 1) + fitted / max(len(count), 1), 0.9)
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
        each = np.stack(
            [np.bincount(cell, column, minlength=shape[0] * shape[1]) for column in (self.products, self.same)], axis=-1
        ).reshape(*shape, 2)
        return _ratios(each.sum(axis=0) - each)

    @cached_property
    def weight(self) -> Array:
        """Number of things that have each lag, as equal ones, shape (b,)."""
        whole = np.bincount(self.lag, self.same, len(self.lag_s)).astype(np.float64)
        by_thing = np.bincount(self.thing * len(self.lag_s) + self.lag, self.same, minlength=self.things * len(whole))
        weight: Array = whole**2 / np.maximum((by_thing.reshape(self.things, -1) ** 2).sum(axis=0), 1e-300)
        return weight

    def uncrowded(self, ratios: Array) -> Array:
        """Ratios (rows, b) to which what the mean of all sightings took of them is added. It took its part of the level
        at which they stay, which is that of the longest third of the lags."""
        late = slice(-max(len(self.lag_s) // 3, 1), None)
        level = np.clip(np.average(ratios[:, late], axis=1, weights=self.weight[late]), 0, _LARGEST)
        taken = (self.crowding * level / (1 - self.crowding * (1 - level)))[:, None]
        return ratios * (1 - taken) + taken

    def _fits(self, found: Array) -> Fits:
        """Least squares over the lags, weighed by how many things have each; ratios have shape (rows, b)."""
        whole, weight = np.bincount(self.lag, self.same, len(self.lag_s)).astype(np.float64), self.weight
        grid = np.geomspace(0.2 * self.lag_s[0], max(self.lag_s[-1] / _LONG, self.lag_s[0]), _GRID)
        kept = self._kept(grid, whole)
        lost = 1 - kept
        level = (found @ (weight * lost).T - (weight * lost * kept).sum(axis=1)) / (weight * lost**2).sum(axis=1)
        level = np.clip(level, 0, _LARGEST)
        residual = found[:, None] - kept - level[..., None] * lost
        misfit = (weight * residual**2).sum(axis=-1)
        best = misfit.argmin(axis=1)
        rows, inner = np.arange(len(found)), np.clip(best, 1, _GRID - 2)
        below, here, above = (misfit[rows, inner + k] for k in (-1, 0, 1))
        bend = below - 2 * here + above
        move = np.where(bend > 0, np.clip((below - above) / np.where(bend > 0, 2 * bend, 1), -1, 1), 0)
        move = np.where(inner == best, move, best - inner)
        times = np.exp(np.interp(inner + move, np.arange(_GRID), np.log(grid)))
        side = np.where(move < 0, inner - 1, inner + 1)
        level = level[rows, inner] + np.abs(move) * (level[rows, side] - level[rows, inner])
        # The mean of all sightings takes its part of what things keep.
        return Fits(times, level / (1 - self.crowding * (1 - level)))

    def _kept(self, times_s: Array, whole: Array) -> Array:
        """Mean of e^(−Δt/τ) over the pairs of each lag, some of which have sightings lacking between; shape (g, b)."""
        log_s = np.log(np.maximum(self.apart_s, 1e-9))
        edges = np.linspace(log_s.min(), log_s.max() + 1e-9, _BINS + 1)
        cell = self.lag * _BINS + np.clip(np.searchsorted(edges, log_s, side="right") - 1, 0, _BINS - 1)
        size = len(whole) * _BINS
        weight, time_s = np.bincount(cell, self.same, size), np.bincount(cell, self.same * self.apart_s, size)
        decays = np.exp(-(time_s / np.maximum(weight, 1e-300)) / times_s[:, None]) * weight
        kept: Array = decays.reshape(len(times_s), len(whole), _BINS).sum(axis=2) / np.maximum(whole, 1e-300)
        return kept


def _ratios(sums: Array) -> Array:
    return sums[..., 0] / np.where(sums[..., 1] > 0, sums[..., 1], np.inf)


@dataclass(frozen=True, eq=False)
class Fits:
    """Correlation times in seconds, and shares of the variance of residuals that things keep; shapes (rows,)."""

    times_s: Array
    levels: Array


@dataclass(frozen=True, eq=False)
class LearnedVesselNoise:
    """Columns of a correlation time and of the share of the latent noise that things keep, and the share's level.
    `level` is the correlation of residuals that stays for ever."""

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
    """Why no share that things keep is learned; empty if one is."""
    if table.things < THINGS_NEEDED:
        return f"had {table.things} things with times and identities, needs {THINGS_NEEDED}"
    if len(table.lag_s) < 2 * _LONG or not np.any(table.same > 0):
        return "nothing is seen often enough"
    level = table.fit(Resampling(np.ones((1, int(table.image.max()) + 1)), np.zeros(0, dtype=np.int64))).levels[0]
    errors = level / max(float(jackknife(table.without_each().levels)), 1e-12)
    if errors < SIGNIFICANT:
        return f"{errors:.1f} standard errors from 0 with {table.things} things, needs {SIGNIFICANT}"
    return ""


def jackknife(left_out: Array) -> Array:
    """Standard errors (...) from values without each of several things, shape (v, ...)."""
    count = len(left_out)
    errors: Array = np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    return errors


def _lags(longest: int) -> list[int]:
    """1, 2, 3, 4, 6, 8, 12, 16, ... sightings apart, where things are seen so often."""
    lags = {1} | {scale * 2**power for scale in (2, 3) for power in range(longest.bit_length())}
    return [lag for lag in sorted(lags) if lag < longest]


# ---- The correlation of numbers behind what happens or does not, and how they fade ----

LATENT_SHARES = np.linspace(0, 0.99, 100)
_CHANCES = 50
_TIMES_APART = 4.0
_LONGEST = 3.0
"""Correlation times that the longest times between must last."""
_EXACT = 1e3
"""Weight of the sum of all shares, which is one, against that of the lags."""
GREATEST_SHARE = 0.95


def latent_share(chance: Array) -> Callable[[Array], Array]:
    """Function from the correlation of misses to the share of the latent normal number that things keep. With a share s
    two misses of a chance p have the probability p − 2·T(z, √((1 − s)/(1 + s))), with z the normal number of p and T
    the function of Owen (1956), "Tables for computing bivariate normal probabilities"."""
    level = level_of(chance)
    return lambda found: np.interp(found, level, LATENT_SHARES)


def level_of(chance: Array) -> Array:
    """Correlation of misses for each of `LATENT_SHARES`, shape (100,)."""
    varied = chance[(chance > 0) & (chance < 1)]
    p = np.quantile(varied, (np.arange(_CHANCES) + 0.5) / _CHANCES)[:, None]
    level: Array = (both_missed(p) - p**2).sum(axis=0) / (p - p**2).sum()
    return level


def both_missed(p: Array) -> Array:
    """Probability that two misses of a chance (n, 1) happen together, for each of `LATENT_SHARES`, shape (n, 100)."""
    both: Array = p - 2 * special.owens_t(special.ndtri(p), np.sqrt((1 - LATENT_SHARES) / (1 + LATENT_SHARES)))
    return both


def memory_shares(table: LagTable, latent: Callable[[Array], Array], resampling: Resampling) -> tuple[Array, Column]:
    """Times of the autoregressive parts (parts,), and the share that things keep, then those of the parts.

    `latent` turns the correlation of residuals into that of the numbers behind them. Replicates spread at least as when
    single things are left out.
    """
    first = float(table.lag_s[0])
    parts = 1 + int(np.log(max(table.lag_s[-1] / _LONGEST / first, 1.0)) / np.log(_TIMES_APART))
    times_s = first * np.array([_TIMES_APART**part for part in range(parts)])
    found, without = (
        _shares(table, latent(table.uncrowded(ratios)), times_s)
        for ratios in (table.ratios(resampling), table.ratios_without_each())
    )
    values = widened(found, jackknife(without))
    return times_s, Column(values, "capped", np.full(values.shape[1:], float(table.things)))


def replace_values(column: Column, values: Array) -> Column:
    """A column with some of its values; they rest on as much."""
    return Column(values, column.kind, np.broadcast_to(column.counts.flat[0], values.shape[1:]))


def in_seconds(times_s: Array) -> tuple[str, ...]:
    """Names of parts by their correlation times (parts,)."""
    return tuple(f"{time_s:.3g} s" for time_s in times_s)


def _shares(table: LagTable, correlation: Array, times_s: Array) -> Array:
    """Shares that are kept, then those of each time, from correlations of scores (rows, b), shape (rows, 1 + parts).

    The rest of the variance is white noise, so all shares sum to one.
    """
    decays = np.exp(-table.lag_s[:, None] / times_s)
    design = np.column_stack([np.ones(len(decays)), decays, np.zeros(len(decays))])
    weight = np.sqrt(table.weight / table.weight.max())[:, None]
    system = np.vstack([weight * design, np.full((1, design.shape[1]), _EXACT)])
    found = [optimize.nnls(system, np.append(weight[:, 0] * row, _EXACT))[0][:-1] for row in correlation]
    shares = np.stack(found)
    over = np.maximum(shares.sum(axis=1), 1.0)[:, None]
    shares = shares / over
    shares[:, 0] = np.minimum(shares[:, 0], GREATEST_SHARE)
    result: Array = shares
    return result


# ---- Correlation in time that is lost to the mean of few sightings ----


@dataclass(frozen=True, eq=False)
class SightingStretches:
    """The sightings of each thing in each state: how many, the mean time between them, and the state; shapes (s,)."""

    count: Array
    apart_s: Array
    state: Indices

    def correlation_left(self, times_s: Array) -> Array:
        """Correlation of consecutive deviations from the mean, over that of the noise itself, for times τ, shape (m,).
        The mean of a state is that of all its sightings. With ρ_ij = e^(−|t_i − t_j|/τ) within a thing, C_i the
        correlation of sighting i with the mean and V the variance of the mean, consecutive deviations have the expected
        product ρ_ij − C_i − C_j + V and squares have 1 − 2·C_i + V: for one thing this is the bias of Kendall (1954),
        "Note on bias in the estimation of autocorrelation". Sightings are taken as evenly spaced."""
        several = self.count > 1
        if not several.any():
            return np.ones(len(times_s))
        count, state, apart_s = self.count[several], self.state[several], self.apart_s[several]
        of_state = np.bincount(self.state, self.count)
        once = np.bincount(self.state, self.count * ~several, minlength=len(of_state))
        rho = np.exp(-apart_s / times_s[:, None])
        lost, lost_over_all = np.maximum(1 - rho, 1e-300), 1 - rho**count
        # Sums of ρ_ij over the sightings of each thing and of each state; V is the mean of the latter.
        sums = count * (1 + rho) / lost - 2 * rho * lost_over_all / lost**2
        sums_of_state = np.stack([np.bincount(state, row, minlength=len(of_state)) for row in sums]) + once
        of_mean: Array = sums_of_state / np.maximum(of_state, 1) ** 2
        # Sum of (C_i + C_j) / 2 over the consecutive pairs of a thing: of all its sightings, but for one at the end.
        pairs, sightings = count - 1, of_state[state]
        with_mean = sums / sightings - lost_over_all / lost / sightings
        products = (pairs * rho - 2 * with_mean + pairs * of_mean[:, state]).sum(axis=1)
        squares = (pairs - 2 * with_mean + pairs * of_mean[:, state]).sum(axis=1)
        left: Array = products / squares * pairs.sum() / (pairs * rho).sum(axis=1)
        return left


def stretches_of(labelled: LabelledSet, rows: Indices, state: Indices) -> SightingStretches:
    """Stretches of annotations (n,) of things with identities in frames with times, given their states (n,)."""
    annotations = labelled.annotations
    return stretches_of_things(labelled.images, annotations.image[rows], annotations.identity[rows], state)


def stretches_of_things(images: Images, image: Indices, identity: Indices, state: Indices) -> SightingStretches:
    """Stretches of sightings, from their images, identities, −1 where unknown, and states, shapes (n,)."""
    time_s, sequence = images.time_s[image], images.sequence[image]
    known = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
    keys = np.column_stack([sequence, identity, state])[known]
    each, first, place = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    count = np.bincount(place.ravel()).astype(np.float64)
    low, high = np.full(len(each), np.inf), np.full(len(each), -np.inf)
    np.minimum.at(low, place.ravel(), time_s[known])
    np.maximum.at(high, place.ravel(), time_s[known])
    return SightingStretches(count, (high - low) / np.maximum(count - 1, 1), state[known][first])


LEVEL = 0.999
"""Level of the interval of a correlation that decides whether noise persists."""
_TIME_GRID = 96
_UNKNOWN = 50.0
"""Relative error of a correlation time that the frames do not bound from above."""
_ONCE = Resampling(np.ones((1, 1)), np.zeros(1, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Steps:
    """Consecutive sightings of the same thing: their places among the rows given and the time between, shapes (m,)."""

    earlier: Indices
    later: Indices
    apart_s: Array

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.earlier)


@dataclass(frozen=True)
class Correlation:
    """The interval of the correlation between one sighting and the next, from so many pairs of sightings."""

    low: float
    high: float
    pairs: int

    @property
    def persists(self) -> bool:
        """Whether noise surely persists."""
        return self.low > 0

    @property
    def doubt(self) -> str:
        """Why noise is not said to persist."""
        where = "lies below 0, and only noise that persists is simulated" if self.high < 0 else "includes 0"
        pairs = "1 consecutive pair" if self.pairs == 1 else f"{self.pairs:,} consecutive pairs"
        return f"the {LEVEL:.1%} interval of the correlation in {pairs}, {self.low:.2f} to {self.high:.2f}, {where}"


@dataclass(frozen=True, eq=False)
class Consecutive:
    """Products of the residuals of consecutive sightings."""

    products: Array  # of the earlier and the later residual, shape (m,)
    expected: Array  # their expectation if the noise were the same in both, shape (m,)
    apart_s: Array  # time between the two, shape (m,)
    image: Indices  # image of the later one, shape (m,)
    stretches: SightingStretches | None = None  # sightings whose mean was taken off, if few enough to matter

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.products)

    def correlation(self) -> Correlation:
        """The correlation with its interval. Products of noise that does not persist are independent with mean 0, and
        their squares say how far the correlation strays from 0. A correlation ρ above 0 strays further: its variance is
        larger by that of a share ρ of so many trials as the expected products are worth, of rare misses as many as
        there are. Without it, two misses among a thousand finds, which are hardly ever neighbours, would seem to show
        that misses do not persist."""
        whole, pairs = float(self.expected.sum()), len(self)
        if whole <= 0:
            return Correlation(-1.0, 1.0, pairs)
        errors = float(special.ndtri((1 + LEVEL) / 2))
        middle = float(self.products.sum()) / whole
        reach = errors * float(np.sqrt((self.products**2).sum())) / whole
        a_trial = errors**2 * float((self.expected**2).sum()) / whole**2
        # The largest ρ ≥ 0 with (ρ − middle)² ≤ reach² + a_trial·ρ·(1 − ρ).
        half = (middle + a_trial / 2) / (1 + a_trial)
        root = half**2 - (middle**2 - reach**2) / (1 + a_trial)
        high = max(middle + reach, half + np.sqrt(root) if root >= 0 else -1.0)
        return Correlation(max(middle - reach, -1.0), min(high, 1.0), pairs)

    def rough_time_s(self) -> float:
        """The correlation time, without replicates."""
        once = replace(self, image=np.zeros_like(self.image))
        return float(once.times_s(_ONCE)[0])

    def column(self, resampling: Resampling) -> Column:
        """The correlation time; its replicates spread at least as pairs say, since runs of frames may be few."""
        times = self.times_s(resampling)
        if times[0] > 0:
            least = np.array(self.relative_error(float(times[0])))
            times = np.exp(widened(np.log(np.maximum(times, 1e-12)), least))
        return Column(times, "positive", np.array(float(len(self))))

    def times_s(self, resampling: Resampling) -> Array:
        """Correlation times τ for which the products sum to the expected ones times e^(−Δt/τ), shape (rows,). They are
        0 where there is no correlation, and at most a thousand times the median Δt."""
        gap = float(np.median(self.apart_s))
        grid = gap * np.geomspace(0.05, 1000, _TIME_GRID)
        left = np.ones(_TIME_GRID) if self.stretches is None else self.stretches.correlation_left(grid)
        products = resampling.sums(self.image, self.products)
        curve = self._decayed(resampling, gap, grid) * left
        curve, result = np.maximum.accumulate(curve, axis=1), np.zeros(len(products))
        for row in np.flatnonzero(products > 0):
            result[row] = np.exp(np.interp(products[row], curve[row], np.log(grid)))
        return result

    def _decayed(self, resampling: Resampling, gap_s: float, grid_s: Array) -> Array:
        """Sums of the expected products times e^(−Δt/τ), shape (rows, g), given the median Δt and some τ (g,)."""
        apart, kind = np.unique(np.round(self.apart_s / gap_s, 6), return_inverse=True)
        if len(apart) > _TIME_GRID:  # frames at any times
            return resampling.sums(self.image, self.expected[:, None] * np.exp(-self.apart_s[:, None] / grid_s))
        of_kind = resampling.counts(self.image, kind.ravel(), (len(apart),), self.expected)
        return of_kind @ np.exp(-gap_s * apart[:, None] / grid_s)

    def relative_error(self, time_s: float) -> float:
        """Relative standard error of a correlation time τ, from the deviation of each pair's product. Given the earlier
        residual, a product is expected to be e^(−Δt/τ) times the residual's square. Deviations from that are
        independent of each other whatever persists, and there are many more pairs than runs of frames."""
        near = time_s * np.array([0.99, 1.0, 1.01])
        left = np.ones(3) if self.stretches is None else self.stretches.correlation_left(near)
        below, now, above = (self.expected * np.exp(-self.apart_s / t) * k for t, k in zip(near, left, strict=True))
        growth = float((above - below).sum() / np.log(near[2] / near[0]))
        stray = float(np.sqrt(((self.products - now) ** 2).sum()))
        return min(stray / max(growth, 1e-12), _UNKNOWN)


def steps_between(labelled: LabelledSet, rows: Indices) -> Steps:
    """Consecutive ones of some annotations, shape (n,), of things with identities in frames with times."""
    return steps_of(labelled.images, labelled.annotations.image[rows], labelled.annotations.identity[rows])


def steps_of(images: Images, image: Indices, identity: Indices) -> Steps:
    """Consecutive sightings of the same thing, from their images and identities, −1 where unknown, shapes (n,)."""
    sequence, time_s = images.sequence[image], images.time_s[image]
    known = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
    order = known[np.lexsort((time_s[known], identity[known], sequence[known]))]
    earlier, later = order[:-1], order[1:]
    apart_s = time_s[later] - time_s[earlier]
    same = (identity[earlier] == identity[later]) & (sequence[earlier] == sequence[later]) & (apart_s > 0)
    return Steps(earlier[same], later[same], apart_s[same])


def why_no_steps(labelled: LabelledSet) -> str:
    """Why no annotation follows another of the same thing."""
    if not np.isfinite(labelled.images.time_s).any():
        return "frames have no times"
    if not np.any(labelled.annotations.identity >= 0):
        return "annotations have no identities"
    return "nothing is annotated in two frames with times"


def frame_interval_s(labelled: LabelledSet) -> float:
    """Median time between consecutive frames; NaN where there are none."""
    order = np.lexsort((labelled.images.time_s, labelled.images.sequence))
    gaps = np.diff(labelled.images.time_s[order])
    same = np.diff(labelled.images.sequence[order]) == 0
    gaps = gaps[same & np.isfinite(gaps) & (gaps > 0)]
    return float(np.median(gaps)) if len(gaps) else float("nan")


def inflation(steps: Steps, count: int, correlation_s: float) -> float:
    """Variance of the mean of so many numbers with a correlation time, over that of independent ones. The steps are in
    order of time within each track."""
    if correlation_s <= 0 or count == 0:
        return 1.0
    kept, held, total = np.exp(-steps.apart_s / correlation_s).tolist(), dict[int, float](), 0.0
    for earlier, later, share in zip(steps.earlier.tolist(), steps.later.tolist(), kept, strict=True):
        held[later] = share * (held.get(earlier, 0.0) + 1)
        total += held[later]
    return 1 + 2 * total / count
