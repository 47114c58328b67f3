"""Checks of the score behind misses and confidence: how long it is remembered, and what that does to other checks."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.chain import DetectorPart
from modsim3d.detector.persistence import LatentScore
from modsim3d.verify.measures import CORRELATION, Estimate
from modsim3d.verify.parameters import Parameter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
LAGS = (1, 4, 16)  # numbers of frames between the misses whose correlation is tested
MIN_MISSES = 30  # misses, and finds, below which their correlation is not tested
_REPLAYS, _AT_A_TIME = 200, 50


def miss_covariance(first: Array, second: Array, correlation: Array) -> Array:
    """Covariance of misses of chances (m,) whose scores have a correlation from 0 to 1, shape (m,). The derivative of
    the bivariate normal distribution function by the correlation is its density (Plackett (1954), "A reduction formula
    for normal multivariate integrals"), integrated over the arc sine of the correlation."""
    a, b = (special.ndtri(np.clip(chance, 1e-12, 1 - 1e-12)) for chance in (first, second))
    reach = np.arcsin(np.clip(correlation, 0, 1 - 1e-9)) / 2
    total = np.zeros(len(a))
    for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True):
        angle = reach * (1 + node)
        total += weight * np.exp(-(a**2 + b**2 - 2 * a * b * np.sin(angle)) / (2 * np.cos(angle) ** 2))
    return reach * total / (2 * np.pi)


def sum_over_pairs(tracks: Indices, times_s: Array, value: Callable[[Indices, Indices, Array], Array]) -> Array:
    """Sums of values of all pairs of rows of one track, a vessel in a camera, shape (k,). Rows (n, c) of `tracks` are
    equal in one track; times have shape (n,). `value` takes later and earlier rows and the seconds between, shapes
    (m,), to values (m, k). Their mean is taken at some lags: it changes little between them, as memory only fades."""
    order = np.lexsort((times_s, *tracks.T[::-1]))
    _, series = np.unique(tracks[order], axis=0, return_inverse=True)
    series, count = series.ravel(), np.bincount(series.ravel())
    most = int(count.max(initial=1))
    lags, means = [0], [np.zeros(value(order[:1], order[:1], times_s[:1]).shape[1])]
    for lag in sorted({base << power for base in (2, 3) for power in range(most.bit_length())} | {1}):
        near = np.flatnonzero(series[lag:] == series[:-lag]) if lag < most else np.empty(0, dtype=np.int64)
        if len(near):
            later, earlier = order[near + lag], order[near]
            lags.append(lag)
            means.append(value(later, earlier, times_s[later] - times_s[earlier]).mean(axis=0))
    every = np.arange(1, most)
    pairs = np.array([np.maximum(count - lag, 0).sum() for lag in every])
    columns = np.array(means).reshape(len(lags), -1).T
    return np.array([float((pairs * np.interp(every, lags, column)).sum()) for column in columns])


def off_diagonal(tracks: Indices, times_s: Array, score: LatentScore, chance: Array, amount: Array) -> float:
    """Part of the variance of a sum of amounts of misses (n,) that their correlation along tracks makes."""

    def value(later: Indices, earlier: Indices, apart_s: Array) -> Array:
        covariance = miss_covariance(chance[later], chance[earlier], score.correlation(apart_s))
        return (amount[later] * amount[earlier] * covariance)[:, None]

    if len(chance) < 2:
        return 0.0
    sums = sum_over_pairs(tracks, times_s, value)
    return 2 * float(sums.sum())


def memory_checks(tracks: Indices, times_s: Array, score: LatentScore, chance: Array, missed: Array) -> list[Parameter]:
    """Correlation of misses some frames apart; how far it strays comes from simulated scores of the same vessels. Rows
    (n, c) of `tracks` are equal for a vessel in a camera; times, chances of a miss, and misses (1 or 0) are (n,)."""
    if not len(chance):
        return []
    order = np.lexsort((times_s, *tracks.T[::-1]))
    _, series = np.unique(tracks[order], axis=0, return_inverse=True)
    series, times_s, chance = series.ravel(), times_s[order], chance[order]
    spread = chance * (1 - chance)
    pairs = [np.flatnonzero((series[lag:] == series[:-lag]) & (spread[lag:] * spread[:-lag] > 0)) for lag in LAGS]
    rng = np.random.default_rng(len(series))
    draws = (_scores(series, times_s, score, rng, _AT_A_TIME) for _ in range(_REPLAYS // _AT_A_TIME))
    replayed = np.concatenate([_products(scores < chance, chance, pairs) for scores in draws])
    found = _products((missed[order] > 0)[None], chance, pairs)[0]
    parameters = []
    for k, (lag, near) in enumerate(zip(LAGS, pairs, strict=True)):
        later, measure = near + lag, None
        if float(spread[near].sum()) >= MIN_MISSES:
            apart_s, whole = times_s[later] - times_s[near], float(np.sqrt(spread[later] * spread[near]).sum())
            expected = float(miss_covariance(chance[later], chance[near], score.correlation(apart_s)).sum())
            strays, error = replayed[:, k] - replayed[:, k].mean(), float(replayed[:, k].std(ddof=1))
            skewness = float((strays**3).mean()) / error**3 if error > 0 else 0.0
            if error > 0:
                numbers = found[k] / whole, expected / whole, error / whole
                measure = Estimate(*numbers, len(near), skewness, possible=CORRELATION)
        name = f"persistence.score: correlation of misses, {lag} {'frame' if lag == 1 else 'frames'} apart"
        parameters.append(Parameter(name, DetectorPart.CLASS, measure, in_file=False))
    return parameters


def _products(missed: Mask, chance: Array, pairs: Sequence[Indices]) -> Array:
    """Sums of products of residuals of misses (r, n) at each lag, shape (r, lags)."""
    residual = missed - chance
    products = [
        (residual[:, near + lag] * residual[:, near]).sum(axis=1) for lag, near in zip(LAGS, pairs, strict=True)
    ]
    return np.stack(products, axis=1)


def _scores(series: Indices, times_s: Array, score: LatentScore, rng: np.random.Generator, count: int) -> Array:
    """Probabilities of scores of rows in order of series and time, as the detector draws them, shape (count, n)."""
    first = np.diff(series, prepend=-1) > 0
    apart_s = np.where(first, np.inf, np.diff(times_s, prepend=0.0))
    total = np.sqrt(score.vessel_share) * rng.standard_normal((count, int(series.max()) + 1))[:, series]
    total += np.sqrt(score.white_share) * rng.standard_normal(total.shape)
    for share, time_s in zip(score.shares, score.times_s, strict=True):
        decay, part = np.exp(-apart_s / time_s), np.zeros(count)
        for row, kept in enumerate(decay.tolist()):
            part = kept * part + math.sqrt(1 - kept * kept) * rng.standard_normal(count)
            total[:, row] += math.sqrt(share) * part
    return np.asarray(special.ndtr(total))
