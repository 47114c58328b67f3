"""What the matching rule cuts off: how likely a box is to pass it, and the mean slopes of those that do.

A box whose error makes it fail the rule is missing from the matches. The likelihood of a match is therefore that of its
error over the probability of passing. Both need an integral over all errors for each true box. It is taken at points of
Sobol's sequence for a sample of the boxes, each for those that are most like it in size and distance to the border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.box_error_fits.error_model import ErrorModel
from modsim3d.learn.box_error_fits.matched_edges import OUTWARD, MatchedEdges

_BOXES, _POINTS = 512, 64
_POINTS_FOR_EACH = 8
_SCREENED_AT_ONCE, _STRETCH = 4096, 1.5
_NEAR_SHARE = 0.25
_LEAST_PASSING = 1e-3
_LEVELS = np.linspace(-7, 7, 1025)


@dataclass(frozen=True, eq=False)
class Gate:
    """The matching rule over those of n boxes that may fail it.

    Attributes:
        sample: The boxes over which is integrated.
        normal: Standard normal numbers of their points, shape (b, p, 5).
        stands: Which of the sample stands for each of n boxes, −1 for those that hardly ever fail, shape (n,).
    """

    sample: MatchedEdges
    normal: Array
    stands: Indices

    @classmethod
    def of(cls, edges: MatchedEdges, model: ErrorModel) -> Gate | None:
        """The rule over boxes with errors that are about like those of a distribution; None if they hardly ever fail.

        At most a few hundred are sampled, evenly over boxes in the order of shape, size and distance to the border.
        """
        stretched = replace(model, std=_STRETCH * model.std, growth=_STRETCH * model.growth)
        risky = np.zeros(len(edges), dtype=bool)
        for first in range(0, len(edges), _SCREENED_AT_ONCE):
            screened = np.arange(first, min(first + _SCREENED_AT_ONCE, len(edges)))
            risky[screened] = _may_fail(stretched, edges[screened])
        rows = np.flatnonzero(risky)
        if not len(rows):
            return None
        ours = edges[rows]
        near = (ours.inward_px < _NEAR_SHARE * ours.sides_px) @ 2 ** np.arange(4)
        width, height = ours.sides_px[:, 0], ours.sides_px[:, 1]
        order = rows[np.lexsort((width / height, np.round(2 * np.log2(width * height)), near))]
        number = min(len(order), _BOXES)
        chosen = order[((np.arange(number) + 0.5) * len(order) / number).astype(np.int64)]
        stands = np.full(len(edges), -1)
        stands[order] = np.arange(len(order)) * number // len(order)
        wanted = max(_BOXES * _POINTS, _POINTS_FOR_EACH * len(order)) / number
        return cls(
            edges[chosen], normal_points(number, 1 << int(np.log2(np.clip(wanted, _POINTS, 16 * _POINTS)))), stands
        )

    @property
    def boxes(self) -> int:
        """How many boxes may fail."""
        return int(np.count_nonzero(self.stands >= 0))

    def passing(self, model: ErrorModel) -> tuple[Array, Array]:
        """Log-probability to pass of each box, shape (n,), and mean statistics of what fails over it, (n, s)."""
        standard = drawn(model, self.normal)
        fails = _fails(model, self.sample, standard)
        chance = np.maximum(1 - fails.mean(axis=1), _LEAST_PASSING)
        box, point = np.nonzero(fails)
        found = model.statistics(standard[box, point])
        sums = np.stack([np.bincount(box, each, minlength=len(chance)) for each in found.T], axis=1)
        lost = sums / fails.shape[1] / chance[:, None]
        return np.append(np.log(chance), 0.0)[self.stands], np.vstack([lost, np.zeros(lost.shape[1])])[self.stands]


@cache
def sobol(number: int, width: int) -> Array:
    """Scrambled points of Sobol's sequence, a power of two of them, shape (number, width)."""
    from scipy.stats import qmc  # slow to import

    points: Array = qmc.Sobol(width, rng=np.random.default_rng(0)).random(number)
    return points


def normal_points(boxes: int, number: int) -> Array:
    """Normal numbers from Sobol's sequence, shifted for each box by an amount of its own, (boxes, number, 5)."""
    return _points_of(1 << (boxes - 1).bit_length(), number)[:boxes]


@lru_cache(maxsize=8)
def _points_of(boxes: int, number: int) -> Array:
    shifted = (sobol(number, 5) + np.random.default_rng(3).random((boxes, 1, 5))) % 1
    points: Array = special.ndtri(np.clip(shifted, 1e-12, 1 - 1e-12))
    points.flags.writeable = False
    return points


def drawn(model: ErrorModel, normal: Array) -> Array:
    """Standardised errors (..., 4) from normal numbers (..., 5), the last of which gives the scale of heavy tails."""
    values, vectors = np.linalg.eigh(model.correlation)
    standard: Array = normal[..., :4] @ ((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)
    if model.heavy:
        chi_square = 2 * special.gammaincinv(model.freedom / 2, special.ndtr(_LEVELS))
        scales = np.interp(normal[..., 4], _LEVELS, np.sqrt((model.freedom - 2) / chi_square))
        standard = standard * scales[..., None]
    return standard


def _may_fail(model: ErrorModel, edges: MatchedEdges) -> Mask:
    """Whether some point of each box fails, shape (n,)."""
    standard = drawn(model, normal_points(len(edges), _POINTS))
    mean, std = model.at(edges.sides_px)
    largest = np.abs(mean) + std * np.maximum(standard.max(axis=1), -standard.min(axis=1))
    rows = np.flatnonzero(~edges.surely_passes(largest @ np.abs(OUTWARD).T))
    risky = np.zeros(len(edges), dtype=bool)
    risky[rows] = _fails(model, edges[rows], standard[rows]).any(axis=1)
    return risky


def _fails(model: ErrorModel, edges: MatchedEdges, standard: Array) -> Mask:
    """Whether boxes with standardised errors (n, p, 4) fail, shape (n, p)."""
    mean, std = model.at(edges.sides_px)
    return ~edges.passes((mean[:, None] + std[:, None] * standard) @ OUTWARD.T)
