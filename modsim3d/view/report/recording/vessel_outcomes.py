"""What became of each vessel over a run, in stretches of shown steps: two runs differ where their stretches do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.runs.files.columns import NOBODY, positions
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.view.report.recording.overview import ShownRows
from modsim3d.view.report.recording.stretches import StretchesBuilder


class VesselOutcome(IntEnum):
    """What became of a vessel in a frame, from good to bad; of what is wrong with its detection, the worst.

    Attributes:
        NOT_ANNOTATED: It is in the image and was not given to the detector.
        DETECTED: It was detected, and nothing is wrong with its detection.
        WRONG_CLASS: Its detection has another class.
        BELOW_HALF_IOU: The box of its detection has IoU below 0.5 with its annotated box.
        OFF_VESSEL: The two boxes do not touch.
        MISSED: It was annotated and not detected.
    """

    NOT_ANNOTATED = 0
    DETECTED = 1
    WRONG_CLASS = 2
    BELOW_HALF_IOU = 3
    OFF_VESSEL = 4
    MISSED = 5


@dataclass(frozen=True, eq=False)
class OutcomeStretches:
    """Stretches of shown steps with one outcome of one vessel, in order of vessel and time; none while it is not seen.

    Attributes:
        vessel: Index of the vessel, shape (n,).
        outcome: Number of the `VesselOutcome`, shape (n,).
        first: Index of the first shown step, shape (n,).
        until: Index of the last, shape (n,).
    """

    vessel: Indices
    outcome: Indices
    first: Indices
    until: Indices


class OutcomesBuilder:
    """The outcomes of one camera's vessels, of a run that comes in parts."""

    def __init__(self) -> None:
        """Begin with none."""
        self._found = StretchesBuilder()

    def add(self, shown: ShownRows) -> None:
        """Add what the camera shows at some steps."""
        self._found.add(shown.vessel * len(VesselOutcome) + vessel_outcomes(shown), shown.truth_index)

    def stretches(self) -> OutcomeStretches:
        """All of them."""
        found = self._found.stretches()
        vessel, outcome = np.divmod(found.key, len(VesselOutcome))
        order = np.lexsort((found.first, vessel))
        return OutcomeStretches(vessel[order], outcome[order], found.first[order], found.until[order])


def vessel_outcomes(shown: ShownRows) -> Indices:
    """The number of the `VesselOutcome` of each row of the truth, shape (n,)."""
    found = np.full(len(shown.vessel), VesselOutcome.DETECTED)
    stride = 1 + max(int(shown.vessel.max(initial=0)), int(shown.drawn_vessel.max(initial=0)))
    true = ~shown.false
    wanted = (shown.drawn_index * stride + shown.drawn_vessel)[true]
    row, outcome = positions(shown.truth_index * stride + shown.vessel, wanted), shown.outcome[true]
    worst_last = (
        (Outcome.MISLABELLED, VesselOutcome.WRONG_CLASS),
        (Outcome.BELOW_HALF_IOU, VesselOutcome.BELOW_HALF_IOU),
        (Outcome.OFF_VESSEL, VesselOutcome.OFF_VESSEL),
    )
    for flag, number in worst_last:
        found[row[having(outcome, flag) & (row != NOBODY)]] = number
    found[shown.missed] = VesselOutcome.MISSED
    found[~shown.annotated] = VesselOutcome.NOT_ANNOTATED
    return found
