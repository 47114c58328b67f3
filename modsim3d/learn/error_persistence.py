"""How box errors persist: errors of the same thing in consecutive frames, over edges that nothing has cut.

Which edges count is decided by the true box alone, since leaving errors out by their size would itself cut them: an
edge counts if it lies so far inside the image that hardly any error reaches the border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.error_model import ErrorModel
from modsim3d.learn.matched_edges import OUTWARD
from modsim3d.learn.observed import Observed
from modsim3d.learn.pairs import Pairs
from modsim3d.learn.persistence_fit import Consecutive, steps_between

_ROUNDS = 4
"""Rounds in which a correlation time and what it leaves of the correlation settle."""
_REACH = 3.0
"""An edge counts if it is so many standard deviations inside the border; sides shrink by fewer to a pixel."""
_EDGES = 2 ** np.arange(4)


def consecutive_errors(observed: Observed, models: Sequence[ErrorModel | None]) -> Consecutive:
    """Whitened box errors in consecutive frames, given the distribution in each state, None where there is none.

    Products are means over as many components as edges count in both frames.
    """
    pairs = observed.pairs
    patterns = _clear_edges(pairs, models) @ _EDGES
    kept = np.flatnonzero(patterns)
    steps = steps_between(observed.labelled, pairs.rows[kept])
    a, b = kept[steps.earlier], kept[steps.later]
    common = patterns[a] & patterns[b]
    both = common > 0
    a, b, common, apart_s = a[both], b[both], common[both], steps.apart_s[both]
    products, expected, counts = np.zeros(len(a)), np.zeros(len(a)), np.zeros(len(a), dtype=np.int64)
    for pattern in np.unique(common):
        rows, edges = np.flatnonzero(common == pattern), np.flatnonzero(pattern & _EDGES)
        first, second = (_whitened(pairs, models, each[rows], edges) for each in (a, b))
        products[rows], expected[rows] = (first * second).mean(axis=1), (first**2).mean(axis=1)
        counts[rows] = len(edges)
    found = Consecutive(products, expected, apart_s, pairs.image[b])
    is_heavy: Mask = np.array([model is not None and model.heavy for model in models], dtype=bool)
    heavy = is_heavy[pairs.state[b]]
    if not heavy.any():
        return found
    for _ in range(_ROUNDS):
        correlation = np.exp(-apart_s / max(found.rough_time_s(), 1e-9))
        left = np.where(heavy, correlation_left(correlation, counts), 1.0)
        found = replace(found, expected=expected * left)
    return found


def correlation_left(correlation: Array, numbers: Indices) -> Array:
    """Mean cosine between two normal vectors of so many numbers, over their correlation, shape (n,)."""
    d = np.asarray(numbers, dtype=np.float64)
    scale = np.exp(2 * (special.gammaln((d + 1) / 2) - special.gammaln(d / 2))) * 2 / d
    left: Array = scale * special.hyp2f1(0.5, 0.5, d / 2 + 1, correlation**2)
    return left


def _clear_edges(pairs: Pairs, models: Sequence[ErrorModel | None]) -> Mask:
    """Which edges count, shape (m, 4)."""
    edges = pairs.edges
    clear = np.zeros((len(pairs), 4), dtype=bool)
    for state, model in enumerate(models):
        rows = np.flatnonzero((pairs.state == state) & edges.usable)
        if model is None or not len(rows):
            continue
        mean, std = model.at(edges.sides_px[rows])
        if model.heavy:
            std = std * np.sqrt((model.freedom - 2) / model.freedom)  # but for the tails
        scaled = OUTWARD * std[:, None]
        spread = np.sqrt(np.einsum("mij,jk,mik->mi", scaled, model.correlation, scaled))
        inside = mean @ OUTWARD.T + _REACH * spread <= edges.inward_px[rows]
        large = edges.sides_px[rows, 2:] + mean[:, 2:] - _REACH * std[:, 2:] >= 1
        clear[rows] = inside & edges.counted[rows] & np.all(large, axis=1, keepdims=True)
    return clear


def _whitened(pairs: Pairs, models: Sequence[ErrorModel | None], rows: Indices, chosen: Indices) -> Array:
    """Some edges of some boxes as uncorrelated numbers of variance one, shape (m, k).

    Of heavy tails only the direction: lengths would hide how the normal numbers behind them persist.
    """
    edges, white = pairs.edges, np.zeros((len(rows), len(chosen)))
    for state, model in enumerate(models):
        ours = np.flatnonzero(pairs.state[rows] == state)
        if model is None or not len(ours):
            continue
        mean, std = model.at(edges.sides_px[rows[ours]])
        scaled = OUTWARD[chosen] * std[:, None]
        values, vectors = np.linalg.eigh(scaled @ model.correlation @ np.swapaxes(scaled, 1, 2))
        moved = edges.outward_px[rows[ours]][:, chosen] - mean @ OUTWARD[chosen].T
        turned = np.einsum("mji,mj->mi", vectors, moved) / np.sqrt(np.maximum(values, 1e-300))
        found = np.einsum("mij,mj->mi", vectors, turned)
        if model.heavy:
            found *= np.sqrt(len(chosen)) / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)
        white[ours] = found
    return white
