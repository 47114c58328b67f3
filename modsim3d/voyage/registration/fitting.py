"""The values that fit matched detections best: robust least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.parameters import MEAN_ERRORS, OF_A_VESSEL, PLACE, Values, plausible
from modsim3d.voyage.registration.residuals import Residuals

SOFT = 1.5
"""Spreads beyond which a residual counts less (the soft loss of `scipy.optimize.least_squares`)."""
MOST = 12
STEP = 1e-3
"""Step of the numerical derivatives, in plausible distances."""
MEAN_NAMES = tuple(parameter.name for parameter in MEAN_ERRORS)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Which of the parameters a fit looks for, as one vector.

    Attributes:
        shared: Names of shared ones, in the order of `SHARED`.
        spreads: How far the values of vessels are from zero, as standard deviations of along, across and delay, shape
            (3,); a value with zero is not looked for.
        vessels: Indices of the vessels whose values are looked for, shape (k,).
    """

    shared: tuple[str, ...]
    spreads: Array
    vessels: Indices

    @property
    def own(self) -> Indices:
        """Which of along, across and delay are looked for."""
        return np.flatnonzero(self.spreads > 0)

    @property
    def places(self) -> list[int]:
        """Places of the shared ones in `Values.shared`."""
        return [PLACE[name] for name in self.shared]

    def vector(self, values: Values) -> Array:
        """Values as a vector in plausible distances, and of vessels in their spreads."""
        own = values.vessels[np.ix_(self.vessels, self.own)] / self.spreads[self.own]
        return np.concatenate([values.shared[self.places] / plausible(self.shared), own.ravel()])

    def values(self, vector: Array, start: Values) -> Values:
        """The values of a vector; others as at the start."""
        shared, vessels = start.shared.copy(), start.vessels.copy()
        count = len(self.shared)
        shared[self.places] = vector[:count] * plausible(self.shared)
        own = vector[count:].reshape(len(self.vessels), len(self.own))
        vessels[np.ix_(self.vessels, self.own)] = own * self.spreads[self.own]
        return Values(shared, vessels)


def derivatives(model: BoxModel, residuals: Residuals, values: Values, names: tuple[str, ...]) -> Array:
    """Derivatives of residuals in pixels by named parameters, in pixels per unit, shape (m, len(names)).

    Of a vessel's parameter it is the derivative of the vessel's own rows.
    """
    columns = np.empty((len(residuals.row), len(names)))
    here = residuals.px(model, values)
    for column, (name, scale) in enumerate(zip(names, plausible(names), strict=True)):
        if name in MEAN_NAMES:
            columns[:, column] = -residuals.of_mean_errors[:, MEAN_NAMES.index(name)]
            continue
        step = STEP * scale
        columns[:, column] = (residuals.px(model, values.moved(name, step)) - here) / step
    return columns


def fit(
    model: BoxModel,
    residuals: Residuals,
    start: Values,
    unknowns: Unknowns,
    spreads_px: Array,
    *,
    tied: bool = False,
    most: int | None = None,
) -> Values:
    """The values that fit best, from a start; see `Unknowns` for those that are looked for.

    With `tied`, shared ones are held near the scene's values, each as by one measurement with the plausible distance
    as its standard deviation, so that what the data do not determine stays where it is. `most` ends a rough fit after
    so many evaluations.
    """
    vessel_names = [OF_A_VESSEL[own].name for own in unknowns.own]
    place = np.full(len(model.hulls_m), -1)
    place[unknowns.vessels] = np.arange(len(unknowns.vessels))
    row_of, count = place[residuals.vessel], len(unknowns.shared)
    priors = len(unknowns.vessels) * len(vessel_names)
    ties = count if tied else 0
    weights = np.concatenate([plausible(unknowns.shared), unknowns.spreads[unknowns.own]])

    def of(vector: Array) -> Array:
        px = residuals.px(model, unknowns.values(vector, start))
        return np.concatenate([np.nan_to_num(px / spreads_px, nan=1e3), vector[count - ties :]])

    def slopes(vector: Array) -> Array:
        values = unknowns.values(vector, start)
        each = derivatives(model, residuals, values, (*unknowns.shared, *vessel_names)) * weights / spreads_px[:, None]
        each = np.nan_to_num(each, nan=0.0)
        jacobian = np.zeros((len(each) + ties + priors, count + priors))
        jacobian[: len(each), :count] = each[:, :count]
        known = np.flatnonzero(row_of >= 0)
        for own in range(len(vessel_names)):
            jacobian[known, count + row_of[known] * len(vessel_names) + own] = each[known, count + own]
        jacobian[len(each) :, count - ties :] = np.eye(ties + priors)
        return jacobian

    first = unknowns.vector(start)
    found = least_squares(of, first, slopes, loss="soft_l1", f_scale=SOFT, xtol=1e-4, ftol=1e-5, max_nfev=most or MOST)
    return unknowns.values(found.x, start)
