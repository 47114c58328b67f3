"""Counts of a run: in all, by camera, by performance state and by vessel, as rows of tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.arrays import Mask
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.runs.run_rows import RunRows

Rows = list[tuple[str, ...]]

_DETECTED = ("Annotated", "Detected", "Missed", "Miss rate")
_BOXES = ("Wrong class", "IoU below 0.5", "Off its vessel")
_FALSE = ("False alarms", "Share of detections")
VESSEL_HEADER = ("Vessel", "Frames", "Partly hidden", "Wholly hidden", *_DETECTED, *_BOXES)
STATE_HEADER = ("Performance state", "Frames", *_DETECTED, *_BOXES, *_FALSE)
CAMERA_HEADER = ("Camera", "Frames", *_DETECTED, *_BOXES, *_FALSE)


@dataclass(frozen=True)
class DetectorCounts:
    """What a detector made of some frames, with the names of `modsim3d.runs.counts.Counts`.

    Attributes:
        true_detections: Detections of vessels; fewer than `detected` where one box is of two vessels.
    """

    annotated: int
    detected: int
    true_detections: int
    mislabelled: int
    below_half_iou: int
    off_vessel: int
    false_positives: int

    @property
    def missed(self) -> int:
        """Annotated vessels that were not detected."""
        return self.annotated - self.detected

    @property
    def detections(self) -> int:
        """All detections."""
        return self.true_detections + self.false_positives

    @property
    def bad_share(self) -> float:
        """Share of the true detections whose box has IoU below 0.5 with its vessel's; 0 if there are none."""
        return self.below_half_iou / max(self.true_detections, 1)

    def named(self) -> Rows:
        """Name, count and what the count is a share of."""
        every, true = f"of {self.detections} detections", f"of {self.true_detections} true detections"
        return [
            ("Annotated", str(self.annotated), "vessels in frames, given to the detector"),
            ("Detected", str(self.detected), f"{_share(self.detected, self.annotated)} of annotated"),
            ("Missed", str(self.missed), f"{_share(self.missed, self.annotated)} of annotated"),
            ("False alarms", str(self.false_positives), f"{_share(self.false_positives, self.detections)} {every}"),
            ("Wrong class", str(self.mislabelled), f"{_share(self.mislabelled, self.true_detections)} {true}"),
            ("IoU below 0.5", str(self.below_half_iou), f"{_share(self.below_half_iou, self.true_detections)} {true}"),
            ("Off their vessel", str(self.off_vessel), f"{_share(self.off_vessel, self.true_detections)} {true}"),
        ]

    def cells(self) -> tuple[str, ...]:
        """The columns `_DETECTED` and `_BOXES` of a table."""
        boxes = self.mislabelled, self.below_half_iou, self.off_vessel
        detected = *map(str, (self.annotated, self.detected, self.missed)), _share(self.missed, self.annotated)
        return *detected, *map(str, boxes)

    def false_cells(self) -> tuple[str, str]:
        """The columns `_FALSE` of a table."""
        return str(self.false_positives), _share(self.false_positives, self.detections)


class CountTables:
    """Tables of counts over all steps of a run. A frame is one camera at one step."""

    def __init__(self, rows: RunRows) -> None:
        """Find what is counted in the rows of a run."""
        self._rows = rows
        visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
        self._partly_hidden = (visible_px > 0) & (visible_px < silhouette_px)
        self._wholly_hidden = (visible_px == 0) & (silhouette_px > 0)
        self.total = self._counts(np.ones(len(rows.annotated), bool), np.ones(len(rows.outcomes), bool))

    def _counts(self, truth: Mask, detections: Mask) -> DetectorCounts:
        """The counts of some rows of the truth, shape (n,), and some detections, shape (m,)."""
        annotated, outcome = self._rows.annotated & truth, self._rows.outcomes[detections]
        false = int(having(outcome, Outcome.FALSE_POSITIVE).sum())
        return DetectorCounts(
            annotated=int(annotated.sum()),
            detected=int((annotated & self._rows.detected).sum()),
            true_detections=len(outcome) - false,
            mislabelled=int(having(outcome, Outcome.MISLABELLED).sum()),
            below_half_iou=int(having(outcome, Outcome.BELOW_HALF_IOU).sum()),
            off_vessel=int(having(outcome, Outcome.OFF_VESSEL).sum()),
            false_positives=false,
        )

    def overall(self) -> Rows:
        """Name, count and its share of everything that happened, summed over frames."""
        vessels, partly_hidden = len(self._rows.annotated), int(self._partly_hidden.sum())
        return [
            ("Frames", str(len(self._rows.frame_state)), ""),
            ("Vessels in frames", str(vessels), "summed over frames"),
            ("Partly hidden", str(partly_hidden), f"{_share(partly_hidden, vessels)} of vessels in frames"),
            ("Wholly hidden", str(int(self._wholly_hidden.sum())), ""),
            *self.total.named(),
        ]

    def by_vessel(self) -> Rows:
        """A row for each vessel, with the columns of `VESSEL_HEADER`."""
        table = []
        for index, name in enumerate(self._rows.scene.vessel_names):
            mine = self._rows.truth_vessel == index
            hidden = [int((mine & column).sum()) for column in (mine, self._partly_hidden, self._wholly_hidden)]
            counts = self._counts(mine, self._rows.detection_vessel == index)
            table.append((name, *map(str, hidden), *counts.cells()))
        return table

    def by_state(self) -> Rows:
        """A row for each performance state, with the columns of `STATE_HEADER`."""
        rows, names = self._rows, [state.name for state in self._rows.scene.detector.states]
        truth, detections = rows.states_of(rows.truth_frame), rows.states_of(rows.detection_frame)
        return [
            self._row(name, rows.frame_state == index, truth == index, detections == index)
            for index, name in enumerate(names)
        ]

    def by_camera(self) -> Rows:
        """A row for each camera, with the columns of `CAMERA_HEADER`."""
        rows, names = self._rows, [camera.name for camera in self._rows.scene.cameras]
        frame, truth, detections = (each % len(names) for each in (rows.frames, rows.truth_frame, rows.detection_frame))
        return [
            self._row(name, frame == index, truth == index, detections == index) for index, name in enumerate(names)
        ]

    def _row(self, name: str, frames: Mask, truth: Mask, detections: Mask) -> tuple[str, ...]:
        counts = self._counts(truth, detections)
        return name, str(int(frames.sum())), *counts.cells(), *counts.false_cells()


def named_values(values: dict[str, Any], prefix: str = "") -> Rows:
    """The settings of a run as rows, nested ones under a dotted name, without the counts and the list of files."""
    rows: Rows = []
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            rows += [] if name in ("counts", "camera_counts", "files") else named_values(value, f"{name}.")
        else:
            rows.append((name, ", ".join(map(str, value)) if isinstance(value, list) else str(value)))
    return rows


def _share(part: float, whole: float) -> str:
    """A percentage; a dash where there is nothing to have a share of."""
    return f"{part / whole:.1%}" if whole else "–"
