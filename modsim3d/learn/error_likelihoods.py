"""How the likelihood of standardised box errors follows mean, standard deviations, correlations and shape.

All distributions here are elliptical: their log-likelihood follows mean and covariance through four values and ten
products of values, each with a weight that depends on the distribution. These are the statistics of a fit; numbers of
the distribution itself add one statistic each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from modsim3d.arrays import Array
from modsim3d.detector.error_distributions import ErrorDistribution
from modsim3d.detector.model import ERROR_PAIRS

FIRST, SECOND = np.triu_indices(4)
PLAIN = 14
"""Statistics of mean and covariance: four values and ten products."""


class ErrorLikelihood(Protocol):
    """The log-likelihood of one kind of distribution of standardised errors."""

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Keys of the distribution's own numbers."""

    def shape(self, distribution: Any) -> Array:
        """The distribution's own numbers, shape (s,)."""

    def shape_units(self, distribution: Any) -> Array:
        """What a step of one is worth in these numbers, shape (s,)."""

    def reshaped(self, distribution: Any, step: Array) -> ErrorDistribution:
        """The distribution a step of shape (s,) away."""

    def statistics(self, distribution: Any, correlation: Array, standardised: Array) -> Array:
        """Statistics of standardised errors of shape (..., 4), shape (..., 14 + s)."""

    def latent_share(self, distribution: Any) -> float:
        """Correlation kept between latent normal numbers and whitened statistics, 1 for a normal distribution."""


class NormalLikelihood:
    """Of the normal distribution: the statistics are the values and their products themselves."""

    shape_names: tuple[str, ...] = ()

    def shape(self, distribution: Any) -> Array:
        """None."""
        return np.empty(0)

    def shape_units(self, distribution: Any) -> Array:
        """None."""
        return np.empty(0)

    def reshaped(self, distribution: Any, step: Array) -> ErrorDistribution:
        """The same."""
        kept: ErrorDistribution = distribution
        return kept

    def statistics(self, distribution: Any, correlation: Array, standardised: Array) -> Array:
        """Four values and their ten products, shape (..., 14)."""
        return np.concatenate([standardised, products_of(standardised)], axis=-1)

    def latent_share(self, distribution: Any) -> float:
        """All of it."""
        return 1.0


LIKELIHOODS: Mapping[str, ErrorLikelihood] = {"normal": NormalLikelihood()}
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
