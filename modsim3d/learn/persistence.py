"""Persistence of misses and box errors of a thing, from one sighting to the next."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Columns, Indices
from modsim3d.core.text import in_percent, number
from modsim3d.formats.labelled import Images, LabelledSet
from modsim3d.learn.bootstrap import Column, Resampling, widened

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
        return np.asarray(products / squares * pairs.sum() / (pairs * rho).sum(axis=1))


def stretches_of(images: Images, image: Indices, identity: Indices, state: Indices) -> SightingStretches:
    """Stretches of sightings, from their images, identities, −1 where unknown, and states, shapes (n,)."""
    time_s, sequence = images.time_s[image], images.sequence[image]
    sightings = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
    keys = np.column_stack([sequence, identity, state])[sightings]
    stretches, first, place = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    count = np.bincount(place.ravel()).astype(np.float64)
    low, high = np.full(len(stretches), np.inf), np.full(len(stretches), -np.inf)
    np.minimum.at(low, place.ravel(), time_s[sightings])
    np.maximum.at(high, place.ravel(), time_s[sightings])
    return SightingStretches(count, (high - low) / np.maximum(count - 1, 1), state[sightings][first])


LEVEL = 0.999  # level of the interval of a correlation that decides whether noise persists
_TIME_GRID = 96
_UNKNOWN = 50.0  # relative error of a correlation time that the frames do not bound from above
_ONCE = Resampling(np.ones((1, 1)), np.zeros(1, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Steps(Columns):
    """Consecutive sightings of the same thing: their places among the rows given and the time between, shapes (m,)."""

    earlier: Indices
    later: Indices
    apart_s: Array


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
        """Reason why noise is not said to persist."""
        where = "lies below 0, and only noise that persists is simulated" if self.high < 0 else "includes 0"
        pairs = "1 consecutive pair" if self.pairs == 1 else f"{self.pairs:,} consecutive pairs"
        ends = f"{number(self.low, 2)} to {number(self.high, 2)}"
        return f"the {in_percent(LEVEL, 1)} interval of the correlation in {pairs}, {ends}, {where}"


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
        their squares say how far it strays from 0. For ρ above 0 its variance is larger by a share ρ of as many trials
        as expected products are worth: else two misses among a thousand finds would seem to show that misses stay."""
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
        return float(replace(self, image=np.zeros_like(self.image)).times_s(_ONCE)[0])

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
        """Relative standard error of a correlation time τ, from each pair's product less e^(−Δt/τ) times the square of
        the earlier residual: independent whatever persists, and of many more pairs than runs of frames."""
        near = time_s * np.array([0.99, 1.0, 1.01])
        left = np.ones(3) if self.stretches is None else self.stretches.correlation_left(near)
        below, now, above = (self.expected * np.exp(-self.apart_s / t) * k for t, k in zip(near, left, strict=True))
        growth = float((above - below).sum() / np.log(near[2] / near[0]))
        return min(float(np.sqrt(((self.products - now) ** 2).sum())) / max(growth, 1e-12), _UNKNOWN)


def steps_between(labelled: LabelledSet, rows: Indices) -> Steps:
    """Consecutive ones of some annotations, shape (n,), of things with identities in frames with times."""
    return steps_of(labelled.images, labelled.annotations.image[rows], labelled.annotations.identity[rows])


def steps_of(images: Images, image: Indices, identity: Indices) -> Steps:
    """Consecutive sightings of the same thing, from their images and identities, −1 where unknown, shapes (n,)."""
    sequence, time_s = images.sequence[image], images.time_s[image]
    sightings = np.flatnonzero((identity >= 0) & np.isfinite(time_s))
    order = sightings[np.lexsort((time_s[sightings], identity[sightings], sequence[sightings]))]
    earlier, later = order[:-1], order[1:]
    apart_s = time_s[later] - time_s[earlier]
    same = (identity[earlier] == identity[later]) & (sequence[earlier] == sequence[later]) & (apart_s > 0)
    return Steps(earlier[same], later[same], apart_s[same])


def why_no_steps(labelled: LabelledSet) -> str:
    """Reason why no annotation follows another of the same thing."""
    if not np.isfinite(labelled.images.time_s).any():
        return "frames have no times"
    if not np.any(labelled.annotations.identity >= 0):
        return "annotations have no identities"
    return "nothing is annotated in two frames with times"


def frame_interval_s(labelled: LabelledSet) -> float:
    """Median time between consecutive frames; NaN where there are none."""
    order = np.lexsort((labelled.images.time_s, labelled.images.sequence))
    gaps = np.diff(labelled.images.time_s[order])
    gaps = gaps[(np.diff(labelled.images.sequence[order]) == 0) & np.isfinite(gaps) & (gaps > 0)]
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
