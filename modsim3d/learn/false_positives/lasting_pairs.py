"""Pairs of false positives in frames some time apart that may be the same one, seen again near its place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.observed.false_sightings import FalseSightings
from modsim3d.learn.observed.observed import Observed

_NEAR = 0.5
_LEAST_NEAR_PX = 4.0
_MOST_RATIO = 2.0
_OF_THE_WAY = 0.25
_MOST_OFF_GAP = 0.25
_LAGS = 28
_FAR_PAIRS = 100_000
_FAR_TRIES = 40_000


@dataclass(frozen=True, eq=False)
class Displacements:
    """Pairs of false positives, compared; arrays of shape (m,).

    Attributes:
        along_px: How far apart they lie along the horizon.
        near_px: How far apart along it two sightings of the same thing that does not move may seem.
        alike: Whether they lie as deep below the horizon and are as large as two sightings of the same thing.
    """

    along_px: Array
    near_px: Array
    alike: Mask

    @classmethod
    def between(cls, sightings: FalseSightings, first: Indices, second: Indices) -> Displacements:
        """Compare rows of false positives."""
        sides = sightings.sizes_px[first], sightings.sizes_px[second]
        near = np.maximum(_NEAR * (sides[0] + sides[1]) / 2, _LEAST_NEAR_PX)
        ratio = np.maximum(sides[0] / sides[1], sides[1] / sides[0])
        # The horizon moves in the image: simulated ones keep the share of the sea above them, wakes their depth.
        depths = [sightings.depth_px, sightings.centres_px[:, 1]]
        if np.isfinite(sightings.image_px).all():
            depths.append(sightings.level_px)
        down = np.min([np.abs(depth[second] - depth[first]) for depth in depths], axis=0)
        alike: Mask = (down <= near[:, 1]) & (ratio <= _MOST_RATIO).all(axis=1)
        return cls(np.abs(sightings.along_px[second] - sightings.along_px[first]), near[:, 0], alike)

    def near(self, way_px: float) -> Mask:
        """Which may be the same thing that moved so far along the horizon to either side, shape (m,)."""
        reach = self.near_px + _OF_THE_WAY * way_px
        near: Mask = self.alike & (np.abs(self.along_px - way_px) <= reach)
        return near


@dataclass(frozen=True, eq=False)
class Lag:
    """Pairs of frames some time apart, and the pairs of false positives in them.

    Attributes:
        apart_s: The mean time.
        frames: Earlier and later image of each pair of frames, shape (2, p).
        rows: Earlier and later false positive of each pair of them, shape (2, m).
        moves: How they lie to each other.
    """

    apart_s: float
    frames: Indices
    rows: Indices
    moves: Displacements


@dataclass(frozen=True, eq=False)
class OrderedFrames:
    """Images in order of sequence and time: those that have times and a state.

    Attributes:
        images: Shape (f,).
        sequence: Of each, shape (f,).
        time_s: Shape (f,).
        gap_s: Median time between consecutive frames.
    """

    images: Indices
    sequence: Indices
    time_s: Array
    gap_s: float

    @classmethod
    def of(cls, observed: Observed) -> OrderedFrames | None:
        """That of a labelled set; None without two frames of one sequence."""
        images = observed.labelled.images
        used = np.flatnonzero((observed.image_state >= 0) & np.isfinite(images.time_s))
        used = used[np.lexsort((images.time_s[used], images.sequence[used]))]
        gaps = np.diff(images.time_s[used])[np.diff(images.sequence[used]) == 0]
        gaps = gaps[gaps > 0]
        if not len(gaps):
            return None
        return cls(used, images.sequence[used], images.time_s[used], float(np.median(gaps)))

    @property
    def span_s(self) -> float:
        """Length of the longest sequence."""
        starts = np.flatnonzero(np.diff(self.sequence, prepend=-1))
        ends = np.append(starts[1:], len(self.sequence)) - 1
        return float((self.time_s[ends] - self.time_s[starts]).max())

    def frame_pairs(self, steps: int) -> tuple[Indices, Indices]:
        """Places of frames that lie so many usual gaps apart, shapes (p,)."""
        first, second = np.arange(len(self.images) - steps), np.arange(steps, len(self.images))
        apart = self.time_s[second] - self.time_s[first]
        same = self.sequence[first] == self.sequence[second]
        kept = same & (np.abs(apart - steps * self.gap_s) <= _MOST_OFF_GAP * self.gap_s * max(1.0, steps / 4))
        return first[kept], second[kept]


def lags_of(ordered: OrderedFrames, sightings: FalseSightings, most_s: float) -> Iterator[Lag]:
    """Lags up to a time, one frame first, then ever farther apart."""
    most = max(int(most_s / ordered.gap_s + 1e-9), 1)
    steps = np.unique(np.round(np.geomspace(1, most, _LAGS)).astype(np.int64))
    for number in steps[steps < len(ordered.images)].tolist():
        first, second = ordered.frame_pairs(number)
        if not len(first):
            continue
        apart_s = float((ordered.time_s[second] - ordered.time_s[first]).mean())
        frames = np.stack([ordered.images[first], ordered.images[second]])
        rows = _row_pairs(sightings.image, *frames)
        yield Lag(apart_s, frames, rows, Displacements.between(sightings, *rows))


def far_pairs(observed: Observed, ordered: OrderedFrames, sightings: FalseSightings) -> Displacements:
    """Pairs of false positives in images of one size that show nothing twice: of other sequences, or far in time."""
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(ordered.images), (2, _FAR_TRIES))
    other = ordered.sequence[first] != ordered.sequence[second]
    if not other.any():
        other = np.abs(ordered.time_s[first] - ordered.time_s[second]) > ordered.span_s / 2
    sizes = observed.labelled.images.sizes_px[ordered.images]
    alike = (sizes[first] == sizes[second]).all(axis=1) | np.isnan(sizes[first, 0])
    chosen = other & alike
    rows = _row_pairs(sightings.image, ordered.images[first[chosen]], ordered.images[second[chosen]])
    return Displacements.between(sightings, *rows[:, :_FAR_PAIRS])


def _row_pairs(image: Indices, first: Indices, second: Indices) -> Indices:
    """All pairs of rows of the first and of the second image of each pair, shape (2, m); `image` ascends."""
    begin, count = (np.searchsorted(image, first, side) for side in ("left", "right"))
    count = count - begin
    begin_2, count_2 = (np.searchsorted(image, second, side) for side in ("left", "right"))
    count_2 = count_2 - begin_2
    number = count * count_2
    pair = np.repeat(np.arange(len(first)), number)
    place = np.arange(len(pair)) - np.repeat(np.cumsum(number) - number, number)
    width = np.maximum(count_2[pair], 1)
    return np.stack([begin[pair] + place // width, begin_2[pair] + place % width])
