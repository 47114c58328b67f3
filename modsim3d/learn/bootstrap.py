"""Bootstrap over images: how well a number is known. Images are drawn with replacement (Efron (1979)). Noise persists
from one frame to the next, so of consecutive frames runs are drawn that are long against that. Every estimator takes
weights of images: their first row, one for each, gives the estimate, and the other rows give its replicates."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal, TypeVar, cast

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.statistics import jeffreys_rate, jeffreys_share
from modsim3d.formats.labelled import Images

SIGNIFICANT = 3.3  # standard errors from zero that an effect needs: one in a thousand reaches them by chance
MIN_UNITS = 6
"""Images or runs of frames below which their spread does not tell how well a number is known; counts still do."""
_MIN_SPREAD = 1e-12

Kind = Literal["share", "fraction", "mean", "positive", "correlation", "rate", "above_two", "capped"]
"""A `share` of a number of trials, another `fraction` from 0 to 1, a `mean`, a `positive` number, a `correlation`, a
`rate` of a Poisson number, a number `above_two`, or a part from 0 to 1 whose ends are usual, `capped` there."""


@dataclass(frozen=True, eq=False)
class Resampling:
    """Counts of draws of each image, in the first row one each, (1 + replicates, I), and the index of what was drawn
    with each, itself or a run of frames (I,)."""

    weights: Array
    unit: Indices

    def sums(self, image: Indices, values: Array) -> Array:
        """Weighted sums of values (n, ...), given the image of each (n,), shape (1 + replicates, ...)."""
        cells = int(np.prod(values.shape[1:]))
        cell = np.tile(np.arange(cells), len(image))
        return self.counts(np.repeat(image, cells), cell, values.shape[1:], values.ravel())

    def counts(self, image: Indices, cell: Indices, shape: tuple[int, ...], amount: Array | None = None) -> Array:
        """Weighted counts in the cells of a table, shape (1 + replicates, *shape), given the image of each thing that
        is counted (n,), its cell in the flattened table (n,), and how much it counts (n,), one if None."""
        from scipy.sparse import csr_array  # slow to import, and reading what was learned needs none

        size = int(np.prod(shape))
        amount = np.ones(len(image)) if amount is None else amount
        there = np.bincount(image) > 0  # most frames of a long night are empty
        used, row = np.flatnonzero(there), (np.cumsum(there) - 1)[image]
        by_image = csr_array((amount, (row, cell)), shape=(len(used), size))
        total: Array = np.asarray((by_image.T @ self.weights[:, used].T).T)
        return total.reshape(len(self.weights), *shape)

    def units(self, chosen: Mask) -> int:
        """Number of single images or runs that hold the chosen images, shape (I,)."""
        return len(np.unique(self.unit[chosen]))


def resample(images: Images, replicates: int, seed: int, run_s: float = 0.0) -> Resampling:
    """Draw as many images, or runs of so many seconds where they have times, from each source as it has."""
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
        members = np.flatnonzero(images.source == source)
        place, chances = np.searchsorted(units, unit[members]), np.full(len(units), 1 / len(units))
        for row in range(1, 1 + replicates):  # all at once would take three times the memory
            weights[row, members] = generator.multinomial(len(units), chances)[place]
    return Resampling(weights, unit)


_RUN_TIMES, _MIN_RUNS = 12.0, 24


def run_length_s(images: Images, memory_s: float) -> float:
    """A length of runs many times as long as noise persists, but so that enough runs are left; 0 if none persists."""
    if memory_s <= 0:
        return 0.0
    spans = [float(np.ptp(images.time_s[images.sequence == s])) for s in np.unique(images.sequence)]
    return min(_RUN_TIMES * memory_s, float(np.nansum(spans)) / _MIN_RUNS)


@dataclass(frozen=True, eq=False)
class Column:
    """An estimate with its replicates."""

    values: Array  # the estimate, then its replicates, shape (1 + replicates, ...)
    kind: Kind  # decides the scale on which the estimate is nearly normal
    counts: Array  # observations that the estimate rests on, of the shape of one row; of a `rate`, the number of images
    # Factor of a share's variance by noise that persists, at least; replicates cannot tell it for what happened once.
    inflation: float | Array = 1.0
    known: bool = True  # whether an interval of it holds the truth as often as it says

    @property
    def estimate(self) -> Array:
        """The first row of the values, shape (...)."""
        first: Array = self.values[0]
        return first

    @property
    def independent(self) -> Array:
        """Number of independent observations that spread like the replicates of a share or a rate, shape (...)."""
        value, count = self.estimate, np.maximum(self.counts, _MIN_SPREAD)
        alone = value / count if self.kind == "rate" else value * (1 - value) / count
        variance = spread(self.values[1:]) ** 2
        inflation = np.where(alone > 0, np.maximum(variance / np.maximum(alone, 1e-300), 1.0), 1.0)
        return count / np.maximum(inflation, self.inflation)

    def interval(self, level: float, units: int) -> tuple[Array, Array]:
        """Both ends of confidence intervals of a level such as 0.95, each of the shape of one row, by Student's
        distribution, as few units leave the spread uncertain. NaN where an interval would not hold what it says."""
        if not self.known or (units < MIN_UNITS and self.kind not in ("share", "rate")):
            return np.full(np.shape(self.estimate), np.nan), np.full(np.shape(self.estimate), np.nan)
        wide = float(special.stdtrit(max(units - 1, 1), (1 + level) / 2))
        widen, tail = (wide / float(special.ndtri((1 + level) / 2))) ** 2, (1 - level) / 2
        if self.kind in ("share", "rate"):
            return self._counted(widen, tail)
        centre = to_scale(self.estimate, self.kind)
        reach = wide * spread(to_scale(self.values[1:], self.kind))
        low, high = from_scale(centre - reach, self.kind), from_scale(centre + reach, self.kind)
        if self.kind == "capped":
            low, high = np.clip(low, 0, 1), np.clip(high, 0, 1)
        if self.kind == "fraction":  # nor do they where everything or nothing is right
            at_end = (self.estimate <= 0) | (self.estimate >= 1)
            counted_low, counted_high = self._counted(widen, tail)
            low, high = np.where(at_end, counted_low, low), np.where(at_end, counted_high, high)
        return low, high

    def content(self, level: float, units: int) -> dict[str, float]:
        """The estimate and both ends of its interval for JSON, of a column of one number."""
        low, high = self.interval(level, units)
        return {"value": float(self.estimate), "low": float(low), "high": float(high)}

    def _counted(self, widen: float, tail: float) -> tuple[Array, Array]:
        """Jeffreys's intervals for as many independent observations as the spread of the replicates implies."""
        value, trials = self.estimate, self.independent / widen
        quantile = jeffreys_rate if self.kind == "rate" else jeffreys_share
        with np.errstate(all="ignore"):
            low, high = (quantile(value, trials, p) for p in (tail, 1 - tail))
        if self.kind != "rate":
            high = np.where(value >= 1, 1.0, high)
        return np.where(value <= 0, 0.0, np.minimum(low, value)), np.maximum(high, value)


def ratio(part: Array, whole: Array) -> Array:
    """Quotients of arrays whose shapes broadcast; NaN where the whole is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0, part / whole, np.nan)


def spread(replicates: Array) -> Array:
    """Standard deviation over finite replicates (replicates, ...), shape (...); infinite if there are under two."""
    finite = np.isfinite(replicates)
    number = finite.sum(axis=0)
    filled = np.where(finite, replicates, 0.0)
    squares = np.where(finite, (replicates - filled.sum(axis=0) / np.maximum(number, 1)) ** 2, 0.0).sum(axis=0)
    return np.where(number > 1, np.sqrt(squares / np.maximum(number - 1, 1)), np.inf)


def widened(values: Array, least: Array) -> Array:
    """Replicates (1 + replicates, ...) that spread at least as a standard error (...) from theory."""
    if len(values) == 1:
        return values
    std = spread(values[1:])
    usable = np.isfinite(std) & (std > 0) & np.isfinite(least)
    factor = np.where(usable, np.maximum(least / np.where(usable, std, 1.0), 1.0), 1.0)
    return np.asarray(values[0] + factor * (values - values[0]))


Scale = tuple[Callable[[Array], Array], Callable[[Array], Array]]
_PLAIN: Scale = (lambda x: x, lambda x: x)
_LOGIT: Scale = (lambda x: special.logit(np.clip(x, 1e-9, 1 - 1e-9)), special.expit)
_LOGARITHM: Scale = (lambda x: np.log(np.maximum(x, 1e-12)), np.exp)
_SCALES: dict[Kind, Scale] = {  # to the scale on which an estimate of each kind is nearly normal, and back
    "share": _LOGIT,
    "fraction": _LOGIT,
    "mean": _PLAIN,
    "capped": _PLAIN,
    "positive": _LOGARITHM,
    "rate": _LOGARITHM,
    "above_two": (lambda x: np.log(np.maximum(x - 2, 1e-12)), lambda x: 2 + np.exp(x)),
    "correlation": (lambda x: np.arctanh(np.clip(x, -1 + 1e-9, 1 - 1e-9)), np.tanh),
}


def to_scale(values: Array, kind: Kind) -> Array:
    """Numbers of any shape on the scale of their kind."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return _SCALES[kind][0](values)


def from_scale(values: Array, kind: Kind) -> Array:
    """Numbers of any shape back from the scale of their kind."""
    with np.errstate(over="ignore"):
        return _SCALES[kind][1](values)


# ---- Entries of a detector file with their estimates ----

T = TypeVar("T")


@dataclass(frozen=True)
class Key:
    """Place of an entry in a detector file."""

    names: tuple[str, ...]  # keys of the file, outermost first; within the section of the state if there is one
    state: str | None = None  # name of the performance state; None for an entry that all states share
    axes: tuple[tuple[str, ...], ...] = ()  # names of the places along each axis; places are numbered if empty
    remark: str = ""  # what a reader of the number must know, such as its unit
    own_table: bool = False  # whether reports show the entry in a table of its own

    @property
    def path(self) -> str:
        """The keys with dots between, for reports."""
        return ".".join((*(() if self.state is None else ("states", self.state)), *self.names))

    def at(self, place: tuple[int, ...]) -> str:
        """The name of one number of the entry, for reports."""
        if self.axes:
            brackets = f"[{' from '.join(names[k] for names, k in zip(self.axes, place, strict=True))}]"
        else:
            brackets = "".join(f"[{k}]" for k in place)
        return f"{self.path}{brackets}{f' ({self.remark})' if self.remark else ''}"


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of a detector file: a number, vector or matrix."""

    key: Key
    column: Column

    @property
    def estimate(self) -> Array:
        """The number, in the shape of the entry."""
        return self.column.estimate


@dataclass(frozen=True, eq=False)
class Interval:
    """An entry with both ends of its confidence interval, arrays of one shape."""

    key: Key
    estimate: Array
    low: Array
    high: Array


def entries_of(value: object) -> Iterator[Entry]:
    """All entries in a dataclass, its fields and tuples of them, in their order."""
    if isinstance(value, Entry):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from entries_of(part)
    elif is_dataclass(value):
        for field in fields(value):
            yield from entries_of(getattr(value, field.name))


def with_entries(value: T, change: Callable[[Entry], Entry]) -> T:
    """A copy of a dataclass in which every entry is replaced by what `change` makes of it."""
    return cast(T, _changed(value, change))


def _changed(value: Any, change: Callable[[Entry], Entry]) -> Any:
    if isinstance(value, Entry):
        return change(value)
    if isinstance(value, tuple):
        return tuple(_changed(part, change) for part in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _changed(getattr(value, field.name), change) for field in fields(value)})
    return value


def digits(value: Any) -> float:
    """A number in the six digits that are written."""
    return float(f"{float(value):.6g}")


def nested(values: Array) -> Any:
    """An array of any shape as nested lists of numbers in six digits; a number if it has no axes."""
    return digits(values) if np.ndim(values) == 0 else [nested(row) for row in values]


def columns_of_one(matrix: Array) -> Any:
    """An array of shape (n, ...) as lists whose columns sum to one as written: the largest takes the rounding error."""
    clean = np.clip(np.array(matrix, dtype=np.float64), 0, 1)
    rounded = np.round(clean / clean.sum(axis=0), 7)
    columns = rounded.reshape(len(rounded), -1)
    largest = columns.argmax(axis=0), np.arange(columns.shape[1])
    columns[largest] += 1 - columns.sum(axis=0)
    return np.round(columns.reshape(rounded.shape), 7).tolist()
