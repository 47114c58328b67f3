"""Box errors as they come out: the normal law cut down to the errors that leave a box in the image, box by box.

An error counts only if the box, moved and clipped to the image, is at least a pixel wide and high. Along each axis
that is three straight conditions on shift and growth, so one at a time the four errors have plain bounds: growth in
width and height, then shift in x and y given the growth. Genz (1992) integrates a normal law over such bounds by
drawing each error within its own; nothing is rejected, and every point has its weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.stats import qmc

from modsim3d.arrays import Array

POINTS = 128
"""Points of a low-discrepancy sequence for each box, shifted for each box by an amount of its own (Cranley & Patterson,
1976), so that integration errors are as independent between boxes as the errors of the boxes, and far smaller."""
_ROWS_AT_ONCE = 512
_ORDER = np.array([2, 3, 0, 1])  # e_w, e_h, e_x, e_y
_LEAST_SIDE_PX = 1.0


@dataclass(frozen=True, eq=False)
class Accepted:
    """Points of the truncated law of some boxes.

    Attributes:
        rows: Which boxes.
        errors: In the order e_x, e_y, e_w, e_h, shape (rows, points, 4).
        weights: Sum to one over the points, shape (rows, points).
        acceptance: Probability that a first draw counts, shape (rows,).
    """

    rows: slice
    errors: Array
    weights: Array
    acceptance: Array

    def mean(self, values: Array) -> Array:
        """Expectation of values of shape (rows, points, k), shape (rows, k)."""
        result: Array = np.einsum("np,npk->nk", self.weights, values)
        return result


def accepted_errors(
    boxes_px: Array, images_px: Array, mean: Array, covariance: Array, points: int = POINTS
) -> Iterator[Accepted]:
    """Points of the truncated law of every box, some rows at a time.

    Args:
        boxes_px: What the errors are added to, at least a pixel wide and high, shape (n, 4).
        images_px: Width and height of each box's image, shape (n, 2).
        mean: Of the law before it is cut, e_x, e_y, e_w, e_h, shape (4,) or (n, 4).
        covariance: Shape (4, 4) or (n, 4, 4).
        points: For each box, a power of two.
    """
    means = np.broadcast_to(mean, (len(boxes_px), 4))
    roots = np.broadcast_to(ordered_root(covariance), (len(boxes_px), 4, 4))
    sequence = qmc.Sobol(4, rng=np.random.default_rng(0)).random(points)
    generator = np.random.default_rng(1)
    for start in range(0, len(boxes_px), _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, len(boxes_px)))
        shifts = generator.random((rows.stop - start, 1, 4))
        yield _draw(rows, boxes_px[rows], images_px[rows], means[rows], roots[rows], (sequence + shifts) % 1)


def ordered_root(covariance: Array) -> Array:
    """Lower triangular L with L·Lᵀ the covariance in drawing order; zero columns where an error is determined."""
    matrix = np.asarray(covariance)[..., _ORDER[:, None], _ORDER]
    root = np.zeros_like(matrix)
    scale = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
    for j in range(4):
        left = matrix[..., j, j] - (root[..., j, :j] ** 2).sum(axis=-1)
        free = left > 1e-10 * scale[..., j]
        diagonal = np.sqrt(np.where(free, left, 1))
        root[..., j, j] = np.where(free, diagonal, 0)
        for i in range(j + 1, 4):
            rest = matrix[..., i, j] - (root[..., i, :j] * root[..., j, :j]).sum(axis=-1)
            root[..., i, j] = np.where(free, rest / diagonal, 0)
    return root


def _draw(rows: slice, boxes: Array, images: Array, means: Array, roots: Array, uniforms: Array) -> Accepted:
    x0, y0, x1, y1 = (boxes[:, i, None] for i in range(4))
    width, height = images[:, :1], images[:, 1:]
    count, points = uniforms.shape[:2]
    standard = np.zeros((count, points, 4))
    errors = np.empty((count, points, 4))
    chance = np.ones((count, points))
    unbounded = np.full((count, 1), np.inf)
    for j, component in enumerate(_ORDER):
        given = means[:, component, None] + np.einsum("npk,nk->np", standard[..., :j], roots[:, j, :j])
        growth_w, growth_h = errors[..., 2], errors[..., 3]
        low: Array
        high: Array
        if component == 2:
            low, high = _LEAST_SIDE_PX - (x1 - x0), unbounded
        elif component == 3:
            low, high = _LEAST_SIDE_PX - (y1 - y0), unbounded
        elif component == 0:
            low, high = _LEAST_SIDE_PX - x1 - growth_w / 2, width - _LEAST_SIDE_PX - x0 + growth_w / 2
        else:
            low, high = _LEAST_SIDE_PX - y1 - growth_h / 2, height - _LEAST_SIDE_PX - y0 + growth_h / 2
        spread = roots[:, j, j, None]
        standard[..., j], inside = _within(low - given, high - given, spread, uniforms[..., j])
        errors[..., component] = given + spread * standard[..., j]
        chance *= inside
    acceptance = chance.mean(axis=1)
    weights = chance / np.where(acceptance > 0, acceptance, 1)[:, None] / points
    return Accepted(rows, errors, weights, acceptance)


def _within(low: Array, high: Array, spread: Array, uniforms: Array) -> tuple[Array, Array]:
    """Standard normal numbers between bounds given in units of 1 / spread, and the probability between them."""
    fixed = spread <= 0
    scale = np.where(fixed, 1, spread)
    # A determined error has a whole pixel's rounding to either side of what the detector allows.
    a = np.where(fixed, np.where(low <= 1e-9, -np.inf, np.inf), low / scale)
    b = np.where(fixed, np.where(high >= -1e-9, np.inf, -np.inf), high / scale)
    mirror = a > 0  # the lower tail is the accurate one
    first, second = np.where(mirror, -b, a), np.where(mirror, -a, b)
    below, above = special.ndtr(first), special.ndtr(second)
    inside = np.maximum(above - below, 0)
    z = special.ndtri(below + uniforms * inside)
    z = np.where(inside > 0, np.where(mirror, -z, z), 0)
    return np.where(fixed, 0, z), inside
