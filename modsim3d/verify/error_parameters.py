"""The numbers of a box error law that are verified: means, standard deviations, correlations, growth and shape."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.detector.box_error_law import ERROR_DISTRIBUTIONS, BoxErrorLaw, ErrorDistribution, Normal, size_factors
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.detector.parts import model_name
from modsim3d.verify.error_likelihoods import LIKELIHOODS, PLAIN, ErrorLikelihood, directions

_LEAST_EIGENVALUE, _LEAST_GROWTH = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class ErrorParameters:
    """A law of box errors before truncation, in a form that a fit can move; see `BoxErrorLaw` for its numbers.

    Mean, standard deviations, all positive, and growth have shape (4,), the correlation, not singular, (4, 4).
    """

    mean: Array
    std: Array
    correlation: Array
    relative: bool = False
    growth: Array = field(default_factory=lambda: np.zeros(4))
    distribution: ErrorDistribution = field(default_factory=Normal)

    @classmethod
    def of(cls, law: BoxErrorLaw) -> ErrorParameters:
        """The parameters of a law with a covariance that is not singular."""
        correlation = law.covariance / np.outer(law.std, law.std)
        return cls(law.mean, law.std, correlation, law.relative, law.growth, law.distribution)

    @property
    def likelihood(self) -> ErrorLikelihood:
        """The likelihood of the distribution."""
        return LIKELIHOODS[model_name(ERROR_DISTRIBUTIONS, self.distribution)]

    @property
    def growing(self) -> Indices:
        """Components whose standard deviations grow, shape (g,)."""
        return np.flatnonzero(self.growth > 0)

    def at(self, boxes_px: Array) -> tuple[Array, Array]:
        """Means and standard deviations of the errors of boxes (n, 4) in pixels, shapes (n, 4)."""
        factor, spread = size_factors(sizes(boxes_px), self.relative, self.growth / self.std)
        return self.mean * factor, self.std * factor * spread

    def statistics(self, standardised: Array) -> Array:
        """Statistics of standardised errors of shape (..., 4), shape (..., m)."""
        return self.likelihood.statistics(self.distribution, self.correlation, standardised)

    def score_weights(self, boxes_px: Array) -> tuple[Array, Array]:
        """How statistics add up to the derivatives of the log-likelihood by the p parameters, for boxes (n, 4).

        Returns weights of the statistics, shape (p, m), and factors on their sums box by box, shape (n, p).
        """
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
        return [
            *parameter_names(),
            *(f"growth[{ERROR_COMPONENTS[k]}]" for k in self.growing),
            *self.likelihood.shape_names,
        ]

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
        growth[self.growing] = np.maximum(growth[self.growing] + step[PLAIN:shape], _LEAST_GROWTH)
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
    """A correlation matrix, or the nearest one where a step has left what correlations can be."""
    values, vectors = np.linalg.eigh(correlation)
    if values[0] >= _LEAST_EIGENVALUE:
        return correlation
    nearest = (vectors * np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T
    scale = np.sqrt(np.diag(nearest))
    result: Array = nearest / np.outer(scale, scale)
    return result
