"""Student's t distribution of four components by maximum likelihood (Lange et al. (1989); Liu & Rubin (1995)).

With mean μ, covariance C, ν degrees of freedom and q = (x − μ)ᵀ C⁻¹ (x − μ), the density has the logarithm

    ln Γ(ν/2 + 2) − ln Γ(ν/2) − 2 ln(π (ν − 2)) − ½ ln |C| − (ν/2 + 2) ln(1 + q / (ν − 2)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from modsim3d.arrays import Array
from modsim3d.learn.box_error_fits.error_model import LEAST_DEGREES, MOST_DEGREES

_STEPS, _ENOUGH = 500, 1e-6
_LEAST_SHARE = 1e-6


class StudentTFit(NamedTuple):
    """A t distribution: mean (4,), covariance (4, 4) of the distribution itself, and degrees of freedom."""

    mean: Array
    covariance: Array
    degrees_of_freedom: float


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


def may_be_heavy(errors: Array) -> bool:
    """Whether the likelihood of errors, shape (n, 4), rises as ν falls from infinity, as Mardia's kurtosis says."""
    covariance = np.cov(errors.T, bias=True)
    if np.linalg.cond(covariance) > 1e12:
        return False
    return bool(np.mean(_squared_lengths(errors - errors.mean(axis=0), covariance) ** 2) > 4 * 6)


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
