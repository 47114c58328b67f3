"""Box errors as they come out: the law truncated to the errors that leave a box in the image, box by box. An error
counts only if the box, moved and clipped to the image, is at least a pixel wide and high. Along each axis that is three
linear conditions on shift and growth, so one at a time the four errors have plain bounds: growth in width and height,
then shift in x and y given the growth. Genz (1992), "Numerical computation of multivariate normal probabilities",
integrates a normal law over such bounds by drawing each error within its own; nothing is rejected, and every point has
its weight. Distributions that are normal with a random scale are integrated over the scale as well."""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask, read_only
from modsim3d.core.boxes import at_least_a_pixel, sizes
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.draws import ERROR_NORMALS, ErrorDistribution, Normal

# ---- Scrambled points of Sobol's sequence ----

_BITS = 30
_POLYNOMIALS = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)))
"""Degree, inner coefficients as bits, and first direction numbers, of each dimension after the first."""
MAX_DIMENSIONS = 1 + len(_POLYNOMIALS)


def sobol_points(dimensions: int, count: int, generator: np.random.Generator) -> Array:
    """The first `count` points of a scrambled sequence, in [0, 1), shape (count, dimensions); `count` is a power of
    two, `dimensions` at most `MAX_DIMENSIONS`. The generator draws the scrambling, as `qmc.Sobol` does with the
    generator that it spawns from the one it is given."""
    powers = 2 ** np.arange(_BITS, dtype=np.uint32)
    shift = generator.integers(2, size=(dimensions, _BITS), dtype=np.uint32) @ powers
    matrices = np.tril(generator.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32), -1)
    matrices[:, range(_BITS), range(_BITS)] = 1
    bits = _direction_numbers(dimensions)[..., None] >> np.arange(_BITS, dtype=np.uint32)[::-1] & 1
    # The highest bit comes first in rows of matrices and in `bits`.
    directions = (np.einsum("dpk,djk->djp", matrices, bits) & 1) @ powers[::-1]
    points = shift[None]
    for column in directions.T[: count.bit_length() - 1]:  # in the order of Gray's code
        points = np.concatenate([points, points[::-1] ^ column])
    return points / 2.0**_BITS


def _direction_numbers(dimensions: int) -> NDArray[np.uint32]:
    """Direction numbers as fractions of 2 ** _BITS, shape (dimensions, _BITS)."""
    columns = [[1] * _BITS]
    for degree, inner, first in _POLYNOMIALS[: dimensions - 1]:
        numbers = list(first)
        for k in range(degree, _BITS):
            number = numbers[k - degree] ^ (numbers[k - degree] << degree)
            for i in range(1, degree):
                if inner >> (degree - 1 - i) & 1:
                    number ^= numbers[k - i] << i
            numbers.append(number)
        columns.append(numbers)
    return np.array([[number << (_BITS - 1 - k) for k, number in enumerate(row)] for row in columns], dtype=np.uint32)


POINTS = 128
"""Points of Sobol's sequence for each box, each with a shift of its own (Cranley & Patterson, 1976), so that
integration errors are as independent between boxes as the errors of the boxes, and far smaller."""
SINGLE_BOX_POINTS = 4096
"""Points where the moments of one box count, and not a sum over many boxes. Against 3 million draws for boxes of
Simulation 1's sizes and at the edges, in all of the thesis's states, means are off by less than 0.005 of a standard
deviation and standard deviations by less than 0.8 %; with 1024 points by 0.021 and 2.3 %."""
_POINTS_AT_ONCE, _POINTS_IN_CACHE = 1 << 16, 1 << 14
_ORDER = np.array([2, 3, 0, 1])  # e_w, e_h, e_x, e_y
_MIN_SIDE_PX = 1.0
_LOWER_TAIL, _NOT_SMALL, _UPPER_TAIL = -13.0, -1.0, 8.5
_ROUNDING_PX, _NO_SPREAD, _MIN_UNIFORM = 1e-9, 1e-30, 1e-50
_PARTS_KEPT = 2  # as many as a sample of one state has
_NORMAL = Normal()


@dataclass(frozen=True, eq=False)
class AcceptedErrors:
    """Points of the truncated law of some rows of boxes."""

    rows: slice
    errors: Array  # in the order e_x, e_y, e_w, e_h, shape (rows, points, 4)
    weights: Array  # sum to one over the points, shape (rows, points)
    acceptance: Array  # probability that a first draw counts, shape (rows,)

    def mean(self, values: Array) -> Array:
        """Expectation of values of shape (rows, points, k), shape (rows, k)."""
        return np.asarray(np.einsum("np,npk->nk", self.weights, values))


def accepted_errors(
    boxes_px: Array,
    images_px: Array,
    mean: Array,
    covariance: Array,
    distribution: ErrorDistribution = _NORMAL,
    points: int = POINTS,
    at_once: int = _POINTS_AT_ONCE,
) -> Iterator[AcceptedErrors]:
    """Points of the truncated law of every box, (n, 4), at least a pixel wide and high in images (n, 2), some rows at a
    time. `mean` and `covariance` are those of errors before truncation in pixels, (4,) or (n, 4), and px², (4, 4) or
    (n, 4, 4). `points` for each box is a power of two. The points do not depend on how many are made `at_once`."""
    means = np.broadcast_to(mean, (len(boxes_px), 4))
    roots = np.broadcast_to(ordered_root(covariance), (len(boxes_px), 4, 4))
    width = ERROR_NORMALS + distribution.extra_normals
    rows_at_once = max(1, at_once // points)
    for start in range(0, len(boxes_px), rows_at_once):
        rows = slice(start, min(start + rows_at_once, len(boxes_px)))
        numbers = width, points, start, rows.stop
        uniforms = _uniforms(*numbers)
        # One scale for all points if it is not random: what is then the same for them is worked out once.
        drawn = uniforms[ERROR_NORMALS:] if distribution.extra_normals else uniforms[ERROR_NORMALS:, :, :1]
        scales = distribution.scales(special.ndtri(np.moveaxis(drawn, 0, -1)))
        normals = functools.partial(_normals, *numbers)
        yield _draw(rows, boxes_px[rows], images_px[rows], means[rows], roots[rows], uniforms, normals, scales)


@functools.lru_cache(_PARTS_KEPT)
def _uniforms(width: int, points: int, start: int, stop: int) -> Array:
    """Uniform numbers of rows start to stop − 1, shape (width, rows, points): the same whatever their boxes are."""
    bits = np.random.PCG64(1)
    bits.advance(start * width)
    uniforms = _sobol(width, points)[:, None] + np.random.Generator(bits).random((stop - start, width)).T[..., None]
    uniforms -= uniforms >= 1
    uniforms.setflags(write=False)
    return uniforms


@functools.lru_cache(_PARTS_KEPT * ERROR_NORMALS)
def _normals(width: int, points: int, start: int, stop: int, error: int) -> Array:
    """Standard normal numbers of one error from those uniform numbers, shape (rows, points)."""
    normals: Array = special.ndtri(np.maximum(_uniforms(width, points, start, stop)[error], _MIN_UNIFORM))
    normals.setflags(write=False)
    return normals


@functools.cache
def _sobol(width: int, points: int) -> Array:
    """Points of a scrambled sequence in the unit cube, shape (width, points)."""
    return read_only(np.ascontiguousarray(sobol_points(width, points, np.random.default_rng(0).spawn(1)[0]).T))


def ordered_root(covariance: Array) -> Array:
    """Lower triangular L with L·Lᵀ the covariance of e_w, e_h, e_x, e_y, shapes (..., 4, 4). A column is zero where an
    error is determined by those before it."""
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


def _draw(
    rows: slice,
    boxes: Array,
    images: Array,
    means: Array,
    roots: Array,
    uniforms: Array,
    normals: Callable[[int], Array],
    scales: Array,
) -> AcceptedErrors:
    """Draw one error after the other within its bounds, given those before it. Uniforms have shape (4 or more, rows,
    points); `normals` gives the standard normal numbers of one of the first four. Scales have shape (rows, points) or,
    if they are the same for all points, (rows, 1)."""
    points = uniforms.shape[-1]
    standard: list[Array] = []
    errors = np.empty((4, len(means), points))
    chance = np.ones((len(means), points))
    for j, component in enumerate(_ORDER):
        correlated = [roots[:, j, k, None] * standard[k] for k in range(j) if roots[:, j, k].any()]
        given, spread = means[:, component, None] + scales * sum(correlated), scales * roots[:, j, j, None]
        growth = errors[2 + component % 2] if component < 2 else means[:, component, None]
        far = _far_from_bounds(component, boxes, images, growth, given, spread)
        drawn = normals(j).copy() if far.any() else np.empty(chance.shape)
        if not far.all():
            near = np.flatnonzero(~far) if far.any() else slice(None)  # a slice copies nothing
            bounds = _bounds(component, boxes[near], images[near], growth[near], given[near])
            drawn[near], inside = _within(*bounds, spread[near], uniforms[j, near])
            chance[near] *= inside
        standard.append(drawn)
        np.add(given, spread * drawn, out=errors[component])
    acceptance = chance.mean(axis=1)
    weights = chance / np.where(acceptance > 0, acceptance, 1)[:, None] / points
    return AcceptedErrors(rows, np.moveaxis(errors, 0, -1), weights, acceptance)


def _bounds(component: int, boxes: Array, images: Array, growth: Array, given: Array) -> tuple[Array, Array]:
    """Least and greatest error of a component that leaves a pixel, less what is given, (n, 1) or (n, points) each.
    Growth along the component's axis bounds a shift; growth itself has a lower bound only."""
    axis = component % 2
    first, last = boxes[:, axis, None], boxes[:, 2 + axis, None]
    if component >= 2:
        return _MIN_SIDE_PX - (last - first) - given, np.full((len(boxes), 1), np.inf)
    half, image = growth / 2, images[:, axis, None]
    return _MIN_SIDE_PX - last - half - given, image - _MIN_SIDE_PX - first + half - given


def _far_from_bounds(component: int, boxes: Array, images: Array, growth: Array, given: Array, spread: Array) -> Mask:
    """Mask of the boxes so far from the bounds of a component that these do not count at any point, shape (n,). Of
    growth, of what is given and of spread, (n, 1) or (n, points), only the extremes that come closest are looked at."""
    extremes = np.stack([given.min(axis=1), given.max(axis=1)], axis=1)
    low, high = _bounds(component, boxes, images, growth.min(axis=1, keepdims=True), extremes)
    most, least = spread.max(axis=1), spread.min(axis=1)
    return np.asarray((low[:, 0] < _LOWER_TAIL * most) & (high[:, -1] > _UPPER_TAIL * most) & (least > 0))


def _within(low: Array, high: Array, spread: Array, uniforms: Array) -> tuple[Array, Array]:
    """Standard normal numbers between bounds given in units of 1 / spread, and the probability between them."""
    fixed = spread <= 0
    # A determined error has a whole pixel's rounding to either side of what the detector allows.
    scale, slack = np.where(fixed, _NO_SPREAD, spread), np.where(fixed, _ROUNDING_PX, 0.0)
    a, b = (low - slack) / scale, (high + slack) / scale
    mirrored = a > 0  # the lower tail is the accurate one
    if mirrored.any():
        a, b = np.where(mirrored, -b, a), np.where(mirrored, -a, b)
    below, above = _probabilities(a, b)
    inside = np.maximum(above - below, 0)
    z = special.ndtri(below + uniforms * inside)
    np.negative(z, out=z, where=mirrored)
    np.copyto(z, 0, where=fixed | (inside == 0))
    return z, inside


def _probabilities(low: Array, high: Array) -> tuple[Array, Array]:
    """Probabilities below standard normal numbers, each of shape (n, points), or (n, 1) if that says as much. A row
    that lies wholly in a tail needs only one number: all are 1 in the upper tail; in the lower one all are too small to
    count, neither in a sum with a uniform number nor in the difference from a probability that is not small."""
    least = high.min(axis=1)
    far_below, far_above = (low.max(axis=1) < _LOWER_TAIL) & (least > _NOT_SMALL), least > _UPPER_TAIL
    return _probability(low, ~far_below), _probability(high, ~far_above)


def _probability(z: Array, rows: Mask) -> Array:
    """Probability below each number of some rows, shape (n,), and in the other rows below the greatest."""
    if rows.all():
        return np.asarray(special.ndtr(z))
    probability: Array = special.ndtr(z.max(axis=1))[:, None]
    if rows.any():
        probability = np.repeat(probability, z.shape[1], axis=1)
        probability[rows] = special.ndtr(z[rows])
    return probability


@dataclass(frozen=True, eq=False)
class TruncatedErrors:
    """Distribution of the errors of n boxes after degenerate draws were resampled."""

    accepted: Array  # share of first draws that count, shape (n,)
    means: Array  # shape (n, 4)
    second_moments: Array  # mean of e·eᵀ, shape (n, 4, 4)

    def covariances(self) -> Array:
        """Covariance of the errors of each box, shape (n, 4, 4)."""
        return self.second_moments - self.means[:, :, None] * self.means[:, None, :]


def truncated_errors(
    source: BoxErrorSource,
    state: int,
    boxes_px: Array,
    image_size_px: tuple[int, int],
    *,
    in_file_units: bool = False,
    points: int = SINGLE_BOX_POINTS,
) -> TruncatedErrors:
    """Errors of annotated boxes, shape (n, 4), in one state, without those that make degenerate boxes. They are in
    pixels or, with `in_file_units`, in the units of the file. `points` is a power of two. The result has the share of
    first draws that count, shape (n,), and means and second moments of e_x, e_y, e_w, e_h, shapes (n, 4), (n, 4, 4)."""
    accepted, means, seconds = np.empty(len(boxes_px)), np.empty((len(boxes_px), 4)), np.empty((len(boxes_px), 4, 4))
    truth = at_least_a_pixel(boxes_px, image_size_px)
    states: Indices = np.full(len(truth), state)
    images = np.tile(np.array(image_size_px, dtype=np.float64), (len(truth), 1))
    law = source.moments_px(states, sizes(truth))
    for part in accepted_errors(truth, images, *law, source.distributions[state], points, _POINTS_IN_CACHE):
        errors, rows = part.errors, part.rows
        if in_file_units:
            errors = source.in_file_units(states[rows], sizes(truth[rows]), errors)
        accepted[rows], means[rows] = part.acceptance, part.mean(errors)
        by_component = np.swapaxes(errors, 1, 2)  # the order in memory
        seconds[rows] = by_component @ np.swapaxes(part.weights[:, None] * by_component, 1, 2)
    return TruncatedErrors(accepted, means, seconds)
