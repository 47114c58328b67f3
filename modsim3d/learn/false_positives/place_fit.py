"""Where false positives lie: which placement is the likeliest, and its parameter.

Of a placement, the likelihood of a false positive is the weight at its centre over that of all the sea in the image.
The image's edge cuts boxes, so the centre of one at the upper or lower edge lies somewhere on the way to the edge. A
few false positives lie anywhere in the image, whatever the placement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.learn.numbers.resampling import SIGNIFICANT, Column, Resampling, widened
from modsim3d.learn.observed.false_sightings import FalseSightings

GRID = (3, 4)
"""Rows and columns of the map of where false detections are."""
FALSE_FOR_EACH_CELL = 10
Placing = Literal["uniform", "horizon_band", "far_half_px", "density"]
"""Placements, and `far_half_px` for a uniform one that thins out below the horizon."""
_ASTRAY = 0.02
_HALF_A_CASE = 0.5
_BANDS, _SCALES = 60, 61
_LN_2 = float(np.log(2))
_BAND_SPREAD = 1.4
"""Standard deviation of the logarithm of a band's width, times the false positives in it, as it is reported. The width
lies above the deepest one by a factor e^(x/n) with x exponential, and so intervals of 95 % and of 99 % hold it."""
_ROUNDING_PX = 0.01


@dataclass(frozen=True, eq=False)
class PlaceFit:
    """Placements of false positives in images whose horizon and size are known.

    Attributes:
        sightings: The false positives.
        inflation: Factor by which those that stay raise the variance of a mean over all.
        repeats: How many are seen of each different one.
    """

    sightings: FalseSightings
    inflation: float = 1.0
    repeats: float = 1.0

    def choose(self) -> tuple[Placing, float]:
        """The likeliest placement, uniform unless another is clearly likelier, and its gain in log-likelihood.

        Each parameter costs as much as the Bayesian information criterion says.
        """
        level = self._likelihood(self._density())
        cells = GRID[0] * GRID[1]
        found: list[tuple[Placing, int, float]] = [
            ("horizon_band", 1, self._likelihood(self._density(band_px=self._deepest_px)) - level),
            ("far_half_px", 1, self._likelihood(self._density(far_half_px=self.rough_far_half_px)) - level),
        ]
        if len(self.sightings) >= FALSE_FOR_EACH_CELL * cells:
            found.append(("density", cells - 1, self._likelihood(self._map()) - level))
        independent = max(len(self.sightings) / self.inflation, 1.0)
        worth = [2 * gain / self.inflation - k * np.log(independent) for _, k, gain in found]
        best = int(np.argmax(worth))
        return (found[best][0], found[best][2]) if worth[best] > SIGNIFICANT**2 else ("uniform", 0.0)

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
        each = np.stack([self._log(self._density(far_half_px=scale)) for scale in scales.tolist()], axis=1)
        curves = resampling.sums(self.sightings.image, each)
        tops = curves.argmax(axis=1).clip(1, _SCALES - 2)
        rows = np.arange(len(curves))
        left, middle, right = (curves[rows, tops + k] for k in (-1, 0, 1))
        bend = np.minimum(left - 2 * middle + right, -1e-12)
        step = float(np.log(scales[1] / scales[0]))
        shift = np.clip(0.5 * (left - right) / bend, -0.5, 0.5)
        values = scales[tops] * np.exp(shift * step)
        least = step / np.sqrt(-bend[0]) * np.sqrt(self.inflation)
        column = np.exp(widened(np.log(values), least))
        return Column(column, "positive", np.array(float(len(self.sightings))))

    @cached_property
    def rough_far_half_px(self) -> float:
        """The likeliest such distance."""
        most = float(self.sightings.image_px.max(initial=1.0))
        scales = most * np.geomspace(0.003, 10, _SCALES)
        found = [self._likelihood(self._density(far_half_px=scale)) for scale in scales.tolist()]
        return float(scales[int(np.argmax(found))])

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
        result: Array = np.log((1 - _ASTRAY) * density + _ASTRAY * anywhere)
        return result

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
            at_begin, at_end = (np.exp2(-np.maximum(each, 0) / far_half_px) for each in (begin, end))
            way, here = far_half_px / _LN_2 * (at_begin - at_end), at_begin
        else:
            way, here = end - begin, np.ones(len(row))
        result: Array = np.where(inside, np.where(high > low, way, here), 0.0) / np.maximum(total[row], 1e-9)
        return result

    def _area_above(self, level: Array) -> Array:
        """Area of the sea above a level of each distinct image, shapes (k,)."""
        (depth, _, _), areas = self.sightings.levels, self._areas
        last = depth.shape[1] - 1
        share = np.clip((level - depth[:, 0]) / np.maximum(depth[:, -1] - depth[:, 0], 1e-9), 0, 1)
        node = np.minimum(np.sqrt(share) * last, last - 1).astype(np.int64)  # levels lie closer near the horizon
        rows, after = np.arange(len(depth)), node + 1
        share = (level - depth[rows, node]) / np.maximum(depth[rows, after] - depth[rows, node], 1e-9)
        result: Array = areas[rows, node] + np.clip(share, 0, 1) * (areas[rows, after] - areas[rows, node])
        return result

    @cached_property
    def _areas(self) -> Array:
        """Area of the sea above each level of each distinct image, shape (k, nodes)."""
        depth, width, _ = self.sightings.levels
        pieces = (width[:, 1:] + width[:, :-1]) / 2 * np.diff(depth, axis=1)
        return np.concatenate([np.zeros((len(depth), 1)), np.cumsum(pieces, axis=1)], axis=1)

    def _map(self) -> Array:
        """The same of a map of the image in cells, shape (n,)."""
        rows, columns = GRID
        column, row = cells_of(self.sightings.centres_px, self.sightings.image_px)
        counts = np.full(GRID, _HALF_A_CASE)
        np.add.at(counts, (row, column), 1)
        height = self.sightings.image_px[:, 1] / rows
        area = np.prod(self.sightings.image_px, axis=1) / (rows * columns)
        low, high = self.sightings.places_px
        edges = np.arange(rows)[:, None] * height
        overlap = np.clip(np.minimum(high, edges + height) - np.maximum(low, edges), 0, None)
        here = np.arange(rows)[:, None] == row
        lengths = np.where(high > low, overlap, here)
        result: Array = (lengths * counts[:, column]).sum(axis=0) / counts.sum() / area
        return result


def cells_of(centres_px: Array, image_px: Array) -> tuple[Indices, Indices]:
    """Column and row in the grid of points in images of such sizes, shapes (n, 2); shapes (n,)."""
    rows, columns = GRID
    place = np.clip(np.floor(centres_px / image_px * [columns, rows]), 0, [columns - 1, rows - 1]).astype(np.int64)
    return place[:, 0], place[:, 1]
