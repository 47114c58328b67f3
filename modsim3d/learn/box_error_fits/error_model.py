"""Numbers of a distribution of box errors, and the slopes of its log-density, in a form that a fit can move."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.model import ERROR_PAIRS

Unit = Literal["px", "relative", "mixed"]
LEAST_DEGREES, MOST_DEGREES = 2.1, 200.0
"""Bounds of ν: with 2 there is no covariance; with more than 200 the distribution is as good as normal."""
_FIRST, _SECOND = (np.array(each) for each in zip(*ERROR_PAIRS, strict=True))
_MOST_ARTANH = 4.0
_MEANS, _STDS, _PAIRS, _FREEDOM = slice(0, 4), slice(4, 8), slice(8, 14), 14


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Normal errors, or Student's t ones where ν is finite; see `BoxErrorLaw`.

    Attributes:
        mean: In pixels, or in sides of the box if relative, shape (4,).
        std: In the same unit, shape (4,).
        correlation: Shape (4, 4).
        unit: What standard deviations follow.
        growth: By how much mixed standard deviations grow with the side, shape (4,).
        freedom: Degrees of freedom ν; infinite for normal errors.
        floor: Least standard deviation that a fit goes to, shape (4,).
    """

    mean: Array
    std: Array
    correlation: Array
    unit: Unit = "px"
    growth: Array = field(default_factory=lambda: np.zeros(4))
    freedom: float = np.inf
    floor: Array = field(default_factory=lambda: np.zeros(4))

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
    def covariance(self) -> Array:
        """Of the file: without the growth of mixed errors, shape (4, 4)."""
        return self.correlation * np.outer(self.std, self.std)

    def at(self, sides_px: Array) -> tuple[Array, Array]:
        """Means and standard deviations in pixels for boxes of width, height, width, height (n, 4), shapes (n, 4)."""
        if self.unit == "relative":
            return self.mean * sides_px, self.std * sides_px
        return np.broadcast_to(self.mean, sides_px.shape), self.std + self.growth * sides_px

    def statistics(self, standard: Array) -> Array:
        """What the slopes are sums of, given standardised errors (..., 4), shape (..., 14 or 15), with mean zero.

        Values and products, with the weights of the distribution, and the slope by ln(ν − 2).
        """
        solved = standard @ np.linalg.inv(self.correlation)
        q = (solved * standard).sum(axis=-1)
        weight = np.ones_like(q)
        if self.heavy:
            nu = self.freedom
            weight = (nu + 4) / (nu - 2 + q)
        weighted = weight[..., None] * solved
        found = [
            weighted,
            weighted * standard - 1,
            weighted[..., _FIRST] * solved[..., _SECOND] - np.linalg.inv(self.correlation)[_FIRST, _SECOND],
        ]
        if self.heavy:
            constant = (special.digamma(nu / 2 + 2) - special.digamma(nu / 2)) / 2 - 2 / (nu - 2)
            slope = constant - np.log1p(q / (nu - 2)) / 2 + weight * q / (nu - 2) / 2
            found.append((slope * (nu - 2))[..., None])
        return np.concatenate(found, axis=-1)

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
        found = [
            first,
            np.diagonal(second, axis1=1, axis2=2) - 1,
            (second @ precision)[:, _FIRST, _SECOND] - precision[_FIRST, _SECOND],
        ]
        if self.heavy:
            constant = (special.digamma(nu / 2 + 2) - special.digamma(nu / 2)) / 2 - 2 / (nu - 2)
            each = (weight * q / (nu - 2) - np.log1p(q / (nu - 2))) / 2
            found.append((constant + (weights * each).sum(axis=1))[:, None] * (nu - 2))
        return np.concatenate(found, axis=-1)

    @property
    def places(self) -> Indices:
        """Which statistic each number's slope is made from, shape (p,): means, ln σ, artanh ρ, growth, ln(ν − 2)."""
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
        """Which numbers are at a bound that the likelihood's slopes, shape (p,), push them against, shape (p,)."""
        held = np.zeros(len(score), dtype=bool)
        if self.unit == "mixed":
            held[_STDS] = (self.std <= self.floor) & (score[_STDS] <= 0)
            held[14:18] = (self.growth <= 0) & (score[14:18] <= 0)
        if self.heavy:
            low, high = self.freedom <= LEAST_DEGREES * (1 + 1e-9), self.freedom >= MOST_DEGREES * (1 - 1e-9)
            held[-1] = (low and score[-1] < 0) or (high and score[-1] > 0)
        return held

    def with_numbers(self, numbers: Array) -> ErrorModel:
        """The same distribution with other numbers, shape (p,), held where a distribution has them."""
        correlation = np.eye(4)
        values = np.tanh(np.clip(numbers[_PAIRS], -_MOST_ARTANH, _MOST_ARTANH))
        correlation[_FIRST, _SECOND] = correlation[_SECOND, _FIRST] = values
        return replace(
            self,
            mean=numbers[_MEANS],
            std=np.maximum(np.exp(numbers[_STDS]), self.floor),
            correlation=_definite(correlation),
            growth=np.maximum(numbers[14:18], 0.0) if self.unit == "mixed" else self.growth,
            freedom=float(np.clip(2 + np.exp(numbers[-1]), LEAST_DEGREES, MOST_DEGREES)) if self.heavy else np.inf,
        )


def _definite(correlation: Array) -> Array:
    """A correlation matrix, or one near it where a step has left what correlations can be."""
    values, vectors = np.linalg.eigh(correlation)
    if values[0] >= 1e-6:
        return correlation
    nearest = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    scale = np.sqrt(np.diag(nearest))
    result: Array = nearest / np.outer(scale, scale)
    return result
