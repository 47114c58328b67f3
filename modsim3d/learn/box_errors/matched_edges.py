"""The edges of matched boxes, and what each says about the error of the box. One that the detector put on the image's
border, where the true one lies inside, is censored: it would lie there or beyond. One whose truth is cut by the border
is left out, because many detectors put it exactly on the border. All others are known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy import optimize, special

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.formats.matching import Rule

CUT_PX = 2.0  # a true edge so close to the border counts as cut by it
_ON_BORDER_PX = 0.5
_WHOLE_NEEDED = 10
OUTWARD = np.array([[-1, 0, 0.5, 0], [0, -1, 0, 0.5], [1, 0, 0.5, 0], [0, 1, 0, 0.5]])
"""How far each edge lies outside the true one, from e_x, e_y, e_w, e_h."""
ERRORS = np.linalg.inv(OUTWARD)  # e_x, e_y, e_w, e_h from how far each edge lies outside the true one


@dataclass(frozen=True, eq=False)
class MatchedEdges(Columns):
    """Edges of n matched boxes in the order x_min, y_min, x_max, y_max."""

    truth_px: Array  # the true box, shape (n, 4)
    outward_px: Array  # how far each detected edge lies outside the true one, of a censored edge at least, shape (n, 4)
    known: Mask  # which edges are known, shape (n, 4)
    censored: Mask  # which edges are censored; those that are neither are left out, shape (n, 4)
    least_px: Array  # least x and y of each image, −∞ where boxes are not clipped, shape (n, 2)
    most_px: Array  # greatest x and y, shape (n, 2)
    rule: Rule  # the rule by which the boxes match
    image: Indices  # image of each, shape (n,)

    @classmethod
    def of(cls, truth_px: Array, found_px: Array, image_px: Array, image: Indices, rule: Rule) -> MatchedEdges:
        """Edges of detected boxes (n, 4) and their true ones, in images of a size (n, 2), NaN where unknown."""
        size = np.where(np.isnan(image_px), np.inf, image_px)
        inward = np.concatenate([truth_px[:, :2], size - truth_px[:, 2:]], axis=1)
        inward[np.isnan(image_px[:, 0])] = np.inf
        outward = np.concatenate([truth_px[:, :2] - found_px[:, :2], found_px[:, 2:] - truth_px[:, 2:]], axis=1)
        clips = not np.any(outward - inward > _ON_BORDER_PX)  # some detectors put boxes partly outside the image
        cut = inward <= CUT_PX
        censored = ~cut & (outward >= inward - _ON_BORDER_PX) & clips
        limited = np.isfinite(image_px) & clips
        return cls(
            truth_px,
            np.where(censored, inward - _ON_BORDER_PX, outward),
            ~cut & ~censored,
            censored,
            np.where(limited, 0.0, -np.inf),
            np.where(limited, size, np.inf),
            rule,
            image,
        )

    def without(self, boxes: Mask) -> MatchedEdges:
        """Edges without those of some boxes (n,)."""
        kept = ~boxes[:, None]
        return replace(self, known=self.known & kept, censored=self.censored & kept)

    def as_measured(self) -> MatchedEdges:
        """All boxes with every edge known as it was measured, and nothing cut off by the rule."""
        every, none = np.ones_like(self.known), np.full_like(self.least_px, np.inf)
        return replace(self, known=every, censored=~every, least_px=-none, most_px=none, rule=Rule("provenance"))

    @cached_property
    def sides_px(self) -> Array:
        """Width, height, width, height of the true box, at least a pixel, shape (n, 4)."""
        return np.tile(np.maximum(self.truth_px[:, 2:] - self.truth_px[:, :2], 1.0), 2)

    @cached_property
    def usable(self) -> Mask:
        """Mask of the boxes with information: at least a pixel wide and high, and an edge in the image, shape (n,)."""
        large = np.all(self.truth_px[:, 2:] - self.truth_px[:, :2] >= 1, axis=1)
        return np.asarray(large & self.counted.any(axis=1))

    @cached_property
    def counted(self) -> Mask:
        """Mask of the edges that are not left out, shape (n, 4)."""
        return self.known | self.censored

    @cached_property
    def whole(self) -> Mask:
        """Mask of the boxes with no edge left out, shape (n,)."""
        return self.usable & self.counted.all(axis=1)

    @cached_property
    def alike(self) -> tuple[tuple[Indices, MatchedEdges], ...]:
        """Boxes with the same edges known and censored together, with their rows."""
        pattern = (self.known + 2 * self.censored) @ 3 ** np.arange(4)
        groups = [np.flatnonzero(pattern == code) for code in np.unique(pattern)]
        return tuple((rows, self.take(rows)) for rows in groups)

    @cached_property
    def unclipped(self) -> Mask:
        """Mask of the boxes with all edges known; of those with none left out, or of all, where these are few."""
        unclipped: Mask = self.whole & self.known.all(axis=1)
        if unclipped.sum() >= _WHOLE_NEEDED:
            return unclipped
        return self.whole if self.whole.any() else np.ones(len(self), dtype=bool)

    @cached_property
    def errors_px(self) -> Array:
        """e_x, e_y, e_w, e_h as measured, shape (n, 4)."""
        return self.outward_px @ ERRORS.T

    @cached_property
    def inward_px(self) -> Array:
        """Distance by which the border lies outside each true edge, infinite where nothing is clipped, shape (n, 4)."""
        return np.concatenate([self.truth_px[:, :2] - self.least_px, self.most_px - self.truth_px[:, 2:]], axis=1)

    def passes(self, outward_px: Array) -> Mask:
        """Whether boxes with edges so far outside the true ones, (n, p, 4), would match, (n, p): at least a pixel wide
        and high once clipped to the image."""
        # Seen from the true box's corner, so that numbers stay small: 0 to side is the true box.
        inward, sides = self.inward_px[..., None], self.sides_px[..., None]
        shifts: list[Array] = []
        common = box_area = own = np.ones((len(self), 1))
        passes: Mask = np.ones(outward_px.shape[:2], dtype=bool)
        for k in range(2):  # axis by axis, which is faster than sums and products over an axis of length 2
            side = sides[:, k]
            low = -np.minimum(outward_px[..., k], inward[:, k])
            high = side + np.minimum(outward_px[..., k + 2], inward[:, k + 2])
            # What lies beyond the opposite border is clipped away as well.
            low = np.minimum(low, side + inward[:, k + 2])
            high = np.maximum(high, -inward[:, k])
            passes &= high - low >= 1 - 1e-9
            if self.rule.method == "centre":
                shifts.append((low + high - side) / 2)
            elif self.rule.method != "provenance":
                common = common * np.maximum(np.minimum(high, side) - np.maximum(low, 0), 0)
                box_area, own = box_area * np.maximum(high - low, 0), own * side
        if self.rule.method == "centre":
            passes &= np.hypot(*shifts) <= self.rule.most_distance_px
        elif self.rule.method != "provenance":
            passes &= common >= min(self.rule.least_iou, 1 - 1e-10) * (box_area + own - common)
        return passes

    def surely_passes(self, most_px: Array) -> Mask:
        """Whether boxes match if no edge is farther off than (n, 4), either way; clipping brings edges nearer; (n,)."""
        inside = (self.inward_px >= 0).all(axis=1)
        side, off = self.sides_px[:, :2], most_px[:, :2] + most_px[:, 2:]
        sure: Mask = inside & np.all(side - off >= 1, axis=1)
        if self.rule.method == "centre":
            sure &= np.hypot(*(off.T / 2)) <= self.rule.most_distance_px
        elif self.rule.method != "provenance":
            least = min(self.rule.least_iou, 1 - 1e-10)
            sure &= np.prod(side - off, axis=1) >= least * np.prod(side + off, axis=1)
        return sure


# ---- Numbers of a distribution of box errors ----

Unit = Literal["px", "relative", "mixed"]
MIN_DEGREES, MAX_DEGREES = 2.5, 200.0  # bounds of ν: 2 has no covariance, more than 200 is as good as normal
_FIRST, _SECOND = (np.array(column) for column in zip(*ERROR_PAIRS, strict=True))
_MAX_ARTANH = 4.0
_MEANS, _STDS, _PAIRS, _FREEDOM = slice(0, 4), slice(4, 8), slice(8, 14), 14


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Normal errors, or Student's t ones where ν is finite; see `BoxErrorLaw`."""

    mean: Array  # in pixels, or in sides of the box if relative, shape (4,)
    std: Array  # in the same unit, shape (4,)
    correlation: Array  # shape (4, 4)
    unit: Unit = "px"  # what standard deviations follow
    growth: Array = field(default_factory=lambda: np.zeros(4))  # growth of standard deviations with the side, (4,)
    freedom: float = np.inf  # degrees of freedom ν; infinite for normal errors
    floor: Array = field(default_factory=lambda: np.zeros(4))  # least standard deviation that a fit goes to, shape (4,)

    @classmethod
    def of_moments(cls, mean: Array, covariance: Array, unit: Unit, freedom: float = np.inf) -> ErrorModel:
        """From a mean (4,) and a covariance (4, 4) with positive variances."""
        std = np.sqrt(np.diag(covariance))
        return cls(mean, std, covariance / np.outer(std, std), unit, freedom=freedom)

    @property
    def heavy(self) -> bool:
        """Whether it is Student's t."""
        return bool(np.isfinite(self.freedom))

    @property
    def core(self) -> float:
        """Spread of the errors but for their tails, over the standard deviations."""
        return float(np.sqrt((self.freedom - 2) / self.freedom)) if self.heavy else 1.0

    def latent(self, standard: Array) -> tuple[Array, Mask]:
        """Normal numbers behind standardised errors (n, 4) as well as tails leave them known, and which are large (n,):
        of Student's t those beyond its ninth decile."""
        numbers = standard @ np.linalg.inv(symmetric_root(self.correlation)).T
        if not self.heavy:
            return numbers, np.zeros(len(numbers), dtype=bool)
        q = (numbers**2).sum(axis=1)
        return numbers * np.sqrt((self.freedom + 4) / (self.freedom - 2 + q))[:, None], q > np.quantile(q, 0.9)

    @property
    def covariance(self) -> Array:
        """Covariance as the file has it: without the growth of mixed errors, shape (4, 4)."""
        return self.correlation * np.outer(self.std, self.std)

    def at(self, sides_px: Array) -> tuple[Array, Array]:
        """Means and standard deviations in pixels for boxes of width, height, width, height (n, 4), shapes (n, 4)."""
        if self.unit == "relative":
            return self.mean * sides_px, self.std * sides_px
        return np.broadcast_to(self.mean, sides_px.shape), self.std + self.growth * sides_px

    def statistics(self, standard: Array) -> Array:
        """Terms of the slopes, given standardised errors (..., 4), shape (..., 14 or 15), with mean zero. Values and
        products, with the weights of the distribution, and the slope by ln(ν − 2)."""
        solved = standard @ np.linalg.inv(self.correlation)
        products = solved * standard
        q = products[..., 0] + products[..., 1] + products[..., 2] + products[..., 3]  # twice as fast as a sum of four
        weight = np.ones_like(q)
        if self.heavy:
            nu = self.freedom
            weight = (nu + 4) / (nu - 2 + q)
        weighted = weight[..., None] * solved
        terms = [
            weighted,
            weighted * standard - 1,
            weighted[..., _FIRST] * solved[..., _SECOND] - np.linalg.inv(self.correlation)[_FIRST, _SECOND],
        ]
        if self.heavy:
            constant = (special.digamma(nu / 2 + 2) - special.digamma(nu / 2)) / 2 - 2 / (nu - 2)
            slope = constant - np.log1p(q / (nu - 2)) / 2 + weight * q / (nu - 2) / 2
            terms.append((slope * (nu - 2))[..., None])
        return np.concatenate(terms, axis=-1)

    def mean_statistics(self, standard: Array, weights: Array) -> Array:
        """Means of `statistics` of points (m, p, 4) with weights (m, p) that sum to one, shape (m, 14 or 15)."""
        precision = np.linalg.inv(self.correlation)
        weighted = weights
        if self.heavy:
            nu = self.freedom
            solved = (standard.reshape(-1, 4) @ precision).reshape(standard.shape)
            q = np.einsum("mpi,mpi->mp", solved, standard)
            weight = (nu + 4) / (nu - 2 + q)
            weighted = weights * weight
        first = np.einsum("mp,mpi->mi", weighted, standard) @ precision
        second = precision @ (np.swapaxes(standard * weighted[..., None], 1, 2) @ standard)
        terms = [
            first,
            np.diagonal(second, axis1=1, axis2=2) - 1,
            (second @ precision)[:, _FIRST, _SECOND] - precision[_FIRST, _SECOND],
        ]
        if self.heavy:
            constant = (special.digamma(nu / 2 + 2) - special.digamma(nu / 2)) / 2 - 2 / (nu - 2)
            part = (weight * q / (nu - 2) - np.log1p(q / (nu - 2))) / 2
            terms.append((constant + (weights * part).sum(axis=1))[:, None] * (nu - 2))
        return np.concatenate(terms, axis=-1)

    @property
    def places(self) -> Indices:
        """Index of the statistic for each number's slope, shape (p,): means, ln σ, artanh ρ, growth, ln(ν − 2)."""
        growth = range(4, 8) if self.unit == "mixed" else ()
        return np.array([*range(14), *growth, *([_FREEDOM] if self.heavy else [])])

    def gains(self, sides_px: Array) -> Array:
        """Factors that turn the statistics of each box into slopes, given width, height, width, height, (n, p)."""
        _, std_px = self.at(sides_px)
        gains = np.ones((len(sides_px), len(self.places)))
        gains[:, _MEANS] = (sides_px if self.unit == "relative" else 1.0) / std_px
        gains[:, _PAIRS] = 1 - self.correlation[_FIRST, _SECOND] ** 2
        if self.unit == "mixed":
            gains[:, _STDS] = self.std / std_px
            gains[:, 14:18] = sides_px / std_px
        return gains

    def numbers(self) -> Array:
        """Means, ln σ, artanh ρ, growth if mixed, ln(ν − 2) if finite, shape (p,)."""
        growth: Array = self.growth if self.unit == "mixed" else np.empty(0)
        freedom = [np.log(self.freedom - 2)] if self.heavy else []
        correlations = np.arctanh(np.clip(self.correlation[_FIRST, _SECOND], -0.9999, 0.9999))
        return np.concatenate([self.mean, np.log(self.std), correlations, growth, freedom])

    def held(self, score: Array) -> Mask:
        """Mask of the numbers at a bound that the likelihood's slopes, shape (p,), push them against, shape (p,)."""
        held = np.zeros(len(score), dtype=bool)
        if self.unit == "mixed":
            held[_STDS] = (self.std <= self.floor) & (score[_STDS] <= 0)
            held[14:18] = (self.growth <= 0) & (score[14:18] <= 0)
        if self.heavy:
            low, high = self.freedom <= MIN_DEGREES * (1 + 1e-9), self.freedom >= MAX_DEGREES * (1 - 1e-9)
            held[-1] = (low and score[-1] < 0) or (high and score[-1] > 0)
        return held

    def with_numbers(self, numbers: Array) -> ErrorModel:
        """Distribution with other numbers, shape (p,), held where a distribution has them."""
        correlation = np.eye(4)
        values = np.tanh(np.clip(numbers[_PAIRS], -_MAX_ARTANH, _MAX_ARTANH))
        correlation[_FIRST, _SECOND] = correlation[_SECOND, _FIRST] = values
        return replace(
            self,
            mean=numbers[_MEANS],
            std=np.maximum(np.exp(numbers[_STDS]), self.floor),
            correlation=_definite(correlation),
            growth=np.maximum(numbers[14:18], 0.0) if self.unit == "mixed" else self.growth,
            freedom=float(np.clip(2 + np.exp(numbers[-1]), MIN_DEGREES, MAX_DEGREES)) if self.heavy else np.inf,
        )


def _definite(correlation: Array) -> Array:
    """A correlation matrix, or one near it where a step has left what correlations can be."""
    values, vectors = np.linalg.eigh(correlation)
    if values[0] >= 1e-6:
        return correlation
    nearest = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    scale = np.sqrt(np.diag(nearest))
    return np.asarray(nearest / np.outer(scale, scale))


# ---- Student's t distribution of four components by maximum likelihood ----

_STEPS, _ENOUGH = 500, 1e-6
_MIN_SHARE = 1e-6


class StudentTFit(NamedTuple):
    """A t distribution: mean (4,), covariance (4, 4) of the distribution itself, and degrees of freedom."""

    mean: Array
    covariance: Array
    degrees_of_freedom: float


def fit_student_t(errors: Array) -> StudentTFit | None:
    """The likeliest t distribution of errors, shape (n, 4), with ν between the bounds; None where they determine none.
    Each step weighs errors by (ν + 4) / (ν + q), with q by the scatter matrix, for mean and scatter, and then maximises
    the likelihood over ν."""
    mean, scatter, nu, last = errors.mean(axis=0), np.cov(errors.T, bias=True), 10.0, -np.inf
    least = _MIN_SHARE * np.linalg.eigvalsh(scatter)
    for _ in range(_STEPS):
        values = np.linalg.eigvalsh(scatter)
        if values[0] <= max(least[0], 1e-12 * values[-1]):
            return None  # so many errors are equal that the likelihood has no maximum
        weight = (nu + 4) / (nu + _squared_lengths(errors - mean, scatter))
        mean = weight @ errors / weight.sum()
        moved = errors - mean
        scatter = (weight[:, None] * moved).T @ moved / len(errors)
        nu, value = _likeliest_degrees(_squared_lengths(moved, scatter))
        value -= len(errors) * float(np.linalg.slogdet(scatter)[1]) / 2
        if value - last < _ENOUGH:
            break
        last = value
    return StudentTFit(mean, scatter * nu / (nu - 2), nu)


def may_be_heavy(errors: Array) -> bool:
    """Whether the likelihood of errors, shape (n, 4), rises as ν falls from infinity, as Mardia's kurtosis says."""
    covariance = np.cov(errors.T, bias=True)
    if np.linalg.cond(covariance) > 1e12:
        return False
    return bool(np.mean(_squared_lengths(errors - errors.mean(axis=0), covariance) ** 2) > 4 * 6)


def _squared_lengths(moved: Array, matrix: Array) -> Array:
    """xᵀ M⁻¹ x of vectors (n, 4), shape (n,)."""
    return np.asarray(np.einsum("ni,ni->n", moved, np.linalg.solve(matrix, moved.T).T))


def _likeliest_degrees(q: Array) -> tuple[float, float]:
    """ν and its log-likelihood but for the scatter's share, given q by the scatter matrix, shape (n,)."""

    def loss(logarithm: float) -> float:
        nu = np.exp(logarithm)
        constant = special.gammaln(nu / 2 + 2) - special.gammaln(nu / 2) - 2 * np.log(np.pi * nu)
        return float((nu / 2 + 2) * np.log1p(q / nu).sum() - len(q) * constant)

    bounds = np.log(MIN_DEGREES), np.log(MAX_DEGREES)
    minimum = optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(np.exp(minimum.x)), -float(minimum.fun)
