"""What is wrong with single vessels: where the antenna is, and how late the reports come.

Each vessel has an offset of its antenna along and across and a delay, normally distributed over the vessels with mean
zero. That mean is a rule: a common delay looks like the clock. Their spreads follow from the data by expectation and
maximisation (Dempster, Laird & Rubin, 1977), so that vessels whose reports are exact are held to be exact, and the
camera is not less well known for what is not there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.registration.parameters import OF_A_VESSEL, plausible

NAMES = tuple(parameter.name for parameter in OF_A_VESSEL)
ROUNDS = 60
WORTH = 4.0
"""Gain in log-likelihood below which spreads are taken to be zero: three numbers are estimated for it."""
LEAST_SPREAD = 1e-3
"""Spreads below this share of the plausible distances are zero."""


@dataclass(frozen=True, eq=False)
class VesselEffects:
    """Offsets and delays of k vessels.

    Attributes:
        vessels: Their indices, shape (k,).
        spreads: Standard deviations over vessels of along, across (m) and delay (s), shape (3,).
        values: The most probable of each vessel, shape (k, 3).
        covariances: Their covariances for known camera and clock, shape (k, 3, 3).
    """

    vessels: Indices
    spreads: Array
    values: Array
    covariances: Array


def vessel_effects(slopes: Array, residuals: Array, vessel: Indices, together: float) -> VesselEffects:
    """Spreads and values that fit scaled residuals best.

    Args:
        slopes: Derivatives of the scaled residuals by along, across and delay of the row's vessel, in plausible
            distances, shape (m, 3).
        residuals: Scaled residuals with all of them zero, shape (m,).
        vessel: Vessel of each row, shape (m,).
        together: How many rows count as one, because box errors last, at least 1.
    """
    vessels = np.unique(vessel)
    products = np.array([slopes[vessel == one].T @ slopes[vessel == one] for one in vessels]) / together
    pulls = -np.array([slopes[vessel == one].T @ residuals[vessel == one] for one in vessels]) / together
    squares, scale = np.full(3, 0.1), plausible(NAMES)
    for _ in range(ROUNDS):
        covariances = np.linalg.inv(products + np.diag(1 / np.maximum(squares, 1e-12)))
        values = (covariances @ pulls[..., None])[..., 0]
        squares = (values**2 + np.diagonal(covariances, axis1=1, axis2=2)).mean(axis=0)
    gain = 0.5 * float(np.einsum("vi,vij,vj->", pulls, covariances, pulls))
    gain -= 0.5 * float(np.linalg.slogdet(np.eye(3) + products * squares)[1].sum())
    spreads = np.sqrt(squares)
    spreads = np.where(spreads < LEAST_SPREAD, 0.0, spreads) if gain > WORTH else np.zeros(3)
    kept = np.where(spreads > 0, 1.0, 0.0)
    values, covariances = values * kept, covariances * kept[:, None] * kept
    return VesselEffects(vessels, spreads * scale, values * scale, covariances * scale[:, None] * scale)


def with_camera(
    effects: VesselEffects, slopes: Array, of_camera: Array, vessel: Indices, together: float, covariance: Array
) -> VesselEffects:
    """The same with covariances that hold what is not known of the camera and the clock too.

    Args:
        effects: The effects.
        slopes: As in `vessel_effects`.
        of_camera: Derivatives by the p estimated shared parameters, shape (m, p).
        vessel: Vessel of each row, shape (m,).
        together: As in `vessel_effects`.
        covariance: Covariance of the shared parameters, shape (p, p).
    """
    scale, wider = plausible(NAMES), []
    for one, own in zip(effects.vessels, effects.covariances / (scale[:, None] * scale), strict=True):
        rows = vessel == one
        moved = own @ (slopes[rows].T @ of_camera[rows]) / together
        wider.append((own + moved @ covariance @ moved.T) * scale[:, None] * scale)
    return replace(effects, covariances=np.array(wider))


def known_of(
    effects: VesselEffects, speeds_m_s: Array, names: Sequence[str]
) -> list[tuple[str, str, str, float, float]]:
    """What is determined of each vessel: name, words, unit, value and standard error.

    An offset along and a delay look the same while a vessel keeps its speed; then only how far it is ahead of its
    reports is determined. A value is determined if its error is below half of its spread over the vessels.

    Args:
        effects: The effects.
        speeds_m_s: Mean speed of each vessel, shape (k,).
        names: IDs of all the scene's vessels.
    """
    found = []
    ahead = ("ahead_m", "how far it is ahead of its reports, at its mean speed", "m")
    for vessel, speed, value, covariance in zip(
        effects.vessels.tolist(), speeds_m_s, effects.values, effects.covariances, strict=True
    ):
        about = [(ahead, np.array([-1.0, 0.0, speed]))]
        about += [((p.name, p.words, p.unit), axis) for p, axis in zip(OF_A_VESSEL, np.eye(3), strict=True)]
        for (name, words, unit), axis in about:
            spread, error = np.linalg.norm(axis * effects.spreads), float(np.sqrt(axis @ covariance @ axis))
            if 0 < error < spread / 2:
                found.append((f"{names[vessel]}.{name}", words, unit, float(axis @ value), error))
    return found
