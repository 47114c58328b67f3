"""Student's t distribution of four components by maximum likelihood (Lange et al. (1989); Liu & Rubin (1995)).

With mean μ, covariance C, ν degrees of freedom and q = (x − μ)ᵀ C⁻¹ (x − μ), the density has the logarithm

    ln Γ(ν/2 + 2) − ln Γ(ν/2) − 2 ln(π (ν − 2)) − ½ ln |C| − (ν/2 + 2) ln(1 + q / (ν − 2)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from modsim3d.arrays import Array
from modsim3d.detector.model import ERROR_PAIRS

LEAST_DEGREES, MOST_DEGREES = 2.1, 200.0
"""Bounds of ν: with 2 there is no covariance; with more than 200 the distribution is as good as normal."""
_STEPS, _ENOUGH = 500, 1e-6
_LEAST_SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class StudentTFit:
    """A t distribution: mean (4,), covariance (4, 4) of the distribution itself, and degrees of freedom."""

    mean: Array
    covariance: Array
    degrees_of_freedom: float

    def squared_lengths(self, errors: Array) -> Array:
        """q of errors (n, 4), shape (n,)."""
        return _squared_lengths(errors - self.mean, self.covariance)

    def log_likelihood(self, errors: Array) -> float:
        """The logarithm of the likelihood of errors of shape (n, 4)."""
        nu, q = self.degrees_of_freedom, self.squared_lengths(errors)
        constant = special.gammaln(nu / 2 + 2) - special.gammaln(nu / 2) - 2 * np.log(np.pi * (nu - 2))
        constant -= np.linalg.slogdet(self.covariance)[1] / 2
        return float(len(q) * constant - (nu / 2 + 2) * np.log1p(q / (nu - 2)).sum())

    def scores(self, errors: Array) -> Array:
        """Slopes of log-densities of errors, by four μ, four ln σ, six artanh ρ, ln(ν − 2); shapes (n, 4), (n, 15)."""
        nu, moved, inverse = self.degrees_of_freedom, errors - self.mean, np.linalg.inv(self.covariance)
        std, solved, q = np.sqrt(np.diag(self.covariance)), moved @ inverse, self.squared_lengths(errors)
        weight = (nu + 4) / (nu - 2 + q)
        columns = [*(weight[:, None] * solved).T, *(weight[:, None] * moved * solved - 1).T]
        for i, j in ERROR_PAIRS:
            rho = self.covariance[i, j] / (std[i] * std[j])
            slope = std[i] * std[j] * (weight * solved[:, i] * solved[:, j] - inverse[i, j])
            columns.append(slope * (1 - rho**2))
        constant = (special.digamma(nu / 2 + 2) - special.digamma(nu / 2)) / 2 - 2 / (nu - 2)
        slope = constant - np.log1p(q / (nu - 2)) / 2 + weight * q / (nu - 2) / 2
        return np.column_stack([*columns, slope * (nu - 2)])


def fit_student_t(errors: Array) -> StudentTFit | None:
    """The likeliest t distribution of errors, shape (n, 4), with ν between the bounds; None where they determine none.

    Each step weighs errors by (ν + 4) / (ν + q), with q by the scatter matrix, for mean and scatter, and then
    maximises the likelihood over ν.
    """
    mean, scatter, nu, last = errors.mean(axis=0), np.cov(errors.T, bias=True), 10.0, -np.inf
    least = _LEAST_SHARE * np.linalg.eigvalsh(scatter)
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


def gain_over_normal(errors: Array) -> float:
    """How much larger the log-likelihood of errors, shape (n, 4), is as Student's t ones than as normal ones; or 0."""
    covariance = np.cov(errors.T, bias=True)
    if np.linalg.cond(covariance) > 1e12:
        return 0.0
    q = _squared_lengths(errors - errors.mean(axis=0), covariance)
    if np.mean(q**2) <= 4 * 6:  # Mardia's kurtosis of normal errors: the likelihood falls as ν leaves infinity
        return 0.0
    fit = fit_student_t(errors)
    if fit is None or fit.degrees_of_freedom > 0.99 * MOST_DEGREES:
        return 0.0
    normal = -len(errors) * (2 * np.log(2 * np.pi) + np.linalg.slogdet(covariance)[1] / 2 + 2)
    return max(fit.log_likelihood(errors) - float(normal), 0.0)


def _squared_lengths(moved: Array, matrix: Array) -> Array:
    """xᵀ M⁻¹ x of vectors (n, 4), shape (n,)."""
    lengths: Array = np.einsum("ni,ni->n", moved, np.linalg.solve(matrix, moved.T).T)
    return lengths


def _likeliest_degrees(q: Array) -> tuple[float, float]:
    """ν and its log-likelihood but for the scatter's share, given q by the scatter matrix, shape (n,)."""

    def loss(logarithm: float) -> float:
        nu = np.exp(logarithm)
        each = special.gammaln(nu / 2 + 2) - special.gammaln(nu / 2) - 2 * np.log(np.pi * nu)
        return float((nu / 2 + 2) * np.log1p(q / nu).sum() - len(q) * each)

    bounds = np.log(LEAST_DEGREES), np.log(MOST_DEGREES)
    found = optimize.minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(np.exp(found.x)), -float(found.fun)
