"""How long misses and box errors stay with a thing, from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.resampling import Resampling

PAIRS_NEEDED = 200
"""Of consecutive sightings, before a correlation time is looked for."""
MISSES_NEEDED = 30
_GRID = 96


@dataclass(frozen=True, eq=False)
class Steps:
    """Consecutive rows of the same thing.

    Attributes:
        earlier: Places among the rows given, shape (m,).
        later: Likewise.
        apart_s: Time between, shape (m,).
    """

    earlier: Indices
    later: Indices
    apart_s: Array

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.earlier)


def steps_between(labelled: LabelledSet, rows: Indices) -> Steps:
    """Pairs of rows of the truth that follow each other, of things with an identity in frames with times.

    Args:
        labelled: The sets.
        rows: Of the truth, shape (n,).
    """
    truth, images = labelled.annotations, labelled.images
    image = truth.image[rows]
    time = images.time_s[image]
    known = np.flatnonzero((truth.identity[rows] >= 0) & np.isfinite(time))
    keys = images.sequence[image[known]], truth.identity[rows[known]]
    order = known[np.lexsort((time[known], keys[1], keys[0]))]
    earlier, later = order[:-1], order[1:]
    same = (truth.identity[rows[earlier]] == truth.identity[rows[later]]) & (
        images.sequence[image[earlier]] == images.sequence[image[later]]
    )
    apart = time[later] - time[earlier]
    same &= apart > 0
    return Steps(earlier[same], later[same], apart[same])


def frame_interval_s(labelled: LabelledSet) -> float:
    """Median time between frames; NaN where images do not follow one another."""
    order = np.lexsort((labelled.images.time_s, labelled.images.sequence))
    gaps = np.diff(labelled.images.time_s[order])
    same = np.diff(labelled.images.sequence[order]) == 0
    gaps = gaps[same & np.isfinite(gaps) & (gaps > 0)]
    return float(np.median(gaps)) if len(gaps) else float("nan")


def correlation_time(resampling: Resampling, image: Indices, products: Array, expected: Array, apart_s: Array) -> Array:
    """τ for which the expected products, times e^(−Δt/τ), sum to what the products sum to.

    Args:
        resampling: Weights of images.
        image: Of each pair, shape (m,).
        products: Of residuals that persist together, shape (m,).
        expected: Of the products if nothing changed between, shape (m,).
        apart_s: Shape (m,).

    Returns:
        In seconds, shape (rows,): 0 where there is no correlation; at most a thousand times the median gap.
    """
    gap = float(np.median(apart_s))
    grid = gap * np.geomspace(0.05, 1000, _GRID)
    if np.ptp(apart_s) < 1e-6 * gap:
        sums = resampling.sums(image, np.column_stack([products, expected]))
        curve = sums[:, 1:] * np.exp(-gap / grid)
    else:
        decayed = expected[:, None] * np.exp(-apart_s[:, None] / grid)
        sums = resampling.sums(image, np.column_stack([products, decayed]))
        curve = sums[:, 1:]
    wanted = sums[:, 0]
    result = np.zeros(len(wanted))
    for row, (value, levels) in enumerate(zip(wanted, curve, strict=True)):
        if value > 0:
            result[row] = np.exp(np.interp(value, levels, np.log(grid)))
    return result


def relative_error(products: Array, expected: Array, apart_s: Array, time_s: float) -> float:
    """Standard error of τ over τ, from how much each pair strays from what those before it lead to expect.

    Given its past, a product is expected to be e^(−Δt/τ) of its residual's square, so that what remains of it is
    independent of what remains of others, whatever persists; and there are many more pairs than runs of frames.
    """
    gap = float(np.median(apart_s))
    kept = float(np.exp(-gap / time_s))
    stray = np.sqrt(((products - kept * expected) ** 2).sum()) / expected.sum()
    return float(stray / kept * time_s / gap)
