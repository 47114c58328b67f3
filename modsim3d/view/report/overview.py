"""Timeline of a run's page: counts in bins of steps, and the moments worth a look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices, Mask, positions, ranges
from modsim3d.runs.counts import Outcome, having
from modsim3d.scene.scene import Scene
from modsim3d.view.report.packing import NONE, ROW_BEFORE, Codes, Column, Stretches, StretchesBuilder, onsets
from modsim3d.world.vessel_motion import PosesInWaves

UNKNOWN_FRACTION, WHOLE = 255, 250  # visible fractions are counted in 250ths
MISSED, HIDDEN, FALSE, MISLABELLED, BAD, OFF = "missed", "hidden", "false", "mislabelled", "bad", "off"
WRONG = {MISLABELLED: Outcome.MISLABELLED, BAD: Outcome.BELOW_HALF_IOU, OFF: Outcome.OFF_VESSEL}  # of true detections
MOMENT_KINDS = (MISSED, FALSE, MISLABELLED, OFF, BAD, HIDDEN)
BEGINS, ENDS = 0.9 * WHOLE, 0.98 * WHOLE
"""An occlusion begins when at most the first is visible, and ends when more than the second is: a flicker is none."""
LITTLE, HALF = "little", "half"  # stretches with a vessel hidden a little at least, or less than half of it visible
ANNOTATED, DETECTED = 1, 2  # what is so of a row of the truth, as bits of the column `flags`
COUNTS = ("seen", "annotated", MISSED, FALSE, MISLABELLED, BAD, OFF)
VESSEL_COUNTS = ("seen", "fraction", MISSED, MISLABELLED, BAD, OFF)
MAX_BINS, MIN_BINS, MAX_CELLS = 6000, 1000, 600_000  # bins of steps, and bins times vessels: as fine as any screen


def steps_in_a_bin(steps: int, vessels: int) -> int:
    """Number of shown steps in each bin of an overview; the last bin may have fewer."""
    most = min(max(MAX_CELLS // max(vessels, 1), MIN_BINS), MAX_BINS)
    return max(1, -(-steps // most))


@dataclass(frozen=True, eq=False)
class ShownRows:
    """Rows of one camera at i shown steps: n of the truth and m detections, one for each step that shows it."""

    index: Indices  # of each shown step, shape (i,)
    state: Indices  # number of the performance state at each of them, shape (i,)
    truth_index: Indices  # of the step of each row of the truth, shape (n,)
    vessel: Indices  # of each row of the truth, shape (n,)
    annotated: Mask  # shape (n,)
    missed: Mask  # shape (n,)
    fraction: Indices  # visible, in 250ths, 250 if it is not known, shape (n,)
    rows: Indices  # the least and the greatest row of the box, in quanta, shape (n, 2)
    drawn_index: Indices  # of the step of each detection, shape (m,)
    drawn_vessel: Indices  # shape (m,)
    outcome: Column  # shape (m,)

    @classmethod
    def of(cls, index: Indices, frame: Indices, columns: dict[str, Column]) -> ShownRows:
        """From the columns of a part, and the frame in it that the camera shows at each step, shape (i,)."""
        truth, truth_at = rows_of(frame, columns["truthStart"])
        drawn, drawn_at = rows_of(frame, columns["drawnStart"])
        fraction = columns["fraction"][truth].astype(np.int64)
        return cls(
            index=index,
            state=columns["state"][frame].astype(np.int64),
            truth_index=index[truth_at],
            vessel=columns["vessel"][truth].astype(np.int64),
            annotated=columns["flags"][truth] & ANNOTATED > 0,
            missed=columns["flags"][truth] == ANNOTATED,
            fraction=np.where(fraction == UNKNOWN_FRACTION, WHOLE, fraction),
            rows=columns["full"][truth][:, [1, 3]],
            drawn_index=index[drawn_at],
            drawn_vessel=columns["drawnVessel"][drawn].astype(np.int64),
            outcome=columns["outcome"][drawn],
        )

    @property
    def false(self) -> Mask:
        """Mask of the detections that are false positives, shape (m,)."""
        return having(self.outcome, Outcome.FALSE_POSITIVE)


def rows_of(frame: Indices, start: Column) -> tuple[Indices, Indices]:
    """The rows of each of some frames, one after the other, and which of the frames each is of."""
    begins: Indices = start.astype(np.int64)
    first, count = begins[frame], begins[frame + 1] - begins[frame]
    return ranges(first, count), np.repeat(np.arange(len(frame)), count)


class Overview:
    """Counts of one camera in bins of steps, and moments, of a run that comes in parts."""

    def __init__(self, steps: int, vessels: int, states: int) -> None:
        """Begin with none of so many shown steps."""
        self.width = steps_in_a_bin(steps, vessels)
        self._vessels = vessels
        bins = -(-steps // self.width)
        self._states = np.zeros((bins, states), dtype=np.int64)
        self._counts = {name: np.zeros(bins, dtype=np.int64) for name in COUNTS}
        self._of_vessels = {name: np.zeros(vessels * bins, dtype=np.int64) for name in VESSEL_COUNTS}
        self._rows = [NONE, 0]
        self._found = {name: StretchesBuilder() for name in ("state", HALF, LITTLE, *MOMENT_KINDS)}

    def add(self, shown: ShownRows) -> None:
        """Add what the camera shows at some steps."""
        self._found["state"].add(shown.state, shown.index)
        valid = shown.state < self._states.shape[1]
        np.add.at(self._states, (shown.index[valid] // self.width, shown.state[valid]), 1)
        self._count("seen", shown.truth_index, shown.vessel, np.ones(len(shown.vessel), bool))
        self._count("annotated", shown.truth_index, shown.vessel, shown.annotated)
        self._count(MISSED, shown.truth_index, shown.vessel, shown.missed)
        np.add.at(self._of_vessels["fraction"], self._cells(shown.truth_index, shown.vessel), shown.fraction)
        self._find(HIDDEN, shown.truth_index, shown.vessel, shown.fraction <= BEGINS)
        self._find(LITTLE, shown.truth_index, shown.vessel, shown.fraction <= ENDS)
        self._find(HALF, shown.truth_index, shown.vessel, 2 * shown.fraction < WHOLE)
        self._count(FALSE, shown.drawn_index, shown.drawn_vessel, shown.false)
        for name, flag in WRONG.items():
            self._count(name, shown.drawn_index, shown.drawn_vessel, having(shown.outcome, flag) & ~shown.false)
        if len(shown.rows):
            top, bottom = int(shown.rows[:, 0].min()), int(shown.rows[:, 1].max())
            self._rows = [min(self._rows[0], top), max(self._rows[1], bottom)]

    def _count(self, name: str, index: Indices, vessel: Indices, which: Mask) -> None:
        index, vessel = index[which], vessel[which]
        np.add.at(self._counts[name], index // self.width, 1)
        if name in self._of_vessels:
            np.add.at(self._of_vessels[name], self._cells(index, vessel), 1)
        if name == FALSE:
            index = np.unique(index)
            self._found[FALSE].add(np.full(len(index), self._vessels), index)
        elif name in self._found:
            self._found[name].add(vessel, index)

    def _find(self, name: str, index: Indices, vessel: Indices, which: Mask) -> None:
        self._found[name].add(vessel[which], index[which])

    def _cells(self, index: Indices, vessel: Indices) -> Indices:
        return vessel * len(self._states) + index // self.width

    def stretches(self, kind: str) -> Stretches:
        """Stretches of a kind of moment, of `HALF` or of `state`; the key is the vessel or the state."""
        spans = self._found[kind].stretches()
        return onsets(spans, self._found[LITTLE].stretches()) if kind == HIDDEN else spans

    def facts(self, quantum_px: float) -> dict[str, Any]:
        """Steps in a bin, and the least and greatest row of the image, in pixels, that a vessel reaches."""
        seen = self._rows[0] <= self._rows[1]
        return {"width": self.width, "rows": [row * quantum_px for row in self._rows] if seen else None}

    def columns(self, prefix: str, *, half: bool) -> dict[str, Column | Codes]:
        """The counts and the moments by their kinds; with `half`, also where vessels are less than half seen."""
        state = np.where(self._states.any(axis=1), self._states.argmax(axis=1), NONE).astype(np.uint16)
        columns: dict[str, Column | Codes] = {f"{prefix}state": Codes(state, by=ROW_BEFORE)}
        for name, counts in self._counts.items():
            columns[f"{prefix}{name}"] = Codes(counts.astype(np.uint32), by=ROW_BEFORE)
        for name, counts in self._of_vessels.items():
            columns[f"{prefix}vessels.{name}"] = Codes(counts.astype(np.uint32), by=ROW_BEFORE)
        for name in ("state", *([HALF] if half else []), *MOMENT_KINDS):
            spans = self.stretches(name).by_time()
            key = spans.key if name == "state" else np.where(spans.key < self._vessels, spans.key, NONE)
            columns[f"{prefix}moments.{name}.index"] = Codes(spans.first.astype(np.uint32), by=ROW_BEFORE)
            columns[f"{prefix}moments.{name}.long"] = Codes((spans.until - spans.first).astype(np.uint32))
            columns[f"{prefix}moments.{name}.key"] = Codes(key.astype(np.uint16), by=ROW_BEFORE)
        return columns


# ---- What became of each vessel over a run, in stretches of shown steps ----


class VesselOutcome(IntEnum):
    """Fate of a vessel in a frame, from good to bad; of what is wrong with its detection, the worst."""

    NOT_ANNOTATED = 0  # in the image and not given to the detector
    DETECTED = 1  # with nothing wrong with its detection
    WRONG_CLASS = 2
    BELOW_HALF_IOU = 3  # of the box of its detection with its annotated box
    OFF_VESSEL = 4  # the two boxes do not touch
    MISSED = 5  # annotated and not detected


@dataclass(frozen=True, eq=False)
class OutcomeStretches:
    """Stretches of shown steps with one outcome of one vessel, by vessel and time; none while it is not seen."""

    vessel: Indices  # shape (n,)
    outcome: Indices  # number of the `VesselOutcome`, shape (n,)
    first: Indices  # index of the first shown step, shape (n,)
    until: Indices  # index of the last, shape (n,)


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
        spans = self._found.stretches()
        vessel, outcome = np.divmod(spans.key, len(VesselOutcome))
        order = np.lexsort((spans.first, vessel))
        return OutcomeStretches(vessel[order], outcome[order], spans.first[order], spans.until[order])


def vessel_outcomes(shown: ShownRows) -> Indices:
    """The number of the `VesselOutcome` of each row of the truth, shape (n,)."""
    numbers = np.full(len(shown.vessel), VesselOutcome.DETECTED)
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
        numbers[row[having(outcome, flag) & (row != NOBODY)]] = number
    numbers[shown.missed] = VesselOutcome.MISSED
    numbers[~shown.annotated] = VesselOutcome.NOT_ANNOTATED
    return numbers


# ---- The vessels' poses at the steps of one part of a run ----


class PartMotion:
    """Poses of a scene's vessels at some steps; waves make them dear."""

    def __init__(self, scene: Scene, steps: Sequence[Indices]) -> None:
        """Compute the poses at all steps that are in any of these, which are not all empty."""
        self._steps = np.unique(np.concatenate(steps))
        self._poses = scene.motion.at(self._steps)

    def at(self, steps: Indices) -> PosesInWaves:
        """The poses at some of the steps, ascending, shape (S,)."""
        return self._poses.rows(np.searchsorted(self._steps, steps))
