"""Lifetime of false positives that stay, and their share of all.
One that stays is seen again, near its place, in later frames. So of all pairs of false positives in frames a time Δ
apart more lie near each other than by chance: share · min(m, m′) · e^(−Δ/τ) pairs for two frames whose mean numbers of
false positives are m and m′, since one fades where the rate falls. How many do by chance is seen far apart in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.learn.bootstrap import Column, Resampling, widened
from modsim3d.learn.matches import FalseSightings, Outcomes
from modsim3d.learn.persistence import LEVEL
from modsim3d.learn.persistent_pairs import Displacements, Lag, OrderedFrames, far_pairs, lags_of

# ---- How fast false positives that stay drift along the horizon ----

MIN_TRACKS = 5  # false positives seen in frames on end that a speed needs
_MIN_SEEN = 4
_MIN_ERROR = 0.005
_MAX_TIMES = 9.0
_ROBUST = float(np.pi / 2)  # variance of a median of normal numbers over that of their mean


@dataclass(frozen=True, eq=False)
class DriftSpeeds:
    """Speeds of the s false positives that were seen in at least four frames on end."""

    image: Indices  # image in which each was first seen, shape (s,)
    square: Array  # squared speed along the horizon less its error, px²/s², shape (s,)
    weight: Array  # in how many frames it was seen, less where its speed is not known well, shape (s,)

    @classmethod
    def of(cls, sightings: FalseSightings, times_s: Array, next_frame: Lag) -> DriftSpeeds:
        """From links between consecutive frames; `times_s` are the times of all images."""
        track = _tracks(len(sightings), next_frame)
        rows = np.flatnonzero(sightings.whole & (track >= 0))  # the edge moves the centre of what it cuts
        rows = rows[np.argsort(track[rows], kind="stable")]
        drifts: list[tuple[int, float, float, int]] = []
        for group in np.split(rows, np.flatnonzero(np.diff(track[rows])) + 1):
            if len(group) < _MIN_SEEN:
                continue
            time_s, along = times_s[sightings.image[group]], sightings.along_px[group]
            half = len(group) // 2
            speeds = (along[half:] - along[:-half]) / (time_s[half:] - time_s[:-half])
            stray = _ROBUST * float(speeds.var(ddof=1)) / len(speeds)
            drifts.append((int(sightings.image[group[0]]), float(np.median(speeds)) ** 2, stray, len(group)))
        if not drifts:
            return cls(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        image, square, error, frames = map(np.array, zip(*drifts, strict=True))
        # Two that passed close by each other may have been linked: too fast, or of no one speed.
        middle = float(np.median(square))
        usual = square <= _MAX_TIMES * middle
        weight = frames / (1 + _MAX_TIMES * error / max(middle, 1e-12))
        return cls(image[usual], (square - error)[usual], weight[usual])

    @cached_property
    def rough_px_s(self) -> float:
        """The root of the mean square; 0 where that is not above 0, or none was seen for long enough."""
        return float(np.sqrt(max(self._mean_square, 0.0)))

    @property
    def sure(self) -> bool:
        """Whether the speed is surely above 0: the interval of the mean square says so."""
        count = len(self.weight)
        if count < MIN_TRACKS:
            return False
        stray = self.weight * (self.square - self._mean_square)
        error = float(np.sqrt((stray**2).sum() * count / (count - 1)) / self.weight.sum())
        return self._mean_square > float(special.stdtrit(count - 1, (1 + LEVEL) / 2)) * error

    @property
    def _mean_square(self) -> float:
        return float((self.weight * self.square).sum() / self.weight.sum()) if len(self.weight) else 0.0

    def column(self, resampling: Resampling) -> Column:
        """The root of the mean square speed."""
        sums = resampling.sums(self.image, np.column_stack([self.weight * self.square, self.weight]))
        values = np.sqrt(np.maximum(sums[:, 0] / np.maximum(sums[:, 1], 1e-9), 1e-12))
        return Column(widened(values, values[0] * _MIN_ERROR), "positive", np.array(float(len(self.weight))))


def _tracks(count: int, lag: Lag) -> Indices:
    """The number of the track of each of so many sightings, linked from frame to frame; −1 for one alone, (n,)."""
    moves = lag.moves
    close = np.flatnonzero(moves.near(0.0))
    order = close[np.argsort(moves.along_px[close] / moves.near_px[close], kind="stable")]
    track, follows = np.full(count, -1, dtype=np.int64), np.full(count, -1, dtype=np.int64)
    taken = np.zeros(count, dtype=bool)
    for first, second in lag.rows[:, order].T.tolist():
        if follows[first] < 0 and not taken[second]:
            follows[first], taken[second] = second, True
    for start in np.flatnonzero((follows >= 0) & ~taken).tolist():
        at = start
        while at >= 0:
            track[at] = start
            at = int(follows[at])
    return track


_LIFETIMES = 2.5
_FIRST_LAGS = 4
_NEWTON_STEPS = 15
_GRID = 81
_ONE_IN = 2000.0


@dataclass(frozen=True, eq=False)
class CountedPairs:
    """Pairs of false positives that lie near each other, at K lags, by the earlier of both images."""

    apart_s: Array  # time of each lag, shape (K,)
    found: Array  # near pairs in each image at each lag, shape (I, K)
    chance: Array  # how many would lie near each other by chance, shape (I, K)
    pairs: Array  # pairs of false positives, near or not, shape (I, K)
    seen_twice: Array  # how many would lie near each other if all stayed for ever, shape (I, K)
    false: Array  # false positives in each image, shape (I,)
    expected: Array  # their mean number, shape (I,)

    def some(self, most_s: float) -> CountedPairs:
        """The lags up to a time, and the first few in any case."""
        kept = (self.apart_s <= most_s) | (np.arange(len(self.apart_s)) < _FIRST_LAGS)
        of_lags = (self.found, self.chance, self.pairs, self.seen_twice)
        counts, chance, pairs, seen_twice = (table[:, kept] for table in of_lags)
        return CountedPairs(self.apart_s[kept], counts, chance, pairs, seen_twice, self.false, self.expected)

    def beyond_chance(self, far: Displacements) -> bool:
        """Whether so many pairs in neighbouring frames come by chance once in two thousand sets at most. If none stays,
        they are a binomial number of all near ones (Przyborowski and Wilenski (1940), "Homogeneity of results in
        testing samples from Poisson series")."""
        count, near = float(self.found[:, 0].sum()), float(far.near(0.0).sum())
        pairs = float(self.pairs[:, 0].sum())
        if count == 0 or not len(far.alike):
            return False
        return bool(special.betainc(count, near + 1, pairs / (pairs + len(far.alike))) < 1 / _ONE_IN)

    def fit(self, weights: Array, lifetimes_s: Array) -> tuple[Array, Array]:
        """Lifetime and share of weighted images (rows, I), out of some lifetimes; shapes (rows,)."""
        counts, chance, twice = (weights @ table for table in (self.found, self.chance, self.seen_twice))
        scale = (weights @ self.false) / np.maximum(weights @ self.expected, 1e-9)
        kept = np.exp(-self.apart_s / lifetimes_s[:, None])
        best, share = np.empty(len(counts)), np.empty(len(counts))
        for row in range(len(counts)):
            signal = scale[row] * twice[row] * kept
            likelihood, shares = _shares(counts[row], chance[row], signal)
            best[row] = np.exp(_peak(np.log(lifetimes_s), likelihood, int(np.argmax(likelihood))))
            share[row] = np.interp(np.log(best[row]), np.log(lifetimes_s), shares)
        return best, share


def _shares(counts: Array, chance: Array, signal: Array) -> tuple[Array, Array]:
    """Log-likelihood of Poisson numbers (K,) of means chance + share · signal (G, K), and best share, (G,)."""
    whole = np.maximum(signal.sum(axis=1), 1e-12)
    share = np.clip((counts - chance).sum() / whole, 0.01, 2.0)
    for _ in range(_NEWTON_STEPS):
        mean = np.maximum(chance + share[:, None] * signal, 1e-12)
        slope = (counts * signal / mean).sum(axis=1) - whole
        bend = np.maximum((counts * (signal / mean) ** 2).sum(axis=1), 1e-12)
        share = np.clip(share + slope / bend, share / 4, np.minimum(share * 4, 5.0))
    mean = np.maximum(chance + share[:, None] * signal, 1e-12)
    return (counts * np.log(mean) - mean).sum(axis=1), share


def _peak(places: Array, values: Array, top: int) -> float:
    """Place of the peak of a parabola through the largest value and its neighbours."""
    if not 0 < top < len(values) - 1:
        return float(places[top])
    left, middle, right = values[top - 1 : top + 2]
    bend = left - 2 * middle + right
    shift = 0.0 if bend >= 0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
    return float(places[top] + shift * (places[top + 1] - places[top]))


@dataclass(frozen=True, eq=False)
class LifetimeFit:
    """False positives that stay: their lifetime, the share of all that does, and the speed at which they drift."""

    counted: CountedPairs  # at lags up to a few lifetimes
    drift: DriftSpeeds
    lifetime_s: float
    share: float
    frame_s: float  # time between frames
    frames: int  # how many of them the longest sequence has

    @cached_property
    def inflation(self) -> float:
        """Factor by which it raises the variance of the number of false positives in many frames."""
        return 1 + self.share * self._repeats

    @property
    def drifts(self) -> bool:
        """Whether they surely move, and at least a pixel in a lifetime."""
        return self.drift.sure and self.drift.rough_px_s * self.lifetime_s >= 1

    @property
    def worth(self) -> tuple[float, float]:
        """The inflation, and how many false positives are seen of each different one."""
        false = float(self.counted.false.sum())
        return self.inflation, false / (self.tracks + (1 - self.share) * false)

    @property
    def _repeats(self) -> float:
        later = np.arange(1, max(self.frames, 2))
        return 2 * float(((1 - later / self.frames) * np.exp(-later * self.frame_s / self.lifetime_s)).sum())

    @property
    def tracks(self) -> float:
        """Expected number of different ones that stay, of all that are seen."""
        false, ends = float(self.counted.false.sum()), -float(np.expm1(-self.frame_s / self.lifetime_s))
        return max(self.share * false * min(ends + 1 / self.frames, 1.0), 1.0)

    def columns(self, resampling: Resampling) -> tuple[Column, Column]:
        """Lifetime and share."""
        life, share = self.counted.fit(resampling.weights, self.lifetime_s * np.exp(np.linspace(-1.6, 1.6, _GRID)))
        life = np.exp(widened(np.log(life), np.array(1 / np.sqrt(self.tracks))))
        share = np.minimum(share, np.where(np.arange(len(share)) == 0, 1.0, np.inf))
        stays, goes = share[0], 1 - share[0]
        least = np.sqrt((stays * goes**2 * (1 + self._repeats) + stays**2 * goes) / max(self.counted.false.sum(), 1.0))
        count = np.array(float(self.counted.false.sum()))
        return Column(life, "positive", count), Column(widened(share, least), "capped", count)


@dataclass(frozen=True)
class NoLifetime:
    """Reason why no persistence of false positives is learned."""

    why: str


def find_lifetime(observed: Outcomes, expected: Array, known: bool = False) -> LifetimeFit | NoLifetime:
    """Persistent false positives, given mean numbers in images (I,); if `known` to stay, pairs may be as by chance."""
    sightings = observed.false_sightings
    ordered = OrderedFrames.of(observed)
    if ordered is None:
        return NoLifetime("frames have no times" if not np.isfinite(observed.labelled.images.time_s).any() else _NONE)
    if not len(sightings):
        return NoLifetime("there are no false positives")
    lags = list(lags_of(ordered, sightings, ordered.span_s / 2))
    if not lags:
        return NoLifetime(_NONE)
    far = far_pairs(observed, ordered, sightings)
    at_rest = _count(observed, expected, lags, far, 0.0)
    if not known and not at_rest.beyond_chance(far):
        near = f"{at_rest.found[:, 0].sum():,.0f} false positives have another near their place in the next frame"
        return NoLifetime(f"{near}, and {at_rest.chance[:, 0].sum():,.3g} would by chance")
    drift = DriftSpeeds.of(sightings, observed.labelled.images.time_s, lags[0])
    counted = _count(observed, expected, lags, far, drift.rough_px_s)
    grid = np.geomspace(0.3 * ordered.gap_s, 10 * ordered.span_s, _GRID)
    every = np.ones((1, len(counted.false)))
    most_s = np.inf
    for _ in range(3):
        used = counted.some(most_s)
        life, share = used.fit(every, grid)
        most_s = _LIFETIMES * float(life[0])
    frames = round(ordered.span_s / ordered.gap_s) + 1
    return LifetimeFit(used, drift, float(life[0]), min(float(share[0]), 1.0), ordered.gap_s, frames)


_NONE = "no two frames of a sequence have times"


def _count(observed: Outcomes, expected: Array, lags: Sequence[Lag], far: Displacements, px_s: float) -> CountedPairs:
    """Count near pairs of false positives that drift at a speed."""
    sightings, images = observed.false_sightings, len(observed.labelled.images)
    false = np.bincount(sightings.image, minlength=images).astype(float)
    counts, chance, pairs, twice = (np.zeros((images, len(lags))) for _ in range(4))
    for k, lag in enumerate(lags):
        way = px_s * lag.apart_s
        near = lag.moves.near(way)
        by_chance = float(far.near(way).mean()) if len(far.alike) else 0.0
        first, second = lag.frames
        counts[:, k] = np.bincount(sightings.image[lag.rows[0, near]], minlength=images)
        np.add.at(pairs[:, k], first, false[first] * false[second])
        chance[:, k] = by_chance * pairs[:, k]
        np.add.at(twice[:, k], first, np.minimum(expected[first], expected[second]))
    return CountedPairs(np.array([lag.apart_s for lag in lags]), counts, chance, pairs, twice, false, expected)
