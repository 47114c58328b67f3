"""The numbers of a box error law that are verified: means, standard deviations, correlations, growth and shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.detector import draws
from modsim3d.detector.chain import model_name
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS

FIRST, SECOND = np.triu_indices(4)
PLAIN = 14  # statistics of mean and covariance: four values and ten products
_MAX_FREEDOM, _LEVELS = 1e4, 400


class ErrorLikelihood:
    """The log-likelihood of standardised errors of one kind of distribution; this one of normal errors. `shape_names`
    are the keys of the s numbers that are the distribution's own."""

    shape_names: tuple[str, ...] = ()

    def shape(self, distribution: Any) -> Array:
        """The distribution's own numbers, shape (s,)."""
        return np.empty(0)

    def shape_units(self, distribution: Any) -> Array:
        """The size of a step of one in these numbers, shape (s,)."""
        return np.empty(0)

    def reshaped(self, distribution: Any, step: Array) -> draws.ErrorDistribution:
        """The distribution a step of shape (s,) away."""
        kept: draws.ErrorDistribution = distribution
        return kept

    def statistics(self, distribution: Any, correlation: Array, standardised: Array) -> Array:
        """Statistics of standardised errors (..., 4), shape (..., 14 + s): the values and their ten products first."""
        return np.concatenate([standardised, products_of(standardised)], axis=-1)

    def latent_share(self, distribution: Any) -> float:
        """Correlation kept between latent normal numbers and whitened statistics, 1 for a normal distribution."""
        return 1.0


class StudentTLikelihood(ErrorLikelihood):
    """Student's t: values and products weigh less the farther out the error is, and ν has a statistic of its own. With
    q = yᵀ R⁻¹ y for the correlation R, the log-density is, but for constants, −(ν + 4)/2 · log(1 + q/(ν − 2)) −
    2·log(ν − 2) + log Γ((ν + 4)/2) − log Γ(ν/2). Its derivatives by mean and covariance are those of a normal one with
    values and products times (ν + 4)/(ν − 2 + q). Steps of ν are parts of ν − 2."""

    shape_names = ("degrees_of_freedom",)

    def shape(self, distribution: draws.StudentT) -> Array:
        """The degrees of freedom, shape (1,)."""
        return np.array([distribution.degrees_of_freedom])

    def shape_units(self, distribution: draws.StudentT) -> Array:
        """ν − 2, shape (1,)."""
        return np.array([distribution.degrees_of_freedom - 2])

    def reshaped(self, distribution: draws.StudentT, step: Array) -> draws.ErrorDistribution:
        """ν − 2 times the exponential of the step, shape (1,)."""
        return draws.StudentT(min(2 + (distribution.degrees_of_freedom - 2) * float(np.exp(step[0])), _MAX_FREEDOM))

    def statistics(self, distribution: draws.StudentT, correlation: Array, standardised: Array) -> Array:
        """Weighted values and products, and the derivative by ν but for a constant, shape (..., 15)."""
        nu = distribution.degrees_of_freedom
        q = np.einsum("...i,ij,...j->...", standardised, np.linalg.inv(correlation), standardised)
        weight = ((nu + 4) / (nu - 2 + q))[..., None]
        of_nu = (weight[..., 0] * q - (nu - 2) * np.log1p(q / (nu - 2))) / 2
        return np.concatenate([weight * standardised, weight * products_of(standardised), of_nu[..., None]], axis=-1)

    def latent_share(self, distribution: draws.StudentT) -> float:
        """Correlation of whitened weighted values with the latent normal ones, by integration over z and w."""
        levels = (np.arange(_LEVELS) + 0.5) / _LEVELS
        length = 2 * special.gammaincinv(2.0, levels)[:, None]  # of z: chi-square of 4 degrees of freedom
        scale = distribution.scales(special.ndtri(levels)[:, None])
        nu = distribution.degrees_of_freedom
        weight = (nu + 4) / (nu - 2 + scale**2 * length)
        with_latent = float((weight * scale * length).mean()) / 4
        return with_latent / (float((weight**2 * scale**2 * length).mean()) / 4)


LIKELIHOODS: Mapping[str, ErrorLikelihood] = {"normal": ErrorLikelihood(), "student_t": StudentTLikelihood()}
"""By the name of the distribution; one that is not here is reported as unchecked."""


def products_of(values: Array) -> Array:
    """The ten products of values of shape (..., 4), shape (..., 10)."""
    return values[..., FIRST] * values[..., SECOND]


def directions(correlation: Array) -> Array:
    """Derivatives of the log-likelihood as weights of the statistics of mean and covariance, shape (14, 14): by each
    mean in standard deviations, by the logarithm of each standard deviation, and by each correlation."""
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
        weights[4 + row, 4:] = np.where(FIRST == SECOND, 0.5, 1) * (precision @ change @ precision)[FIRST, SECOND]
    return weights


_MIN_EIGENVALUE, _MIN_GROWTH = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class ErrorParameters:
    """A law of box errors before truncation, in a form that a fit can move; see `BoxErrorLaw` for its numbers. Mean,
    standard deviations, all positive, and growth have shape (4,), the correlation, not singular, (4, 4)."""

    mean: Array
    std: Array
    correlation: Array
    relative: bool = False
    growth: Array = field(default_factory=lambda: np.zeros(4))
    distribution: draws.ErrorDistribution = field(default_factory=draws.Normal)

    @classmethod
    def of(cls, law: draws.BoxErrorLaw) -> ErrorParameters:
        """The parameters of a law with a covariance that is not singular."""
        correlation = law.covariance / np.outer(law.std, law.std)
        return cls(law.mean, law.std, correlation, law.relative, law.growth, law.distribution)

    @property
    def likelihood(self) -> ErrorLikelihood:
        """The likelihood of the distribution."""
        return LIKELIHOODS[model_name(draws.ERROR_DISTRIBUTIONS, self.distribution)]

    @property
    def growing(self) -> Indices:
        """Components whose standard deviations grow, shape (g,)."""
        return np.flatnonzero(self.growth > 0)

    def at(self, boxes_px: Array) -> tuple[Array, Array]:
        """Means and standard deviations of the errors of boxes (n, 4) in pixels, shapes (n, 4)."""
        factor, spread = draws.size_factors(sizes(boxes_px), self.relative, self.growth / self.std)
        return self.mean * factor, self.std * factor * spread

    def statistics(self, standardised: Array) -> Array:
        """Statistics of standardised errors of shape (..., 4), shape (..., m)."""
        return self.likelihood.statistics(self.distribution, self.correlation, standardised)

    def score_weights(self, boxes_px: Array) -> tuple[Array, Array]:
        """Weights with which statistics add up to the derivatives of the log-likelihood by the p parameters, shape
        (p, m), and factors on their sums box by box, shape (n, p), for boxes (n, 4)."""
        shape = len(self.likelihood.shape_names)
        every = np.eye(PLAIN + shape)
        every[:PLAIN, :PLAIN] = directions(self.correlation)
        of = np.concatenate([np.arange(PLAIN), 4 + self.growing, PLAIN + np.arange(shape)])
        gains = np.ones((len(boxes_px), len(of)))
        if len(self.growing):
            _, stds = self.at(boxes_px)
            share = self.std / stds
            gains[:, :4], gains[:, 4:8] = share, share
            gains[:, PLAIN : PLAIN + len(self.growing)] = (np.tile(sizes(boxes_px), 2) / stds)[:, self.growing]
        return every[of], gains

    def names(self) -> list[str]:
        """The keys of the parameters in the order of `numbers`."""
        growths = [f"growth[{ERROR_COMPONENTS[k]}]" for k in self.growing]
        return [*parameter_names(), *growths, *self.likelihood.shape_names]

    def numbers(self) -> Array:
        """Four means, four standard deviations, six correlations, growths that are not 0, own numbers; shape (p,)."""
        correlations = [self.correlation[i, j] for i, j in ERROR_PAIRS]
        shape = self.likelihood.shape(self.distribution)
        return np.concatenate([self.mean, self.std, correlations, self.growth[self.growing], shape])

    def units(self) -> Array:
        """The size of a step of one in these numbers, shape (p,)."""
        shape = self.likelihood.shape_units(self.distribution)
        return np.concatenate([self.std, self.std, np.ones(len(ERROR_PAIRS) + len(self.growing)), shape])

    def moved(self, step: Array) -> ErrorParameters:
        """The law a step of shape (p,) away: means in standard deviations, these in parts of themselves."""
        step = min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12)) * step
        correlation = self.correlation.copy()
        for value, (i, j) in zip(step[8:PLAIN], ERROR_PAIRS, strict=True):
            correlation[i, j] = correlation[j, i] = np.clip(correlation[i, j] + value, -0.99, 0.99)
        growth, shape = self.growth.copy(), PLAIN + len(self.growing)
        growth[self.growing] = np.maximum(growth[self.growing] + step[PLAIN:shape], _MIN_GROWTH)
        return replace(
            self,
            mean=self.mean + step[:4] * self.std,
            std=self.std * np.exp(step[4:8]),
            correlation=_definite(correlation),
            growth=growth,
            distribution=self.likelihood.reshaped(self.distribution, step[shape:]),
        )


def parameter_names() -> list[str]:
    """The keys of four means, four standard deviations and six correlations."""
    names = [f"{key}[{c}]" for key in ("mean", "std") for c in ERROR_COMPONENTS]
    return [*names, *(f"correlation[{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}]" for i, j in ERROR_PAIRS)]


def _definite(correlation: Array) -> Array:
    values, vectors = np.linalg.eigh(correlation)
    if values[0] >= _MIN_EIGENVALUE:
        return correlation
    nearest = (vectors * np.maximum(values, _MIN_EIGENVALUE)) @ vectors.T
    scale = np.sqrt(np.diag(nearest))
    return np.asarray(nearest / np.outer(scale, scale))
