"""Likelihoods of standardised box errors: how they depend on mean, standard deviations, correlations and shape.

All distributions here are elliptical: their log-likelihood depends on mean and covariance through four values and ten
products of values, each with a weight that depends on the distribution. These are the statistics of a fit; each number
of the distribution itself adds one statistic.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.box_error_law import ErrorDistribution, StudentT
from modsim3d.detector.model import ERROR_PAIRS

FIRST, SECOND = np.triu_indices(4)
PLAIN = 14
"""Statistics of mean and covariance: four values and ten products."""
_MOST_FREEDOM, _LEVELS = 1e4, 400


class ErrorLikelihood(Protocol):
    """The log-likelihood of one kind of distribution of standardised errors."""

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Keys of the distribution's own numbers."""

    def shape(self, distribution: Any) -> Array:
        """The distribution's own numbers, shape (s,)."""

    def shape_units(self, distribution: Any) -> Array:
        """The size of a step of one in these numbers, shape (s,)."""

    def reshaped(self, distribution: Any, step: Array) -> ErrorDistribution:
        """The distribution a step of shape (s,) away."""

    def statistics(self, distribution: Any, correlation: Array, standardised: Array) -> Array:
        """Statistics of standardised errors of shape (..., 4), shape (..., 14 + s)."""

    def latent_share(self, distribution: Any) -> float:
        """Correlation kept between latent normal numbers and whitened statistics, 1 for a normal distribution."""


class NormalLikelihood:
    """The normal distribution: the statistics are the values and their products themselves."""

    shape_names: tuple[str, ...] = ()

    def shape(self, distribution: Any) -> Array:
        """No numbers, shape (0,)."""
        return np.empty(0)

    shape_units = shape

    def reshaped(self, distribution: Any, step: Array) -> ErrorDistribution:
        """The same distribution; the step has shape (0,)."""
        kept: ErrorDistribution = distribution
        return kept

    def statistics(self, distribution: Any, correlation: Array, standardised: Array) -> Array:
        """Four values and their ten products, shape (..., 14)."""
        return np.concatenate([standardised, products_of(standardised)], axis=-1)

    def latent_share(self, distribution: Any) -> float:
        """All of the correlation."""
        return 1.0


class StudentTLikelihood:
    """Student's t: values and products weigh less the farther out the error is, and ν has a statistic of its own.

    With q = yᵀ R⁻¹ y for the correlation R, the log-density is, but for constants, −(ν + 4)/2 · log(1 + q/(ν − 2)) −
    2·log(ν − 2) + log Γ((ν + 4)/2) − log Γ(ν/2). Its derivatives by mean and covariance are those of a normal one with
    values and products times (ν + 4)/(ν − 2 + q). Steps of ν are parts of ν − 2.
    """

    shape_names = ("degrees_of_freedom",)

    def shape(self, distribution: StudentT) -> Array:
        """The degrees of freedom, shape (1,)."""
        return np.array([distribution.degrees_of_freedom])

    def shape_units(self, distribution: StudentT) -> Array:
        """ν − 2, shape (1,)."""
        return np.array([distribution.degrees_of_freedom - 2])

    def reshaped(self, distribution: StudentT, step: Array) -> ErrorDistribution:
        """ν − 2 times the exponential of the step, shape (1,)."""
        return StudentT(min(2 + (distribution.degrees_of_freedom - 2) * float(np.exp(step[0])), _MOST_FREEDOM))

    def statistics(self, distribution: StudentT, correlation: Array, standardised: Array) -> Array:
        """Weighted values and products, and the derivative by ν but for a constant, shape (..., 15)."""
        nu = distribution.degrees_of_freedom
        q = np.einsum("...i,ij,...j->...", standardised, np.linalg.inv(correlation), standardised)
        weight = ((nu + 4) / (nu - 2 + q))[..., None]
        of_nu = (weight[..., 0] * q - (nu - 2) * np.log1p(q / (nu - 2))) / 2
        return np.concatenate([weight * standardised, weight * products_of(standardised), of_nu[..., None]], axis=-1)

    def latent_share(self, distribution: StudentT) -> float:
        """Correlation of whitened weighted values with the latent normal ones, by integration over z and w."""
        levels = (np.arange(_LEVELS) + 0.5) / _LEVELS
        length = 2 * special.gammaincinv(2.0, levels)[:, None]  # of z: chi-square of 4 degrees of freedom
        scale = distribution.scales(special.ndtri(levels)[:, None])
        nu = distribution.degrees_of_freedom
        weight = (nu + 4) / (nu - 2 + scale**2 * length)
        with_latent = float((weight * scale * length).mean()) / 4
        variance = float((weight**2 * scale**2 * length).mean()) / 4
        return with_latent / variance


LIKELIHOODS: Mapping[str, ErrorLikelihood] = {"normal": NormalLikelihood(), "student_t": StudentTLikelihood()}
"""By the name of the distribution; one that is not here is reported as unchecked."""


def products_of(values: Array) -> Array:
    """The ten products of values of shape (..., 4), shape (..., 10)."""
    result: Array = values[..., FIRST] * values[..., SECOND]
    return result


def directions(correlation: Array) -> Array:
    """Derivatives of the log-likelihood as weights of the statistics of mean and covariance, shape (14, 14).

    By each mean in standard deviations, by the logarithm of each standard deviation, and by each correlation.
    """
    precision = np.linalg.inv(correlation)
    weights = np.zeros((PLAIN, PLAIN))
    weights[:4, :4] = precision
    for row in range(10):
        change = np.zeros((4, 4))
        if row < 4:
            change[row, :] += correlation[row, :]
            change[:, row] += correlation[:, row]
        else:
            i, j = ERROR_PAIRS[row - 4]
            change[i, j] = change[j, i] = 1
        quadratic = precision @ change @ precision
        weights[4 + row, 4:] = np.where(FIRST == SECOND, 0.5, 1) * quadratic[FIRST, SECOND]
    return weights
