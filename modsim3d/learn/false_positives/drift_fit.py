"""How fast false positives that stay drift along the horizon."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.learn.false_positives.lasting_pairs import Lag
from modsim3d.learn.numbers.resampling import Column, Resampling, widened
from modsim3d.learn.observed.false_sightings import FalseSightings
from modsim3d.learn.persistence.persistence_fit import LEVEL

LEAST_TRACKS = 5
"""False positives seen in frames on end that a speed needs."""
_LEAST_SEEN = 4
_LEAST_ERROR = 0.005
_MOST_TIMES = 9.0
_ROBUST = float(np.pi / 2)
"""Variance of a median of normal numbers over that of their mean."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Speeds of the s false positives that were seen in at least four frames on end.

    Attributes:
        image: Image in which each was first seen, shape (s,).
        square: Squared speed along the horizon less its error, px²/s², shape (s,).
        weight: In how many frames it was seen, less where its speed is not known well, shape (s,).
    """

    image: Indices
    square: Array
    weight: Array

    @classmethod
    def of(cls, sightings: FalseSightings, times_s: Array, next_frame: Lag) -> Drift:
        """From links between consecutive frames; `times_s` are the times of all images."""
        track = _tracks(len(sightings), next_frame)
        rows = np.flatnonzero(sightings.whole & (track >= 0))  # the edge moves the centre of what it cuts
        rows = rows[np.argsort(track[rows], kind="stable")]
        found: list[tuple[int, float, float, int]] = []
        for ours in np.split(rows, np.flatnonzero(np.diff(track[rows])) + 1):
            if len(ours) < _LEAST_SEEN:
                continue
            time_s, along = times_s[sightings.image[ours]], sightings.along_px[ours]
            half = len(ours) // 2
            speeds = (along[half:] - along[:-half]) / (time_s[half:] - time_s[:-half])
            stray = _ROBUST * float(speeds.var(ddof=1)) / len(speeds)
            found.append((int(sightings.image[ours[0]]), float(np.median(speeds)) ** 2, stray, len(ours)))
        if not found:
            return cls(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        image, square, error, frames = map(np.array, zip(*found, strict=True))
        # Two that passed close by each other may have been linked: too fast, or of no one speed.
        middle = float(np.median(square))
        usual = square <= _MOST_TIMES * middle
        weight = frames / (1 + _MOST_TIMES * error / max(middle, 1e-12))
        return cls(image[usual], (square - error)[usual], weight[usual])

    @cached_property
    def rough_px_s(self) -> float:
        """The root of the mean square; 0 where that is not above 0, or none was seen for long enough."""
        return float(np.sqrt(max(self._mean_square, 0.0)))

    @property
    def sure(self) -> bool:
        """Whether the speed is surely above 0: the interval of the mean square says so."""
        count = len(self.weight)
        if count < LEAST_TRACKS:
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
        square = sums[:, 0] / np.maximum(sums[:, 1], 1e-9)
        values = np.sqrt(np.maximum(square, 1e-12))
        return Column(widened(values, values[0] * _LEAST_ERROR), "positive", np.array(float(len(self.weight))))


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
