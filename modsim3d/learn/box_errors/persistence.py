"""Persistence of box errors: errors of the same thing in consecutive frames, over edges that nothing has cut. Which
edges count is decided by the true box alone, since leaving errors out by their size would itself cut them: an edge
counts if it lies so far inside the image that hardly any error reaches the border."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.learn import lags, persistence
from modsim3d.learn.bootstrap import Entry, Key, Resampling, digits, nested
from modsim3d.learn.box_errors.matched_edges import OUTWARD, ErrorModel
from modsim3d.learn.matches import Outcomes, Pairs

_ROUNDS = 4  # rounds in which a correlation time and what follows from it settle
_STEPS_NEEDED = 20  # steps within a state that its errors are whitened from, instead of from the distribution
_MIN_CHANGE = 1e-6
_REACH = 3.0  # an edge counts if it is so many standard deviations inside the border; sides shrink by fewer to a pixel
_EDGES = 2 ** np.arange(4)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Rows of a thing in consecutive frames, sums of powers of two of edges that count in both, time between, (m,)."""

    earlier: Indices
    later: Indices
    edges: Indices
    apart_s: Array


@dataclass(frozen=True, eq=False)
class WhiteErrors:
    """Errors of boxes of which every edge counts, as uncorrelated numbers of variance one."""

    rows: Indices  # their annotations, shape (n,)
    white: Array  # the errors, shape (n, 4)
    state: Indices  # state of each, shape (n,)
    heavy: Mask  # whether a state's errors have heavy tails, so that `white` has directions alone, shape (states,)


def consecutive_errors(observed: Outcomes, models: Sequence[ErrorModel | None]) -> persistence.Consecutive:
    """Whitened box errors in consecutive frames, given the distribution in each state, None where there is none.
    Products are means over as many components as edges count in both frames."""
    return _settled(observed, tuple(models))[0]


def white_errors(observed: Outcomes, models: Sequence[ErrorModel | None]) -> WhiteErrors:
    """Errors of boxes of which every edge counts, whitened as in `consecutive_errors`."""
    pairs, (_, shapes) = observed.pairs, _settled(observed, tuple(models))
    kept = np.flatnonzero(_clear_edges(pairs, models).all(axis=1))
    white = _whitened(pairs, models, shapes, kept, np.arange(4))
    return WhiteErrors(pairs.rows[kept], white, pairs.state[kept], _heavy(models))


def _heavy(models: Sequence[ErrorModel | None]) -> Mask:
    return np.array([model is not None and model.heavy for model in models], dtype=bool)


@functools.lru_cache(1)
def _settled(
    observed: Outcomes, models: tuple[ErrorModel | None, ...]
) -> tuple[persistence.Consecutive, Sequence[Array | None]]:
    """Errors in consecutive frames, and the correlation of each state's standardised errors by which they are whitened,
    kept, as what is learned of one set asks for the same several times. It is that of changes from frame to frame,
    which are independent of each other, where few errors that persist would tell it poorly and look less alike. It
    depends on the correlation time: both are found in a few rounds."""
    pairs = observed.pairs
    patterns = _clear_edges(pairs, models) @ _EDGES
    kept = np.flatnonzero(patterns)
    all_steps = persistence.steps_between(observed.labelled, pairs.rows[kept])
    a, b = kept[all_steps.earlier], kept[all_steps.later]
    common = patterns[a] & patterns[b]
    both = common > 0
    steps = _Steps(a[both], b[both], common[both], all_steps.apart_s[both])
    shapes = [None if model is None else model.correlation for model in models]
    identity = observed.labelled.annotations.identity[pairs.rows[kept]]
    stretches = persistence.stretches_of(observed.labelled.images, pairs.image[kept], identity, pairs.state[kept])
    result, counts = _products(pairs, models, shapes, steps)
    heavy = _heavy(models)[pairs.state[steps.later]]
    result = replace(result, stretches=stretches)
    for _ in range(_ROUNDS if len(result) else 0):
        correlation = np.exp(-steps.apart_s / max(result.rough_time_s(), 1e-9))
        left = np.where(heavy, correlation_left(correlation, counts), 1.0)
        shapes = _shapes_of_changes(pairs, models, steps, correlation * left)
        result, _ = _products(pairs, models, shapes, steps)
        result = replace(result, expected=result.expected * left, stretches=stretches)
    return result, shapes


def _products(
    pairs: Pairs, models: Sequence[ErrorModel | None], shapes: Sequence[Array | None], steps: _Steps
) -> tuple[persistence.Consecutive, Indices]:
    """Products of errors whitened by the given correlation of each state, and how many edges count, shape (m,)."""
    products, expected = np.zeros(len(steps.later)), np.zeros(len(steps.later))
    counts = np.zeros(len(steps.later), dtype=np.int64)
    for pattern in np.unique(steps.edges):
        rows, edges = np.flatnonzero(steps.edges == pattern), np.flatnonzero(pattern & _EDGES)
        boxes, place = np.unique([steps.earlier[rows], steps.later[rows]], return_inverse=True)
        first, second = _whitened(pairs, models, shapes, boxes, edges)[place.reshape(2, -1)]
        products[rows], expected[rows] = (first * second).mean(axis=1), (first**2).mean(axis=1)
        counts[rows] = len(edges)
    return persistence.Consecutive(products, expected, steps.apart_s, pairs.image[steps.later]), counts


def _shapes_of_changes(
    pairs: Pairs, models: Sequence[ErrorModel | None], steps: _Steps, correlation: Array
) -> list[Array | None]:
    """Covariance of standardised errors in each state, from changes of those with all edges; of the model if few."""
    shapes: list[Array | None] = []
    whole = steps.edges == _EDGES.sum()
    for state, model in enumerate(models):
        in_state = whole & (pairs.state[steps.earlier] == state) & (pairs.state[steps.later] == state)
        if model is None or in_state.sum() < _STEPS_NEEDED:
            shapes.append(None if model is None else model.correlation)
            continue
        before, after = (_standard(pairs, model, end[in_state]) for end in (steps.earlier, steps.later))
        change = after - correlation[in_state, None] * before
        change /= np.sqrt(np.maximum(1 - correlation[in_state] ** 2, _MIN_CHANGE))[:, None]
        shapes.append(change.T @ change / len(change))
    return shapes


def _standard(pairs: Pairs, model: ErrorModel, rows: Indices) -> Array:
    """Errors of some boxes with mean zero and variance one, shape (m, 4)."""
    mean, std = model.at(pairs.edges.sides_px[rows])
    return (pairs.edges.errors_px[rows] - mean) / std


def correlation_left(correlation: Array, numbers: Indices) -> Array:
    """Mean cosine between two normal vectors of so many numbers, over their correlation, shape (n,)."""
    d = np.asarray(numbers, dtype=np.float64)
    scale = np.exp(2 * (special.gammaln((d + 1) / 2) - special.gammaln(d / 2))) * 2 / d
    return np.asarray(scale * special.hyp2f1(0.5, 0.5, d / 2 + 1, correlation**2))


def _clear_edges(pairs: Pairs, models: Sequence[ErrorModel | None]) -> Mask:
    """Mask of the edges that count, shape (m, 4)."""
    edges = pairs.edges
    clear = np.zeros((len(pairs), 4), dtype=bool)
    for state, model in enumerate(models):
        rows = np.flatnonzero((pairs.state == state) & edges.usable)
        if model is None or not len(rows):
            continue
        mean, std = model.at(edges.sides_px[rows])
        std = std * model.core
        scaled = OUTWARD * std[:, None]
        spread = np.sqrt(np.einsum("mij,jk,mik->mi", scaled, model.correlation, scaled))
        inside = mean @ OUTWARD.T + _REACH * spread <= edges.inward_px[rows]
        large = edges.sides_px[rows, 2:] + mean[:, 2:] - _REACH * std[:, 2:] >= 1
        clear[rows] = inside & edges.counted[rows] & np.all(large, axis=1, keepdims=True)
    return clear


def _whitened(
    pairs: Pairs, models: Sequence[ErrorModel | None], shapes: Sequence[Array | None], rows: Indices, chosen: Indices
) -> Array:
    """Some edges of some boxes as uncorrelated numbers of variance one, (m, k), given the correlations of each state's
    errors. Of heavy tails only the direction: lengths would hide how the normal numbers behind them persist."""
    edges, white = pairs.edges, np.zeros((len(rows), len(chosen)))
    for state, (model, shape) in enumerate(zip(models, shapes, strict=True)):
        group = np.flatnonzero(pairs.state[rows] == state)
        if model is None or shape is None or not len(group):
            continue
        mean, std = model.at(edges.sides_px[rows[group]])
        scaled = OUTWARD[chosen] * std[:, None]
        values, vectors = np.linalg.eigh(scaled @ shape @ np.swapaxes(scaled, 1, 2))
        moved = edges.outward_px[rows[group]][:, chosen] - mean @ OUTWARD[chosen].T
        turned = np.einsum("mji,mj->mi", vectors, moved) / np.sqrt(np.maximum(values, 1e-300))
        numbers = np.einsum("mij,mj->mi", vectors, turned)
        if model.heavy:
            numbers *= np.sqrt(len(chosen)) / np.maximum(np.linalg.norm(numbers, axis=1, keepdims=True), 1e-300)
        white[group] = numbers
    return white


# ---- The memory of each component of a box error ----

MEMORY_COMPONENTS = (*ERROR_COMPONENTS, "size of errors")
_ALIKE_P = 1e-3  # chance below which components that all last alike would differ so much


@dataclass(frozen=True, eq=False)
class ComponentMemory:
    """Shares of the numbers behind e_x, e_y, e_w, e_h and the size of heavy-tailed errors, (c,) and (parts, c)."""

    vessel_share: Entry
    shares: Entry
    times_s: tuple[float, ...]

    def section(self) -> dict[str, Any]:
        """The memory in a detector file."""
        return {
            "vessel_share": nested(np.floor(self.vessel_share.estimate * 1e6) / 1e6),
            "shares": nested(np.floor(self.shares.estimate * 1e6) / 1e6),
            "times_s": [digits(time_s) for time_s in self.times_s],
        }


def component_lags(observed: Outcomes, models: Sequence[ErrorModel | None]) -> tuple[list[lags.LagTable], float]:
    """Products at all times between of components, and of the size of heavy-tailed errors; share of large ones."""
    pairs = observed.pairs
    rows = np.flatnonzero(_clear_edges(pairs, models).all(axis=1))
    latent, large = np.zeros((len(rows), 4)), np.zeros(len(rows), dtype=bool)
    state = pairs.state[rows]
    for index, model in enumerate(models):
        group = np.flatnonzero(state == index)
        if model is None or not len(group):
            continue
        latent[group], large[group] = model.latent(_standard(pairs, model, rows[group]))
        ranks = np.argsort(np.argsort(latent[group], axis=0), axis=0)
        latent[group] = special.ndtri((ranks + 0.5) / len(group))  # what Student's t does not explain must not decide
    size = large - np.bincount(state, large)[state] / np.maximum(np.bincount(state), 1)[state]
    numbers = [*latent.T, size] if large.any() else [*latent.T]

    def compare(number: Array) -> lags.Compare:
        return lambda earlier, later: (number[earlier] * number[later], (number[earlier] ** 2 + number[later] ** 2) / 2)

    tables = [lags.LagTable.of(observed.labelled, pairs.rows[rows], state, compare(number)) for number in numbers]
    return tables, float(large.mean()) if len(rows) else 0.0


def components_differ(tables: Sequence[lags.LagTable]) -> bool:
    """Whether the four components clearly last differently long, by mean correlations over all lags, less their mean,
    and their covariance when single things are left out."""
    first = tables[0]
    if first.things < lags.THINGS_NEEDED or len(first.lag_s) < 3 or not np.any(first.same > 0):
        return False
    one = Resampling(np.ones((1, int(first.image.max()) + 1)), np.zeros(0, dtype=np.int64))
    means = np.array([np.average(table.ratios(one)[0], weights=table.weight) for table in tables[:4]])
    left_out = np.array([np.average(table.ratios_without_each(), axis=1, weights=table.weight) for table in tables[:4]])
    apart, strays = means[:3] - means[3], left_out[:3] - left_out[3]
    count = strays.shape[1]
    distance = float(apart @ np.linalg.pinv(np.cov(strays, bias=True) * (count - 1)) @ apart)
    return bool(special.fdtrc(3, count - 3, distance * (count - 3) / (3 * (count - 1))) < _ALIKE_P)


def component_memory(tables: Sequence[lags.LagTable], large: float, resampling: Resampling) -> ComponentMemory:
    """Shares of each component with replicates."""
    latent = lags.latent_share(np.full(2, large)) if len(tables) > 4 else None
    columns = []
    for k, table in enumerate(tables):
        times_s, column = lags.memory_shares(table, latent if k == 4 and latent is not None else np.asarray, resampling)
        columns.append(column)
    joined = np.stack([column.values for column in columns], axis=-1)
    names = MEMORY_COMPONENTS[: len(tables)]
    path = ("persistence", "box")
    kept, shares = (lags.replace_values(columns[0], values) for values in (joined[:, 0], joined[:, 1:]))
    return ComponentMemory(
        Entry(Key((*path, "vessel_share"), axes=(names,)), kept),
        Entry(Key((*path, "shares"), axes=(lags.in_seconds(times_s), names)), shares),
        tuple(times_s.tolist()),
    )
