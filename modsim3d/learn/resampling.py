"""Bootstrap over images: how well a number is known.

Images are drawn with replacement (Efron (1979)); where they are consecutive frames, noise persists from one to
the next, and runs of frames are drawn instead, long against the time that noise persists. Every estimator here takes
weights of images, of which the first row is one each: it gives the estimate, the others its replicates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special, stats
from scipy.sparse import csr_array

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.labelled import Images

_LEAST_SPREAD = 1e-12


@dataclass(frozen=True, eq=False)
class Resampling:
    """Weights of images.

    Attributes:
        weights: How often each image was drawn; in the first row once each, shape (1 + replicates, I).
        unit: What was drawn, of each image, shape (I,): itself, or a run of frames.
    """

    weights: Array
    unit: Indices

    def sums(self, image: Indices, values: Array) -> Array:
        """Weighted sums of rows that belong to images, shape (1 + replicates, ...), from values of shape (n, ...)."""
        columns = int(np.prod(values.shape[1:]))
        flat = values.reshape(len(image), columns)
        index = np.repeat(image, columns), np.tile(np.arange(columns), len(image))
        by_image = csr_array((flat.ravel(), index), shape=(self.weights.shape[1], columns))
        total: Array = np.asarray((by_image.T @ self.weights.T).T)
        return total.reshape(len(self.weights), *values.shape[1:])

    def counts(self, image: Indices, cell: Indices, shape: tuple[int, ...], amount: Array | None = None) -> Array:
        """Weighted counts, or sums of amounts, of rows in the cells of a table, shape (1 + replicates, *shape)."""
        size = int(np.prod(shape))
        amount = np.ones(len(image)) if amount is None else amount
        by_image = csr_array((amount, (image, cell)), shape=(self.weights.shape[1], size))
        total: Array = np.asarray((by_image.T @ self.weights.T).T)
        return total.reshape(len(self.weights), *shape)

    def units(self, chosen: Mask) -> int:
        """How many of what is drawn hold the chosen images."""
        return len(np.unique(self.unit[chosen]))


def resample(images: Images, replicates: int, seed: int, run_s: float = 0.0) -> Resampling:
    """Draw images, or runs of frames, within each source as many as it has.

    Args:
        images: Of which.
        replicates: How often.
        seed: Everything random comes from it.
        run_s: Length of the runs where images have times; 0 draws single images.
    """
    timed = np.isfinite(images.time_s) if run_s > 0 else np.zeros(len(images), dtype=bool)
    run = np.where(timed, np.floor(np.nan_to_num(images.time_s) / max(run_s, 1e-9) + 1e-9), -1).astype(np.int64)
    single = np.where(timed, -1, np.arange(len(images)))
    keys = np.column_stack([images.source, np.where(timed, images.sequence, -1), run, single])
    _, first, unit = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    unit = unit.ravel()
    source_of_unit = images.source[first]
    generator = np.random.default_rng([seed, 5])
    weights = np.ones((1 + replicates, len(images)))
    for source in np.unique(source_of_unit):
        units = np.flatnonzero(source_of_unit == source)
        drawn = generator.multinomial(len(units), np.full(len(units), 1 / len(units)), size=replicates)
        ours = np.flatnonzero(images.source == source)
        weights[1:, ours] = drawn[:, np.searchsorted(units, unit[ours])]
    return Resampling(weights, unit)


@dataclass(frozen=True, eq=False)
class Column:
    """An estimate with its replicates.

    Attributes:
        values: The estimate first, shape (1 + replicates, ...).
        kind: What decides the scale on which it is nearly normal: `share` of a number of trials, `fraction` (another
            number from 0 to 1), `mean`, `positive`, `correlation`, or `rate` of a Poisson number.
        counts: Observations that it rests on, of the shape of one row; for a `rate`, what it is a rate per.
        inflation: Of a share: by how much noise that persists raises its variance at least. Replicates cannot tell
            where the thing happened once or never.
    """

    values: Array
    kind: str
    counts: Array
    inflation: float = 1.0

    @property
    def estimate(self) -> Array:
        """The first row."""
        first: Array = self.values[0]
        return first

    def interval(self, level: float, units: int) -> tuple[Array, Array]:
        """Both ends of confidence intervals, shapes of one row.

        Args:
            level: Such as 0.95.
            units: Of what was drawn: few of them make the spread itself uncertain, hence Student's distribution.
        """
        wide = float(stats.t.ppf((1 + level) / 2, max(units - 1, 1)))
        widen, tail = (wide / float(stats.norm.ppf((1 + level) / 2))) ** 2, (1 - level) / 2
        if self.kind in ("share", "rate"):
            return self._counted(widen, tail)
        centre = to_scale(self.estimate, self.kind)
        # Replicates of a single unit are all alike, and say nothing about how well the number is known.
        reach = wide * spread(to_scale(self.values[1:], self.kind)) if units > 1 else np.full(centre.shape, np.inf)
        low, high = from_scale(centre - reach, self.kind), from_scale(centre + reach, self.kind)
        if self.kind == "fraction":  # nor do they where all is right, or nothing
            at_end = (self.estimate <= 0) | (self.estimate >= 1)
            counted_low, counted_high = self._counted(widen, tail)
            low, high = np.where(at_end, counted_low, low), np.where(at_end, counted_high, high)
        return low, high

    def _counted(self, widen: float, tail: float) -> tuple[Array, Array]:
        """Jeffreys's, of as many independent observations as the spread of the replicates says."""
        value, count = self.estimate, np.maximum(self.counts, _LEAST_SPREAD)
        alone = value / count if self.kind == "rate" else value * (1 - value) / count
        found = spread(self.values[1:]) ** 2
        inflation = np.where(alone > 0, np.maximum(found / np.maximum(alone, 1e-300), 1.0), 1.0)
        inflation = np.maximum(inflation, self.inflation) * widen
        trials = count / inflation
        hits = value * trials
        with np.errstate(all="ignore"):
            if self.kind == "rate":
                low, high = (special.gammaincinv(hits + 0.5, p) / trials for p in (tail, 1 - tail))
            else:
                low, high = (special.betaincinv(hits + 0.5, trials - hits + 0.5, p) for p in (tail, 1 - tail))
                high = np.where(value >= 1, 1.0, high)
        return np.where(value <= 0, 0.0, np.minimum(low, value)), np.maximum(high, value)


def spread(replicates: Array) -> Array:
    """Standard deviation over replicates, those left out that could not be worked out."""
    finite = np.isfinite(replicates)
    number = finite.sum(axis=0)
    filled = np.where(finite, replicates, 0.0)
    mean = filled.sum(axis=0) / np.maximum(number, 1)
    squares = np.where(finite, (replicates - mean) ** 2, 0.0).sum(axis=0)
    result: Array = np.where(number > 1, np.sqrt(squares / np.maximum(number - 1, 1)), np.inf)
    return result


def widened(values: Array, least: Array) -> Array:
    """Replicates whose spread is at least a standard error from theory, in which noise that persists is counted.

    With few runs of frames, or few things that decide a number, replicates alone spread too little on average.

    Args:
        values: The estimate, then its replicates, shape (1 + replicates, ...).
        least: Standard error of the estimate, shape (...).

    Returns:
        The same shape, and the same estimate.
    """
    if len(values) == 1:
        return values
    found = spread(values[1:])
    usable = np.isfinite(found) & (found > 0) & np.isfinite(least)
    factor = np.where(usable, np.maximum(least / np.where(usable, found, 1.0), 1.0), 1.0)
    scaled: Array = values[0] + factor * (values - values[0])
    return scaled


def to_scale(values: Array, kind: str) -> Array:
    """Onto a scale on which the estimate is nearly normal."""
    scaled = values
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind in ("share", "fraction"):
            scaled = special.logit(np.clip(values, 1e-9, 1 - 1e-9))
        elif kind in ("positive", "rate"):
            scaled = np.log(np.maximum(values, 1e-12))
        elif kind == "correlation":
            scaled = np.arctanh(np.clip(values, -1 + 1e-9, 1 - 1e-9))
    return scaled


def from_scale(values: Array, kind: str) -> Array:
    """Back again."""
    plain = values
    with np.errstate(over="ignore"):
        if kind in ("share", "fraction"):
            plain = special.expit(values)
        elif kind in ("positive", "rate"):
            plain = np.exp(values)
        elif kind == "correlation":
            plain = np.tanh(values)
    return plain
