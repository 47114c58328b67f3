"""Counts of a run: in all, by camera, by performance state and by vessel, as rows of tables."""

from collections import defaultdict
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from modsim3d.core.arrays import Indices, Mask
from modsim3d.core.text import percent_of
from modsim3d.runs.counts import Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene

Masks = dict[str, Mask]
Rows = list[tuple[str, ...]]

_DETECTED = ("Annotated", "Detected", "Missed", "Miss rate")
_BOXES = ("Wrong class", "IoU below 0.5", "Off its vessel")
_FALSE = ("False positives", "Share of detections")
_whole = "{:,}".format
VESSEL_HEADER = ("Vessel", "Frames", "Partly hidden", "Wholly hidden", *_DETECTED, *_BOXES)
STATE_HEADER = ("Performance state", "Frames", *_DETECTED, *_BOXES, *_FALSE)
CAMERA_HEADER = ("Camera", "Frames", *_DETECTED, *_BOXES, *_FALSE)


@dataclass(frozen=True)
class DetectorCounts:
    """Counts of a detector's output in some frames, with the names of `modsim3d.runs.counts.Counts`."""

    annotated: int
    detected: int
    true_detections: int  # of vessels; fewer than `detected` where one box is of two vessels
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
        every, true = f"of {self.detections:,} detections", f"of {self.true_detections:,} true detections"
        shares = (
            ("Detected", self.detected, self.annotated, "of annotated"),
            ("Missed", self.missed, self.annotated, "of annotated"),
            ("False positives", self.false_positives, self.detections, every),
            ("Wrong class", self.mislabelled, self.true_detections, true),
            ("IoU below 0.5", self.below_half_iou, self.true_detections, true),
            ("Off their vessel", self.off_vessel, self.true_detections, true),
        )
        said = [(name, f"{count:,}", f"{percent_of(count, whole)} {of}") for name, count, whole, of in shares]
        return [("Annotated", f"{self.annotated:,}", "vessels in frames, given to the detector"), *said]

    def cells(self) -> tuple[str, ...]:
        """The columns `_DETECTED` and `_BOXES` of a table."""
        boxes = self.mislabelled, self.below_half_iou, self.off_vessel
        detected = *map(_whole, (self.annotated, self.detected, self.missed)), percent_of(self.missed, self.annotated)
        return *detected, *map(_whole, boxes)


class CountTables:
    """Tables of counts over all steps of a run, which may come in parts. A frame is one camera at one step."""

    def __init__(self, scene: Scene) -> None:
        """Begin with nothing counted."""
        self._scene, self._overall = scene, _Tally(1)
        self._of_vessels = _Tally(len(scene.vessels))
        self._of_states = _Tally(len(scene.detector.states))
        self._of_cameras = _Tally(len(scene.cameras))

    def add(self, rows: RunRows) -> None:
        """Count the rows of some steps."""
        truth, detections = _truth_counts(rows), _detection_counts(rows)
        cameras = len(self._scene.cameras)
        of_frames, of_truth, of_detections = rows.frames, rows.truth_frame, rows.detection_frame
        zero = np.zeros_like
        self._overall.add(zero(of_frames), zero(of_truth), zero(of_detections), truth, detections)
        self._of_cameras.add(of_frames % cameras, of_truth % cameras, of_detections % cameras, truth, detections)
        state = rows.states_of
        self._of_states.add(rows.frame_state, state(of_truth), state(of_detections), truth, detections)
        none = np.empty(0, dtype=np.int64)
        self._of_vessels.add(none, rows.truth_vessel, rows.detection_vessel, truth, detections)

    @property
    def total(self) -> DetectorCounts:
        """Counts over all frames."""
        return self._overall.counts(0)

    def overall(self) -> Rows:
        """Name, count and its share of everything that happened, summed over frames."""
        vessels, partly_hidden, wholly_hidden = (self._overall.of(name, 0) for name in _SEEN)
        return [
            ("Frames", _whole(self._overall.of("frames", 0)), ""),
            ("Vessels in frames", _whole(vessels), "summed over frames"),
            ("Partly hidden", _whole(partly_hidden), f"{percent_of(partly_hidden, vessels)} of vessels in frames"),
            ("Wholly hidden", _whole(wholly_hidden), ""),
            *self.total.named(),
        ]

    def by_vessel(self) -> Rows:
        """A row for each vessel, with the columns of `VESSEL_HEADER`."""
        tally = self._of_vessels
        return [
            (name, *(_whole(tally.of(column, index)) for column in _SEEN), *tally.counts(index).cells())
            for index, name in enumerate(self._scene.vessel_names)
        ]

    def by_state(self) -> Rows:
        """A row for each performance state, with the columns of `STATE_HEADER`."""
        return self._of_states.rows([state.name for state in self._scene.detector.states])

    def by_camera(self) -> Rows:
        """A row for each camera, with the columns of `CAMERA_HEADER`."""
        return self._of_cameras.rows([camera.name for camera in self._scene.cameras])


_SEEN = ("vessels", "partly_hidden", "wholly_hidden")


class _Tally:
    """Sums of columns of ones and zeros over rows, by the number of a group."""

    def __init__(self, groups: int) -> None:
        self._groups = groups
        self._sums: dict[str, Indices] = defaultdict(lambda: np.zeros(groups, dtype=np.int64))

    def add(self, frames: Indices, truth_of: Indices, detections_of: Indices, truth: Masks, detections: Masks) -> None:
        """Add rows: the groups of frames, of rows of the truth and of detections, −1 for none; and their columns."""
        self._sums["frames"] += np.bincount(frames, minlength=self._groups)
        for group, columns in ((truth_of, truth), (detections_of, detections)):
            for name, column in columns.items():
                self._sums[name] += np.bincount(group[column & (group >= 0)], minlength=self._groups)

    def of(self, name: str, group: int) -> int:
        return int(self._sums[name][group])

    def counts(self, group: int) -> DetectorCounts:
        return DetectorCounts(**{field.name: self.of(field.name, group) for field in fields(DetectorCounts)})

    def rows(self, names: list[str]) -> Rows:
        rows = []
        for index, name in enumerate(names):
            counts = self.counts(index)
            false = _whole(counts.false_positives), percent_of(counts.false_positives, counts.detections)
            rows.append((name, _whole(self.of("frames", index)), *counts.cells(), *false))
        return rows


def _truth_counts(rows: RunRows) -> Masks:
    """Masks of the truth by what is counted, shape (n,) each."""
    visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
    return {
        "vessels": np.ones(len(visible_px), dtype=bool),
        "partly_hidden": (visible_px > 0) & (visible_px < silhouette_px),
        "wholly_hidden": (visible_px == 0) & (silhouette_px > 0),
        "annotated": rows.annotated,
        "detected": rows.annotated & rows.detected,
    }


def _detection_counts(rows: RunRows) -> Masks:
    """Masks of the detections by what is counted, shape (m,) each."""
    false = having(rows.outcomes, Outcome.FALSE_POSITIVE)
    return {
        "true_detections": ~false,
        "mislabelled": having(rows.outcomes, Outcome.MISLABELLED),
        "below_half_iou": having(rows.outcomes, Outcome.BELOW_HALF_IOU),
        "off_vessel": having(rows.outcomes, Outcome.OFF_VESSEL),
        "false_positives": false,
    }


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
