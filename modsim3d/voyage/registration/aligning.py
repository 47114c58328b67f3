"""Matches and fits in turn, with ever closer gates, until the matches stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.voyage.registration.boxes_at_times import BoxesAtTimes
from modsim3d.voyage.registration.fitting import Unknowns, fit
from modsim3d.voyage.registration.hiding import Hiding
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.parameters import SHARED_NAMES, Values
from modsim3d.voyage.registration.residuals import KINDS, Residuals
from modsim3d.voyage.registration.sightings import Predictions, Sightings, match, predict

FIRST = ("clock_s", "yaw_deg", "pitch_deg")
THEN = (*FIRST, "roll_deg", "height_m", "focal_share")
GATES_DEG = (1.5, 1.0, 0.6)
GATE_SHARE = 0.3
"""A gate grows by this share of the box's size, as errors of boxes do."""
SPREADS = 4.5
"""The last gates in spreads of the residuals."""
MOST_ROUNDS = 10
SAME = 0.003
"""The matches stay if fewer than this share of them change."""
LEAST_FIT = 10
ROUGH = 4
"""Iterations of a rough fit."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Values, the matches that they give, and their residuals with spreads in pixels, shapes (m,)."""

    values: Values
    sightings: Sightings
    residuals: Residuals
    spreads_px: Array


@dataclass(frozen=True, eq=False)
class Aligner:
    """What an alignment needs of the scene and the detections.

    Attributes:
        free: Names of the shared parameters that may change.
        use_sizes: Whether widths and heights count.
    """

    model: BoxModel
    hiding: Hiding
    found: BoxesAtTimes
    free: tuple[str, ...]
    use_sizes: bool

    def first(self, start: Values) -> Alignment:
        """A rough alignment from a guess."""
        values = start
        for gate_deg, names in zip(GATES_DEG, (FIRST, THEN, SHARED_NAMES), strict=True):
            predicted = predict(self.model, self.hiding, values, self.found.times_s)
            gate = np.radians(gate_deg) * self.model.traffic.camera.intrinsics.focal_px[0]
            sightings = self._match(predicted, gate + GATE_SHARE * sizes(predicted.boxes_px))
            aligned = self._fitted(sightings, values, self._unknowns(names), tied=True, most=ROUGH)
            values = aligned.values
        return aligned

    def until_stable(
        self, aligned: Alignment, unknowns: Unknowns, *, tied: bool, rounds: int = MOST_ROUNDS
    ) -> Alignment:
        """Match and fit until the matches stay, at most so many times."""
        for _ in range(rounds):
            predicted = predict(self.model, self.hiding, aligned.values, self.found.times_s)
            sightings = self._match(predicted, self._close_gates(aligned, predicted))
            before, aligned = aligned.sightings, self._fitted(sightings, aligned.values, unknowns, tied=tied)
            was, now = (seen.detection * len(self.model.hulls_m) + seen.vessel for seen in (before, sightings))
            if len(np.setxor1d(was, now)) <= SAME * max(len(sightings), 1):
                break
        return aligned

    def matched(self, aligned: Alignment) -> Alignment:
        """The matches of the detections with the values of another alignment, and no fit."""
        predicted = predict(self.model, self.hiding, aligned.values, self.found.times_s)
        sightings = self._match(predicted, self._close_gates(aligned, predicted))
        return self._fitted(sightings, aligned.values, self._unknowns(()), tied=False)

    def _unknowns(self, names: tuple[str, ...]) -> Unknowns:
        chosen = tuple(name for name in names if name in self.free)
        return Unknowns(chosen, np.zeros(3), np.empty(0, dtype=np.int64))

    def all_unknowns(self) -> Unknowns:
        """All shared ones that may change."""
        return self._unknowns(SHARED_NAMES)

    def _match(self, predicted: Predictions, gates_px: Array) -> Sightings:
        return match(self.found, predicted, self.model.traffic.camera.intrinsics.image_size_px, gates_px)

    def _fitted(
        self, sightings: Sightings, start: Values, unknowns: Unknowns, *, tied: bool, most: int | None = None
    ) -> Alignment:
        residuals = Residuals.of(sightings, use_sizes=self.use_sizes)
        values = start
        for _ in range(2 if most else 1):  # the spreads follow from the residuals, which follow from the fit
            spreads = residuals.spreads_px(np.nan_to_num(residuals.px(self.model, values), nan=0.0))
            if len(residuals.row) < LEAST_FIT or not unknowns.shared:
                break
            values = fit(self.model, residuals, values, unknowns, spreads, tied=tied, most=most)
        return Alignment(values, sightings, residuals, spreads)

    def _close_gates(self, aligned: Alignment, predicted: Predictions) -> Array:
        """Gates from the spreads of the residuals of centres and waterlines, which grow with size, shape (m, 2)."""
        residuals, gates = aligned.residuals, np.empty((len(predicted.frame), 2))
        px = np.abs(np.nan_to_num(residuals.px(self.model, aligned.values), nan=0.0))
        for axis, kind in enumerate((KINDS.index("centre"), KINDS.index("waterline"))):
            rows: Indices = np.flatnonzero(residuals.kind == kind)
            typical = np.median(px[rows] / usual_px(residuals.size_px[rows])) if len(rows) else 1.0
            gates[:, axis] = SPREADS * 1.4826 * max(typical, 0.5) * usual_px(sizes(predicted.boxes_px)[:, axis])
        return gates


def usual_px(size_px: Array) -> Array:
    """The usual size of box errors, in pixels, of boxes of a width or height."""
    usual: Array = 1 + 0.05 * size_px
    return usual
