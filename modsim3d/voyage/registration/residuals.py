"""What a match says: how far detected bearings, waterlines and sizes are from those of the model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.parameters import MEAN_ERRORS, PLACE, Values
from modsim3d.voyage.registration.sightings import Sightings

KINDS = ("centre", "left", "right", "waterline", "width", "height")
OF_EDGES = np.array(
    [[0.5, 0, 0.5, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 1, 0], [0, -1, 0, 1]], dtype=np.float64
)
"""Each kind from the left, top, right and bottom edge, shape (6, 4)."""
OF_MEAN_ERRORS = np.array(
    [[1, 0, 0, 0], [1, 0, -0.5, 0], [1, 0, 0.5, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64
)
"""Each kind from the errors of the box in x, y, width and height in pixels, shape (6, 4)."""
SIDE = np.array([0, 0, 0, 1, 0, 1])
"""Whether a kind's error grows with the box's width (0) or height (1)."""
LEAST_PX = 0.3
BINS = 6


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of n sightings: m rows, one for each sighting and kind that its usable edges allow.

    Attributes:
        sightings: The sightings.
        row: Index of the sighting, shape (m,).
        kind: Index into `KINDS`, shape (m,).
        observed_px: What was detected, shape (m,).
        size_px: Expected width or height, whichever the kind's error grows with, shape (m,).
    """

    sightings: Sightings
    row: Indices
    kind: Indices
    observed_px: Array
    size_px: Array

    @classmethod
    def of(cls, sightings: Sightings, *, use_sizes: bool) -> Residuals:
        """Those of sightings. One side alone counts where the other is not usable."""
        left, top, right, bottom = sightings.usable.T
        both, tall = left & right, top & bottom
        kinds = [both, left & ~right, right & ~left, bottom, both & use_sizes, tall & use_sizes]
        row, kind = np.nonzero(np.stack(kinds, axis=1))
        sides = np.maximum(sizes(sightings.expected_px[row]), 1.0)
        size = np.take_along_axis(sides, SIDE[kind][:, None], axis=1)[:, 0]
        observed = (OF_EDGES[kind] * sightings.boxes_px[row]).sum(axis=1)
        return cls(sightings, row, kind, observed, size)

    @property
    def vessel(self) -> Indices:
        """Vessel of each row, shape (m,)."""
        return self.sightings.vessel[self.row]

    def px(self, model: BoxModel, values: Values) -> Array:
        """Detected less expected in pixels, shape (m,)."""
        seen = self.sightings
        edges = model.edges(values, seen.time_s, seen.vessel, seen.corners_m)
        return self.observed_px - self._of_edges(edges) - self._mean_errors(values)

    def _of_edges(self, edges_px: Array) -> Array:
        used = OF_EDGES[self.kind]
        return np.asarray((used * np.where(used == 0, 0.0, edges_px[self.row])).sum(axis=1))

    @cached_property
    def of_mean_errors(self) -> Array:
        """What a unit of each of `MEAN_ERRORS` adds to what is detected, in pixels, shape (m, 4)."""
        unit = np.ones((len(self.row), 4))
        unit[:, 2:] = np.maximum(sizes(self.sightings.expected_px[self.row]), 1.0)
        return np.asarray(OF_MEAN_ERRORS[self.kind] * unit)

    def _mean_errors(self, values: Values) -> Array:
        first = PLACE[MEAN_ERRORS[0].name]
        shift: Array = self.of_mean_errors @ values.shared[first : first + len(MEAN_ERRORS)]
        return shift

    def spreads_px(self, residuals_px: Array) -> Array:
        """Spread of each row's residual in pixels, shape (m,): by kind, and by size where there are enough rows.

        The spread is 1.48 times the median absolute residual, which no wrong match pulls. It is measured about zero in
        bins of size, and interpolated in the logarithm of the size.
        """
        spread = np.ones(len(self.row))
        for kind in range(len(KINDS)):
            rows = np.flatnonzero(self.kind == kind)
            if not len(rows):
                continue
            size, absolute = np.log(self.size_px[rows]), np.abs(residuals_px[rows])
            bins = np.array_split(np.argsort(size, kind="stable"), min(BINS, max(len(rows) // 40, 1)))
            middle = np.array([np.median(size[some]) for some in bins])
            typical = np.array([max(1.4826 * np.median(absolute[some]), LEAST_PX) for some in bins])
            spread[rows] = np.exp(np.interp(size, middle, np.log(typical)))
        return spread
