"""Things that were detected without a transponder: how long each lasts, and whether it moves like a vessel."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.statistics import MAD_TO_STD
from modsim3d.formats.labelled import Images
from modsim3d.learn.voyage.non_ais.linking import Links

_MIN_SEEN = 5  # detections that are needed to see how a thing moves; with fewer nothing speaks against a vessel
_MAX_OFF, _MAX_OFF_PX, _MAX_RESIZED = 0.35, 5.0, 0.4
"""Median distance from the middle of the detections before and after, in sides and in pixels; spread of log sides."""
_MIN_SHARE = 0.25  # share of the frames of its life in which a vessel is detected at least
_ABOVE, _MIN_ABOVE_PX = 0.25, 3.0  # how far above the horizon a vessel's lower edge may be, in heights and in pixels
_UNSTEADY_STDS = 1.5  # so many standard deviations of the jitter of known boxes are steady in any case


class Behaviour(IntEnum):
    """Reasons against a vessel: the first that is true."""

    LIKE_A_VESSEL = 0
    ABOVE_THE_HORIZON = 1
    RARELY_SEEN = 2
    JUMPS = 3
    CHANGES_SIZE = 4

    @property
    def in_words(self) -> str:
        """For a report."""
        return {
            Behaviour.LIKE_A_VESSEL: "nothing speaks against a vessel",
            Behaviour.ABOVE_THE_HORIZON: "lower edge above the horizon",
            Behaviour.RARELY_SEEN: f"detected in less than {_MIN_SHARE:.0%} of the frames",
            Behaviour.JUMPS: "moves unsteadily",
            Behaviour.CHANGES_SIZE: "changes its size",
        }[self]


@dataclass(frozen=True, eq=False)
class Things:
    """N linked things, as columns (N,)."""

    detections: Indices  # how often each was detected, (N,)
    first_image: Indices  # in which each was detected
    frames: Indices  # from the first detection to the last, both included, by the usual gap
    lasted_s: Array  # from the first detection to the last
    cut: Mask  # whether the frames end before the thing surely did
    behaviour: Indices  # of `Behaviour`

    @property
    def perhaps_vessel(self) -> Mask:
        """Whether nothing but a short life speaks against a vessel, shape (N,)."""
        return np.asarray(self.behaviour == Behaviour.LIKE_A_VESSEL)

    @property
    def unsteady(self) -> Mask:
        """Whether places or sizes jump, as those of a small vessel with large box errors do too, shape (N,)."""
        return np.isin(self.behaviour, (Behaviour.JUMPS, Behaviour.CHANGES_SIZE))


def things_of(links: Links, images: Images) -> Things:
    """Durations and movements of the linked things."""
    count, order = links.count, np.lexsort((links.time_s, links.link))
    link = links.link[order]
    starts = np.searchsorted(link, np.arange(count))
    stops = np.searchsorted(link, np.arange(count), side="right")
    detections = stops - starts
    time_s = links.time_s[order]
    lasted = np.nan_to_num(time_s[stops - 1] - time_s[starts]) if count else np.empty(0)
    frames = 1 + np.rint(lasted / links.gap_s).astype(np.int64)
    first_image = links.image[order][starts]
    ends = _ends_s(images)[images.sequence[first_image]] if count else np.empty(0)
    with np.errstate(invalid="ignore"):
        cut = ends - time_s[stops - 1] < links.longest_gap_s if count else np.empty(0, dtype=bool)
    cut = cut | links.at_border[order][stops - 1] if count else cut
    behaviour = np.zeros(count, dtype=np.int64)
    for thing in np.flatnonzero(detections >= _MIN_SEEN).tolist():
        rows = order[starts[thing] : stops[thing]]
        whole = rows[links.whole[rows]]
        rows = whole if len(whole) >= _MIN_SEEN else rows[:0]
        behaviour[thing] = _behaviour(links, rows, detections[thing] / frames[thing]) if len(rows) else 0
    return Things(detections, first_image, frames, lasted, cut, behaviour)


def _behaviour(links: Links, rows: Indices, share: float) -> Behaviour:
    """Behaviour of a thing that was detected in some rows, in order of time, (n,)."""
    place, size, time_s = links.places_px[rows], links.sizes_px[rows], links.time_s[rows]
    below = links.bottom_px[rows]
    if np.isfinite(below).any() and np.nanmedian(below + np.maximum(_ABOVE * size[:, 1], _MIN_ABOVE_PX)) < 0:
        return Behaviour.ABOVE_THE_HORIZON
    if share < _MIN_SHARE:
        return Behaviour.RARELY_SEEN
    part = ((time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2]))[:, None]
    off = np.linalg.norm(place[1:-1] - (place[:-2] + part * (place[2:] - place[:-2])), axis=1)
    side = float(np.median(np.sqrt(size.prod(axis=1))))
    if np.median(off) > max(_MAX_OFF * side, _MAX_OFF_PX, _UNSTEADY_STDS * float(links.jitter.off_px(side))):
        return Behaviour.JUMPS
    # A vessel that nears grows, but slowly.
    shares, pixels = (MAD_TO_STD * np.median(np.abs(np.diff(each, axis=0)), axis=0) for each in (np.log(size), size))
    resized = (shares > np.sqrt(2) * _MAX_RESIZED) & (pixels > _UNSTEADY_STDS * links.jitter.resized_px(side))
    return Behaviour.CHANGES_SIZE if resized.any() else Behaviour.LIKE_A_VESSEL


def _ends_s(images: Images) -> Array:
    """The last time of each sequence, by its number, NaN without times."""
    ends = np.full(int(images.sequence.max(initial=-1)) + 1, -np.inf)
    timed = np.isfinite(images.time_s)
    np.maximum.at(ends, images.sequence[timed], images.time_s[timed])
    return np.where(np.isfinite(ends), ends, np.nan)


# ---- Two kinds of durations ----

MIN_S = 30.0  # what lasts as vessels do lasts so long on average at least
MIN_RATIO = 3.0  # and so many times as long as flicker that stays, whose mean is at most the least over this
_STEPS = 60
_SURE = 6.0  # gain of log-likelihood by which the longer kind is there: by chance it is as large in one of 400 sets
_MIN_WEIGHT = 0.05  # in a replicate without any of the few things that last, they are still known to be there
_SINGLE, _SHORT, _LONG = range(3)


@dataclass(frozen=True, eq=False)
class DurationTypes:
    """Durations that are alike, and the mixture fitted to them in each replicate. Things of a `longer` duration move
    like a vessel and were seen for longer than flicker lasts on average at most. `unsteady` ones last as vessels do and
    jump: they count as false, and may be vessels."""

    of_thing: Indices  # which duration each of N things has, (N,)
    lasting: Array  # probability that a thing of each duration is of the longer kind, (rows, durations)
    short_s: Array  # mean lifetime of flicker that stays, (rows,)
    long_s: Array  # mean lifetime of the longer kind, (rows,)
    found: bool  # whether the data show a longer kind; else `lasting` is 0
    longer: Mask  # (durations,)
    unsteady: Mask  # (durations,)
    inflation: float  # factor by which flicker that stays raises the variance of the number of its detections

    def at_least(self, probability: float) -> Mask:
        """Mask of the durations that may be of vessels with such a probability, (durations,): those of things seen for
        long, where the data show no longer kind, and always those of things that last and jump."""
        likely: Mask = self.lasting[0] >= probability
        return (likely if self.found else self.longer) | self.unsteady


def kinds_of(things: Things, weights: Array, gap_s: float, least_s: float = MIN_S) -> DurationTypes:
    """Fit the mixture to the durations of N things; each has a weight in each replicate, (rows, N), one in the first
    row. Things that do not move like a vessel are left out, and are surely of no longer kind, however long they last.
    `gap_s` is the usual time between frames, and `least_s` the least mean lifetime of the longer kind."""
    perhaps = things.perhaps_vessel
    keys = np.column_stack([things.frames, things.cut, perhaps, things.unsteady]).astype(np.int64)
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
        shares = np.zeros((3, *counts.shape))
        value = np.zeros(len(counts))
        for _ in range(_STEPS):
            density = np.stack(
                [
                    np.broadcast_to(np.log(np.where(self.frames == 1, 1.0, 1e-300)), counts.shape),
                    self._log_density(short),
                    np.where(self.perhaps & with_long, self._log_density(long), -np.inf),
                ]
            )
            joint = density + np.log(np.maximum(amount, 1e-300))[..., None]
            top = joint.max(axis=0)
            whole = np.exp(joint - top).sum(axis=0)
            shares = np.exp(joint - top) / whole
            value = (counts * (top + np.log(whole))).sum(axis=1)
            weighted = counts * shares
            total = np.maximum(counts.sum(axis=1), 1e-12)
            amount = weighted.sum(axis=2) / total
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
        stay = np.log(np.maximum(1 - end, 1e-12))
        return np.multiply(self.frames - 1, stay) + (1 - self.cut) * np.log(end)

    def _mean(self, weights: Array) -> Array:
        """Mean number of frames: all frames after which each could have ended over all ends, (rows,)."""
        ends = (weights * (1 - self.cut)).sum(axis=1)
        trials = np.subtract(self.frames, self.cut, dtype=np.float64)
        return np.asarray((weights * trials).sum(axis=1) / np.maximum(ends, 0.5))
