"""Errors of positions that last: a fit in which each vessel drifts about its reports.

Errors of satellite navigation change over minutes. So all sightings of a vessel within a minute are off alike, and they
tell no more of the camera than a few would. The error of a vessel is a constant, along and across, and a
Gauss-Markov process beside it, whose covariance between two times falls by exp(-apart / LASTS_S). Together with the
camera both are fitted as a linear mixed model (Robinson, 1991, "That BLUP is a good thing", Statistical Science 6), by
weighted least squares with the weights of the soft loss, so that a wrong match does not pull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.registration.covariance import clusters
from modsim3d.voyage.registration.fitting import SOFT
from modsim3d.voyage.registration.residuals import Residuals

LASTS_S = 300.0
KNOT_S, MOST_KNOTS = 3.0, 60
"""The drift is linear between knots, of which a vessel has at most so many."""
TINY = 1e-9
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Drift:
    """A linear fit of p values of the camera and of the vessels' drifts.

    Attributes:
        change: Change of the values, shape (p,).
        off: How far each row's vessel is off its reports, along and across in metres, and how late, shape (m, 3).
        steady: The same of a vessel that did not drift, so that it stays put among what is seen of it, shape (m, 3).
        errors_px: What is left of the residuals, shape (m,).
        spreads_px: Spread of what is left of each row, shape (m,).
    """

    change: Array
    off: Array
    steady: Array
    errors_px: Array
    spreads_px: Array


def drift_axes(time_s: Array, vessel: Indices, constant: Array, noise_m: float) -> Array:
    """How far unit normals put the vessel of each row off: along and across in metres, late in s, shape (m, 3, q).

    Args:
        time_s: Time of each row, shape (m,).
        vessel: Its vessel, which has its own normals, shape (m,).
        constant: Standard deviations of what is constant: along, across and delay, shape (3,).
        noise_m: Standard deviation of the drift along and across.
    """
    parts = [(rows, _hats(time_s[rows])) for rows in clusters(vessel)]
    most = max((hats.shape[1] for _, hats in parts), default=0)
    drifting, staying = np.zeros((len(time_s), 3, 2, most)), np.zeros((len(time_s), 3, 3))
    for rows, hats in parts:
        for axis in range(2):
            drifting[rows, axis, axis, : hats.shape[1]] = noise_m * hats
    staying[:] = np.diag(constant)
    return np.concatenate([drifting.reshape(len(time_s), 3, 2 * most), staying], axis=2)


def _hats(time_s: Array) -> Array:
    """A Gauss-Markov process of unit spread at n times, from unit normals, shape (n, K)."""
    first, last = float(time_s.min()), float(time_s.max())
    knots = np.linspace(first, last, int(min((last - first) // KNOT_S + 1, MOST_KNOTS)) + 1)
    covariance = np.exp(-np.abs(knots[:, None] - knots) / LASTS_S)
    root = np.linalg.cholesky(covariance + TINY * np.eye(len(knots)))
    return np.stack([np.interp(time_s, knots, column) for column in root.T], axis=1)


def fit_drift(
    residuals: Residuals, px: Array, first_px: Array, slopes_px: Array, own_px: Array, axes: Array, together: float
) -> Drift:
    """Fit values of the camera, and where the vessels are.

    Args:
        residuals: The rows.
        px: Residuals with all vessels where their reports put them, shape (m,).
        first_px: What is left of them by the last fit, shape (m,).
        slopes_px: Derivatives by the values, shape (m, p).
        own_px: Derivatives by along, across and delay of the row's vessel, per metre and second, shape (m, 3).
        axes: See `drift_axes`, shape (m, 3, q).
        together: How many rows count as one.
    """
    axes_px = (own_px[:, :, None] * axes).sum(axis=1)
    errors, change, normals = first_px, np.zeros(slopes_px.shape[1]), np.zeros(axes_px.shape)
    groups, p = list(clusters(residuals.vessel)), slopes_px.shape[1]
    for _ in range(ROUNDS):
        spreads = residuals.spreads_px(errors)
        weights = (1 + (errors / spreads / SOFT) ** 2) ** -0.25 / spreads
        shared = axes_px * weights[:, None] / np.sqrt(together)
        rows = np.column_stack([slopes_px, px]) * weights[:, None]
        products, inner = rows.T @ rows, []
        for own in groups:  # the covariance of a vessel's rows is 1 + Z Zᵀ; its inverse is Woodbury's
            crossed = shared[own].T @ rows[own]
            inner.append(np.linalg.solve(np.eye(shared.shape[1]) + shared[own].T @ shared[own], crossed))
            products -= crossed.T @ inner[-1]
        change = -np.linalg.pinv(products[:p, :p], hermitian=True) @ products[:p, p]
        for own, solved in zip(groups, inner, strict=True):
            normals[own] = -(solved[:, :p] @ change + solved[:, p]) / np.sqrt(together)
        errors = px + slopes_px @ change + (axes_px * normals).sum(axis=1)
    off = (axes * normals[:, None]).sum(axis=2)
    far = np.sqrt((axes**2).sum(axis=2).max(axis=0))[:2]
    rest = (px + slopes_px @ change + own_px[:, 2] * off[:, 2]) * weights
    steady = np.column_stack([_steady(rest, own_px[:, :2] * weights[:, None], groups, far), off[:, 2]])
    return Drift(change, off, steady, errors, spreads)


def _steady(rest: Array, slopes: Array, groups: Sequence[Indices], far_m: Array) -> Array:
    """One place along and across for all rows of a vessel, expected within so many metres (2,), shape (m, 2)."""
    steady = np.zeros(slopes.shape)
    for own in groups:
        pull = slopes[own].T @ rest[own]
        steady[own] = -np.linalg.solve(slopes[own].T @ slopes[own] + np.diag(1 / np.maximum(far_m, TINY) ** 2), pull)
    return steady
