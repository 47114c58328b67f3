"""Counts of a run: in all, by camera, by performance state and by vessel, as rows of tables."""

from collections import defaultdict
from typing import Any

import numpy as np

from modsim3d.core.arrays import Indices
from modsim3d.core.text import percent_of
from modsim3d.runs.counts import Counts, Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene

Rows = list[tuple[str, ...]]

_DETECTED = ("Annotated", "Detected", "Missed", "Miss rate")
_BOXES = ("Wrong class", "IoU below 0.5", "Off its vessel")
_FALSE = ("False positives", "Share of detections")
_whole = "{:,}".format
VESSEL_HEADER = ("Vessel", "Frames", "Partly hidden", "Wholly hidden", *_DETECTED, *_BOXES)
STATE_HEADER = ("Performance state", "Frames", *_DETECTED, *_BOXES, *_FALSE)
CAMERA_HEADER = ("Camera", "Frames", *_DETECTED, *_BOXES, *_FALSE)


def named_counts(counts: Counts) -> Rows:
    """Name, count and what the count is a share of."""
    every, true = counts.true_detections + counts.false_positives, counts.true_detections
    of_true = f"of {true:,} true detections"
    shares = (
        ("Detected", counts.detected, counts.annotated, "of annotated"),
        ("Missed", counts.missed, counts.annotated, "of annotated"),
        ("False positives", counts.false_positives, every, f"of {every:,} detections"),
        ("Wrong class", counts.mislabelled, true, of_true),
        ("IoU below 0.5", counts.below_half_iou, true, of_true),
        ("Off their vessel", counts.off_vessel, true, of_true),
    )
    rows = [(name, f"{count:,}", f"{percent_of(count, whole)} {of}") for name, count, whole, of in shares]
    return [("Annotated", f"{counts.annotated:,}", "vessels in frames, given to the detector"), *rows]


def _cells(counts: Counts) -> tuple[str, ...]:
    """The columns `_DETECTED` and `_BOXES` of a table."""
    detected = (
        *map(_whole, (counts.annotated, counts.detected, counts.missed)),
        percent_of(counts.missed, counts.annotated),
    )
    return *detected, *map(_whole, (counts.mislabelled, counts.below_half_iou, counts.off_vessel))


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
        cameras, none = len(self._scene.cameras), np.empty(0, dtype=np.int64)
        frames = rows.frames, rows.truth_frame, rows.detection_frame
        self._overall.add(rows, *(np.zeros_like(frame) for frame in frames))
        self._of_cameras.add(rows, *(frame % cameras for frame in frames))
        self._of_states.add(rows, *map(rows.states_of, frames))
        self._of_vessels.add(rows, none, rows.truth_vessel, rows.detection_vessel)

    @property
    def total(self) -> Counts:
        """Counts over all frames."""
        return self._overall.counts(0)

    def overall(self) -> Rows:
        """Name, count and its share of everything that happened, summed over frames."""
        counts = self.total
        hidden = f"{percent_of(counts.partly_hidden, counts.vessel_frames)} of vessels in frames"
        return [
            ("Frames", _whole(counts.frames), ""),
            ("Vessels in frames", _whole(counts.vessel_frames), "summed over frames"),
            ("Partly hidden", _whole(counts.partly_hidden), hidden),
            ("Wholly hidden", _whole(counts.fully_hidden), ""),
            *named_counts(counts),
        ]

    def by_vessel(self) -> Rows:
        """A row for each vessel, with the columns of `VESSEL_HEADER`."""
        named = ((name, self._of_vessels.counts(index)) for index, name in enumerate(self._scene.vessel_names))
        return [
            (name, *map(_whole, (vessel.vessel_frames, vessel.partly_hidden, vessel.fully_hidden)), *_cells(vessel))
            for name, vessel in named
        ]

    def by_state(self) -> Rows:
        """A row for each performance state, with the columns of `STATE_HEADER`."""
        return self._of_states.rows([state.name for state in self._scene.detector.states])

    def by_camera(self) -> Rows:
        """A row for each camera, with the columns of `CAMERA_HEADER`."""
        return self._of_cameras.rows([camera.name for camera in self._scene.cameras])


class _Tally:
    """Sums over rows by the number of a group."""

    def __init__(self, groups: int) -> None:
        self._groups = groups
        self._sums: dict[str, Indices] = defaultdict(lambda: np.zeros(groups, dtype=np.int64))

    def add(self, rows: RunRows, frames: Indices, of_truth: Indices, of_detections: Indices) -> None:
        """Add rows: the groups of frames, of rows of the truth and of detections, −1 for none."""
        self._sums["frames"] += np.bincount(frames, minlength=self._groups)
        visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
        false = having(rows.outcomes, Outcome.FALSE_POSITIVE)
        for name, group, counted in (
            ("vessel_frames", of_truth, np.ones(len(of_truth), dtype=bool)),
            ("partly_hidden", of_truth, (visible_px > 0) & (visible_px < silhouette_px)),
            ("fully_hidden", of_truth, (visible_px == 0) & (silhouette_px > 0)),
            ("annotated", of_truth, rows.annotated),
            ("detected", of_truth, rows.annotated & rows.detected),
            ("missed", of_truth, rows.annotated & ~rows.detected),
            ("true", of_detections, ~false),
            ("mislabelled", of_detections, having(rows.outcomes, Outcome.MISLABELLED)),
            ("below_half_iou", of_detections, having(rows.outcomes, Outcome.BELOW_HALF_IOU)),
            ("off_vessel", of_detections, having(rows.outcomes, Outcome.OFF_VESSEL)),
            ("false_positives", of_detections, false),
        ):
            self._sums[name] += np.bincount(group[counted & (group >= 0)], minlength=self._groups)

    def counts(self, group: int) -> Counts:
        sums = {name: int(counted[group]) for name, counted in self._sums.items()}
        return Counts(merged=sums["detected"] - sums.pop("true"), **sums)

    def rows(self, names: list[str]) -> Rows:
        rows = []
        for index, name in enumerate(names):
            counts = self.counts(index)
            every = counts.true_detections + counts.false_positives
            false = _whole(counts.false_positives), percent_of(counts.false_positives, every)
            rows.append((name, _whole(counts.frames), *_cells(counts), *false))
        return rows


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
