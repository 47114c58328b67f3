"""Pairs of false positives in frames some time apart that may be the same one, seen again near its place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, extents, ranges, run_starts
from modsim3d.learn.bootstrap import SIGNIFICANT, Column, Resampling, widened
from modsim3d.learn.matches import FalseSightings, Outcomes

_NEAR = 0.5
_MIN_NEAR_PX = 4.0
_MAX_RATIO = 2.0
_OF_THE_WAY = 0.25
_MAX_OFF_GAP = 0.25
_LAGS = 28
_FAR_PAIRS = 100_000


@dataclass(frozen=True, eq=False)
class Displacements:
    """Pairs of false positives, compared; shapes (m,)."""

    along_px: Array  # how far apart they lie along the horizon
    near_px: Array  # how far apart along it two sightings of the same thing that does not move may seem
    alike: Mask  # whether they lie as deep below the horizon and are as large as two sightings of the same thing

    @classmethod
    def between(cls, sightings: FalseSightings, first: Indices, second: Indices) -> Displacements:
        """Compare rows of false positives."""
        sides = sightings.sizes_px[first], sightings.sizes_px[second]
        near = np.maximum(_NEAR * (sides[0] + sides[1]) / 2, _MIN_NEAR_PX)
        ratio = np.maximum(sides[0] / sides[1], sides[1] / sides[0])
        # The horizon moves in the image: simulated ones keep the share of the sea above them, wakes their depth.
        depths = [sightings.depth_px, sightings.centres_px[:, 1]]
        if np.isfinite(sightings.image_px).all():
            depths.append(sightings.level_px)
        down = np.min([np.abs(depth[second] - depth[first]) for depth in depths], axis=0)
        alike: Mask = (down <= near[:, 1]) & (ratio <= _MAX_RATIO).all(axis=1)
        return cls(np.abs(sightings.along_px[second] - sightings.along_px[first]), near[:, 0], alike)

    def near(self, way_px: float) -> Mask:
        """Mask of those that may be the same thing, moved so far along the horizon to either side, shape (m,)."""
        return self.alike & (np.abs(self.along_px - way_px) <= self.near_px + _OF_THE_WAY * way_px)


@dataclass(frozen=True, eq=False)
class Lag:
    """Pairs of frames some time apart, and the pairs of false positives in them."""

    apart_s: float  # the mean time
    frames: Indices  # earlier and later image of each pair of frames, shape (2, p)
    rows: Indices  # earlier and later false positive of each pair of them, shape (2, m)
    moves: Displacements


@dataclass(frozen=True, eq=False)
class OrderedFrames:
    """Images in order of sequence and time: those that have times and a state."""

    images: Indices  # shape (f,)
    sequence: Indices  # shape (f,)
    time_s: Array  # shape (f,)
    gap_s: float  # median time between consecutive frames

    @classmethod
    def of(cls, observed: Outcomes) -> OrderedFrames | None:
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
        starts = run_starts(self.sequence)
        return float((self.time_s[np.append(starts[1:], len(self.sequence)) - 1] - self.time_s[starts]).max())

    def frame_pairs(self, steps: int) -> tuple[Indices, Indices]:
        """Places of frames that lie so many usual gaps apart, shapes (p,)."""
        first, second = np.arange(len(self.images) - steps), np.arange(steps, len(self.images))
        apart = self.time_s[second] - self.time_s[first]
        same = self.sequence[first] == self.sequence[second]
        kept = same & (np.abs(apart - steps * self.gap_s) <= _MAX_OFF_GAP * self.gap_s * max(1.0, steps / 4))
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


def far_pairs(observed: Outcomes, ordered: OrderedFrames, sightings: FalseSightings) -> Displacements:
    """Pairs in images of one size that show nothing twice: of other sequences, or far in time. Some of many are drawn;
    of few all count, since a chance estimated as 0 would make one pair look as if it stayed."""
    images, count = observed.labelled.images, len(sightings)
    if count * (count - 1) // 2 <= _FAR_PAIRS:
        first, second = np.triu_indices(count, 1)
    else:
        first, second = np.random.default_rng(0).integers(0, count, (2, _FAR_PAIRS))
    used = np.isin(sightings.image, ordered.images)
    image, later = sightings.image[first], sightings.image[second]
    usable = used[first] & used[second]
    other = usable & (images.sequence[image] != images.sequence[later])
    if not other.any():
        other = usable & (np.abs(images.time_s[image] - images.time_s[later]) > ordered.span_s / 2)
    alike = (images.sizes_px[image] == images.sizes_px[later]).all(axis=1) | np.isnan(images.sizes_px[image, 0])
    return Displacements.between(sightings, first[other & alike], second[other & alike])


def _row_pairs(image: Indices, first: Indices, second: Indices) -> Indices:
    """All pairs of rows of the first and of the second image of each pair, shape (2, m); `image` ascends."""
    (begin, count), (begin_2, count_2) = extents(image, first), extents(image, second)
    number = count * count_2
    pair, place = np.repeat(np.arange(len(first)), number), ranges(np.zeros_like(number), number)
    width = np.maximum(count_2[pair], 1)
    return np.stack([begin[pair] + place // width, begin_2[pair] + place % width])


# ---- Where false positives lie ----

GRID = (3, 4)  # rows and columns of the map of where false positives are
FALSE_FOR_EACH_CELL = 10
Placing = Literal["uniform", "horizon_band", "far_half_px", "density"]  # `far_half_px`: uniform, thinner far below
_ASTRAY = 0.02
_HALF_A_CASE = 0.5
_BANDS, _SCALES = 60, 61
_LN_2 = float(np.log(2))
_BAND_SPREAD = 1.4
"""Standard deviation of the logarithm of a band's width, times the false positives in it: the width is e^(x/n) times
the deepest one, x exponential, and so intervals of 95 % and of 99 % hold it."""
_ROUNDING_PX = 0.01


@dataclass(frozen=True, eq=False)
class PlaceFit:
    """Placements of false positives in images whose horizon and size are known."""

    sightings: FalseSightings
    inflation: float = 1.0  # factor by which those that stay raise the variance of a mean over all
    repeats: float = 1.0  # how many are seen of each different one

    def choose(self) -> tuple[Placing, float]:
        """The likeliest placement, uniform unless one is likelier by the Bayesian information criterion; its gain."""
        level = self._likelihood(self._density())
        cells = GRID[0] * GRID[1]
        options: list[tuple[Placing, int, float]] = [
            ("horizon_band", 1, self._likelihood(self._density(band_px=self._deepest_px)) - level),
            ("far_half_px", 1, self._likelihood(self._density(far_half_px=self.rough_far_half_px)) - level),
        ]
        if len(self.sightings) >= FALSE_FOR_EACH_CELL * cells:
            options.append(("density", cells - 1, self._likelihood(self._map()) - level))
        independent = max(len(self.sightings) / self.inflation, 1.0)
        worth = [2 * gain / self.inflation - k * np.log(independent) for _, k, gain in options]
        best = int(np.argmax(worth))
        return (options[best][0], options[best][2]) if worth[best] > SIGNIFICANT**2 else ("uniform", 0.0)

    def band_px(self, resampling: Resampling) -> Column:
        """Depth of the band below the horizon."""
        deepest = self._deepest_px
        inside = max(float((self._depths[0] <= deepest).sum()) / self.repeats, 2.0)
        width = deepest * (1 + 1 / inside)
        spread = max(_BAND_SPREAD / inside, _ROUNDING_PX / deepest)
        # The deepest of a resampled set tells nothing about those that were never seen.
        strays = np.random.default_rng(0).standard_normal(len(resampling.weights) - 1)
        strays = (strays - strays.mean()) / max(strays.std(ddof=1), 1e-9) if len(strays) > 1 else strays
        values = width * np.exp(np.append(0.0, spread * strays))
        return Column(values, "positive", np.array(float(len(self.sightings))))

    def far_half_px(self, resampling: Resampling) -> Column:
        """Distance below the horizon over which the density halves."""
        scales = self.rough_far_half_px * np.exp(np.linspace(-1.2, 1.2, _SCALES))
        logs = np.stack([self._log(self._density(far_half_px=scale)) for scale in scales.tolist()], axis=1)
        curves = resampling.sums(self.sightings.image, logs)
        tops = curves.argmax(axis=1).clip(1, _SCALES - 2)
        left, middle, right = (curves[np.arange(len(curves)), tops + k] for k in (-1, 0, 1))
        bend = np.minimum(left - 2 * middle + right, -1e-12)
        step = float(np.log(scales[1] / scales[0]))
        values = scales[tops] * np.exp(np.clip(0.5 * (left - right) / bend, -0.5, 0.5) * step)
        column = np.exp(widened(np.log(values), step / np.sqrt(-bend[0]) * np.sqrt(self.inflation)))
        return Column(column, "positive", np.array(float(len(self.sightings))))

    @cached_property
    def rough_far_half_px(self) -> float:
        """The likeliest such distance."""
        scales = float(self.sightings.image_px.max(initial=1.0)) * np.geomspace(0.003, 10, _SCALES)
        values = [self._likelihood(self._density(far_half_px=scale)) for scale in scales.tolist()]
        return float(scales[int(np.argmax(values))])

    @cached_property
    def _deepest_px(self) -> float:
        """Depth of the likeliest band: that of the deepest one in it."""
        depths = np.unique(self._depths[0][self._depths[0] > 0])
        if not len(depths):
            return 1.0
        first, last = 0, len(depths) - 1
        while True:  # ever closer around the best of some
            some = np.unique(np.linspace(first, last, _BANDS).astype(np.int64))
            deepest = depths[some] + _ROUNDING_PX / 2
            best = int(np.argmax([self._likelihood(self._density(band_px=depth)) for depth in deepest.tolist()]))
            if last - first < _BANDS:
                return float(deepest[best])
            first, last = int(some[max(best - 1, 0)]), int(some[min(best + 1, len(some) - 1)])

    def _likelihood(self, density: Array) -> float:
        return float(self._log(density).sum())

    def _log(self, density: Array) -> Array:
        """Log-likelihood of each, given its density (n,), if a few lie anywhere in the image; shape (n,)."""
        low, high = self.sightings.places_px
        anywhere = np.where(high > low, high - low, 1.0) / np.prod(self.sightings.image_px, axis=1)
        return np.asarray(np.log((1 - _ASTRAY) * density + _ASTRAY * anywhere))

    @cached_property
    def _depths(self) -> tuple[Array, Array]:
        """Least and greatest depth at which the centre of each may lie, shapes (n,)."""
        (low, high), rows = self.sightings.places_px, self.sightings.centres_px[:, 1]
        a, b, _ = self.sightings.half_planes.T
        slope = b / np.hypot(a, b)
        return self.sightings.depth_px + (low - rows) * slope, self.sightings.depth_px + (high - rows) * slope

    def _density(self, band_px: float = np.inf, far_half_px: float = np.inf) -> Array:
        """Share of the sea's weight at the centre of each, or on the way where it may lie, shape (n,)."""
        depth, width, row = self.sightings.levels
        least, most = depth[:, 0], depth[:, -1]
        most = np.where(least < band_px, np.minimum(most, band_px), most)
        if np.isfinite(far_half_px):
            weights = np.exp2(-np.maximum(depth, 0) / far_half_px) * width
            total = ((weights[:, 1:] + weights[:, :-1]) / 2 * np.diff(depth, axis=1)).sum(axis=1)
        else:
            total = self._area_above(most)
        first, last = least[row], most[row]
        low, high = np.minimum(*self._depths), np.maximum(*self._depths)
        inside = (high >= first) & (low <= last)
        begin, end = np.clip(low, first, last), np.clip(high, first, last)
        if np.isfinite(far_half_px):
            at_begin, at_end = (np.exp2(-np.maximum(limit, 0) / far_half_px) for limit in (begin, end))
            way, here = far_half_px / _LN_2 * (at_begin - at_end), at_begin
        else:
            way, here = end - begin, np.ones(len(row))
        return np.asarray(np.where(inside, np.where(high > low, way, here), 0.0) / np.maximum(total[row], 1e-9))

    def _area_above(self, level: Array) -> Array:
        """Area of the sea above a level of each distinct image, shapes (k,)."""
        (depth, _, _), areas = self.sightings.levels, self.sightings.areas
        last = depth.shape[1] - 1
        share = np.clip((level - depth[:, 0]) / np.maximum(depth[:, -1] - depth[:, 0], 1e-9), 0, 1)
        node = np.minimum(np.sqrt(share) * last, last - 1).astype(np.int64)  # levels lie closer near the horizon
        rows, after = np.arange(len(depth)), node + 1
        share = (level - depth[rows, node]) / np.maximum(depth[rows, after] - depth[rows, node], 1e-9)
        return np.asarray(areas[rows, node] + np.clip(share, 0, 1) * (areas[rows, after] - areas[rows, node]))

    def _map(self) -> Array:
        """Density of a map of the image in cells, shape (n,)."""
        rows, columns = GRID
        column, row = cells_of(self.sightings.centres_px, self.sightings.image_px)
        counts = np.full(GRID, _HALF_A_CASE)
        np.add.at(counts, (row, column), 1)
        height = self.sightings.image_px[:, 1] / rows
        area = np.prod(self.sightings.image_px, axis=1) / (rows * columns)
        low, high = self.sightings.places_px
        edges = np.arange(rows)[:, None] * height
        overlap = np.clip(np.minimum(high, edges + height) - np.maximum(low, edges), 0, None)
        lengths = np.where(high > low, overlap, np.arange(rows)[:, None] == row)
        return np.asarray((lengths * counts[:, column]).sum(axis=0) / counts.sum() / area)


def cells_of(centres_px: Array, image_px: Array) -> tuple[Indices, Indices]:
    """Column and row in the grid of points in images of such sizes, shapes (n, 2); shapes (n,)."""
    rows, columns = GRID
    place = np.clip(np.floor(centres_px / image_px * [columns, rows]), 0, [columns - 1, rows - 1]).astype(np.int64)
    return place[:, 0], place[:, 1]
