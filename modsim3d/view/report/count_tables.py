"""Counts of a run by vessel and by performance state, as rows of tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from modsim3d.runs.files.columns import indices
from modsim3d.runs.run_rows import RunRows

Rows = list[tuple[str, ...]]

VESSEL_HEADER = ("Vessel", "Frames", "Partly hidden", "Wholly hidden", "Annotated", "Detected", "Missed", "Miss rate")
STATE_HEADER = (
    *("Performance state", "Frames", "Annotated", "Detected", "Missed", "Miss rate"),
    *("False positives", "Share of detections"),
)


class CountTables:
    """Tables of counts over all steps of a run. A frame is one camera at one step."""

    def __init__(self, rows: RunRows) -> None:
        """Find what is counted in the rows of a run."""
        self._rows, scene, known = rows, rows.scene, rows.detection_vessel >= 0
        visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
        self._partly_hidden = (visible_px > 0) & (visible_px < silhouette_px)
        self._wholly_hidden = (visible_px == 0) & (silhouette_px > 0)
        self._detected = rows.annotated & rows.detected
        self._truth_state = rows.states_of(rows.truth_frame)
        self._false_state = rows.states_of(rows.detection_frame[~known])
        labels = scene.detector.labels
        true_label = np.array([labels.index(vessel.label) for vessel in scene.vessels])
        label = indices(rows.detections, "label", labels)
        self._mislabelled = int((label[known] != true_label[rows.detection_vessel[known]]).sum())

    def overall(self) -> Rows:
        """Name, count and its share of everything that happened, summed over frames."""
        vessels, partly_hidden = len(self._rows.annotated), int(self._partly_hidden.sum())
        annotated, detected = int(self._rows.annotated.sum()), int(self._detected.sum())
        false = len(self._false_state)
        return [
            ("Frames", str(len(self._rows.frame_state)), ""),
            ("Vessels in frames", str(vessels), "summed over frames"),
            ("Partly hidden", str(partly_hidden), _share(partly_hidden, vessels)),
            ("Wholly hidden", str(int(self._wholly_hidden.sum())), ""),
            ("Annotated", str(annotated), "given to the detector"),
            ("Detected", str(detected), f"{_share(detected, annotated)} of annotated"),
            ("Missed", str(annotated - detected), f"{_share(annotated - detected, annotated)} of annotated"),
            ("Mislabelled", str(self._mislabelled), f"{_share(self._mislabelled, detected)} of detected"),
            ("False positives", str(false), f"{_share(false, detected + false)} of all detections"),
        ]

    def by_vessel(self) -> Rows:
        """A row for each vessel, with the columns of `VESSEL_HEADER`."""
        table = []
        for index, name in enumerate(self._rows.scene.vessel_names):
            mine = self._rows.truth_vessel == index
            columns = (mine, self._partly_hidden, self._wholly_hidden, self._rows.annotated, self._detected)
            counts = [int((column & mine).sum()) for column in columns]
            annotated, detected = counts[-2:]
            missed = annotated - detected
            table.append((name, *map(str, counts), str(missed), _share(missed, annotated)))
        return table

    def by_state(self) -> Rows:
        """A row for each performance state, with the columns of `STATE_HEADER`."""
        table = []
        for index, state in enumerate(self._rows.scene.detector.states):
            mine = self._truth_state == index
            annotated, detected = int((self._rows.annotated & mine).sum()), int((self._detected & mine).sum())
            frames, false = int((self._rows.frame_state == index).sum()), int((self._false_state == index).sum())
            missed = annotated - detected
            shares = _share(missed, annotated), str(false), _share(false, detected + false)
            table.append((state.name, *map(str, (frames, annotated, detected, missed)), *shares))
        return table


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
