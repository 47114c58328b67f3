"""The columns of one part of a run's recording: truth, detections and performance states of its frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import KINDS
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.run_rows import RunRows
from modsim3d.view.report.recording.overview import ANNOTATED, DETECTED, UNKNOWN_FRACTION, WHOLE
from modsim3d.view.report.recording.packing import NONE, ROW_BEFORE, Coded, Column, in_quanta, starts
from modsim3d.view.report.recording.parts import PartRows
from modsim3d.view.report.recording.truth_numbers import number_columns

NO_STATE, ALL_SEA = 255, (0.0, 0.0, 1.0)
"""What stands for the state and the horizon of a camera that has not taken a frame yet."""
PER_METRE = 100
"""Depths are in centimetres."""


class PartFrames:
    """The frames that a part shows, camera by camera, each in order of step; an empty one comes last if it is shown.

    Attributes:
        steps: For each camera the steps of its frames, shape (F_c,).
        begins: Number of each camera's first frame, and the number of frames, shape (cameras + 1,).
        numbers: Step × cameras + camera of each frame, shape (count,).
        count: Number of frames without the empty one.
        pages: Number of frames, with the empty one.
        shown: Number of the frame that each camera shows at each step, shape (S, cameras).
    """

    def __init__(self, part: PartRows) -> None:
        """Find the frames of a part."""
        cameras = part.taken.shape[1]
        self._cameras = cameras
        self.steps = [np.unique(column[column != NOBODY]) for column in part.taken.T]
        sizes = [len(steps) for steps in self.steps]
        self.begins = np.concatenate([[0], np.cumsum(sizes)])
        self.count = int(self.begins[-1])
        self.pages = self.count + int(np.any(part.taken == NOBODY))
        self.shown = np.empty(part.taken.shape, dtype=np.int64)
        for camera, (steps, taken) in enumerate(zip(self.steps, part.taken.T, strict=True)):
            place = self.begins[camera] + np.searchsorted(steps, taken)
            self.shown[:, camera] = np.where(taken == NOBODY, self.count, place)
        self.numbers = np.concatenate([steps * cameras + camera for camera, steps in enumerate(self.steps)])

    def of(self, number: Indices) -> Indices:
        """The frame of each row, from step × cameras + camera of each, shape (n,); `NOBODY` if it is not shown."""
        frame = np.full(len(number), NOBODY)
        for camera, steps in enumerate(self.steps):
            mine = np.flatnonzero(number % self._cameras == camera)
            step = number[mine] // self._cameras
            place = np.searchsorted(steps, step)
            found = np.flatnonzero(np.append(steps, NOBODY)[place] == step)
            frame[mine[found]] = self.begins[camera] + place[found]
        return frame


def frame_columns(part: PartRows, frames: PartFrames) -> dict[str, Column | Coded]:
    """Which frame each camera shows at each step, when it was taken, and the performance state in it."""
    state = part.rows.states_of(frames.numbers).astype(np.uint8)
    empty = frames.pages - frames.count
    held = np.any(part.taken != part.steps[:, None])
    return {
        "frame": Coded(frames.shown.astype(np.uint32), by=ROW_BEFORE),
        **({"taken": Coded(part.taken.astype(np.int32), by=ROW_BEFORE)} if held else {}),
        "state": np.append(state, np.full(empty, NO_STATE, dtype=np.uint8)),
    }


def truth_columns(rows: RunRows, frames: PartFrames, quantum: float) -> dict[str, Column | Coded]:
    """The truth of frames, the farthest vessel of each frame first."""
    frame, depth_m = frames.of(rows.truth_frame), rows.numbers("depth_m")
    order = np.lexsort((-depth_m, frame))
    shown, hiders = order[frame[order] != NOBODY], _main_hiders(rows)
    return {
        "truthStart": Coded(starts(frame[shown], frames.pages), by=ROW_BEFORE),
        "vessel": Coded(rows.truth_vessel[shown].astype(np.uint16), by=ROW_BEFORE),
        "flags": (ANNOTATED * rows.annotated[shown] + DETECTED * rows.detected[shown]).astype(np.uint8),
        "fraction": Coded(in_250ths(rows.numbers("visible_fraction")[shown]), by="vessel"),
        "depth": Coded(np.rint(PER_METRE * depth_m[shown]).astype(np.uint32), by="vessel"),
        "hider": Coded(hiders[shown].astype(np.uint16), by="vessel"),
        "full": Coded(in_quanta(rows.boxes_px("full")[shown], quantum), by="vessel"),
        "visible": Coded(in_quanta(rows.boxes_px("visible")[shown], quantum), base="full"),
        **number_columns(rows, shown, hiders),
    }


def _main_hiders(rows: RunRows) -> Indices:
    """Who hides most of each row of the truth, `NONE` if nobody, shape (n,)."""
    occluders, hiders = rows.occluders(), np.full(len(rows.truth_frame), NONE)
    least_first = np.argsort(occluders.px, kind="stable")
    hiders[occluders.hidden[least_first]] = occluders.name[least_first]  # what is written last stays
    return hiders


def detection_columns(rows: RunRows, frames: PartFrames, quantum: float) -> dict[str, Column | Coded]:
    """The detections of frames, in the order of the run."""
    frame = frames.of(rows.detection_frame)
    order = np.argsort(frame, kind="stable")
    drawn = order[frame[order] != NOBODY]
    vessel = np.where(rows.detection_vessel < 0, NONE, rows.detection_vessel)[drawn].astype(np.uint16)
    return {
        "drawnStart": Coded(starts(frame[drawn], frames.pages), by=ROW_BEFORE),
        "drawnVessel": vessel,
        "label": indices(rows.detections, "label", rows.scene.detector.labels)[drawn].astype(np.uint16),
        "confidence": Coded(np.rint(1000 * numbers(rows.detections, "confidence")[drawn]).astype(np.uint16)),
        "outcome": rows.outcomes[drawn],
        "kind": indices(rows.detections, "kind", KINDS)[drawn].astype(np.uint8),
        "box": Coded(in_quanta(rows.detection_boxes_px()[drawn], quantum), by="drawnVessel"),
    }


def in_250ths(fraction: Array) -> NDArray[np.uint8]:
    """Visible fractions in 250ths, of the same shape; NaN is `UNKNOWN_FRACTION`, and a part never rounds to 0 or 1."""
    counted = np.clip(np.rint(np.nan_to_num(fraction) * WHOLE), np.where(fraction > 0, 1, 0), WHOLE)
    counted = np.where((fraction < 1) & (counted == WHOLE), WHOLE - 1, counted)
    return np.where(np.isnan(fraction), UNKNOWN_FRACTION, counted).astype(np.uint8)
