"""The truth and detections of a finished run, read back from its tables as the pipeline had them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, MERGED, CameraFrames, Detections, Targets
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.columns import (
    NOBODY,
    Filters,
    Occluders,
    detection_boxes_px,
    flags,
    indices,
    integers,
    numbers,
    of_steps,
    positions,
    read_rows,
    truth_boxes_px,
)
from modsim3d.runs.files.tables import ERRORS, TRUTH_NUMBERS
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth


def read_truth(folder: Path, scene: Scene, first: int, stop: int) -> Truth:
    """The truth of steps first to stop − 1 of a finished run of a scene.

    The table does not say which boxes intersect in space, so `intersections` is empty.
    """
    table = read_rows(folder / "truth.parquet", of_steps(first, stop))
    occluders = Occluders.of(table, scene.occluder_names)
    return Truth(
        step=integers(table, "step"),
        camera=indices(table, "camera", [camera.name for camera in scene.cameras]),
        vessel=indices(table, "vessel", scene.vessel_names),
        full_boxes_px=truth_boxes_px(table, "full"),
        visible_boxes_px=truth_boxes_px(table, "visible"),
        **{name: numbers(table, name) for name in TRUTH_NUMBERS},
        occluder_offsets=occluders.offsets,
        occluder=occluders.name,
        occluder_px=occluders.px,
        annotated=flags(table, "annotated"),
        intersections=np.empty((0, 4), dtype=np.int64),
    )


def read_detections(folder: Path, model: DetectorModel, frames: CameraFrames, targets: Targets) -> Detections:
    """The detections of some frames of a camera in a finished run, whose detector was given these targets.

    The tables do not say which box errors were resampled, so `redrawn` is false. They do not say which vessels the
    limit on the number of detections removed either, so `gated` knows only the other gates.

    Raises:
        RunDirectoryError: The tables name a state, label, kind or vessel that is not known.
    """
    chosen = _of_frames(frames)
    path, frames_path = folder / "detections.parquet", folder / "frames.parquet"
    table, states = read_rows(path, chosen), read_rows(frames_path, chosen, ["step", "state"])
    frame = np.searchsorted(frames.steps, integers(table, "step"))
    kind = _known_indices(table, "kind", KINDS, path)
    target = _targets(table, targets, frame, path)
    return Detections(
        states=_known_indices(states, "state", [state.name for state in model.states], frames_path),
        frame=frame,
        target=target,
        partner=_partners(folder, frames, targets, frame, target, kind),
        kind=kind,
        label=_known_indices(table, "label", model.labels, path),
        confidence=numbers(table, "confidence"),
        boxes_px=detection_boxes_px(table),
        errors_px=np.column_stack([numbers(table, name) for name in ERRORS]),
        redrawn=np.zeros(len(table), dtype=bool),
        gated=~model.gates.passed(frames, targets),
    )


def _partners(
    folder: Path, frames: CameraFrames, targets: Targets, frame: Indices, target: Indices, kind: Indices
) -> Indices:
    """Row of the second target of each merged box, else −1, shape (m,).

    The second targets of a frame are those that were detected and have no box of their own. The tables do not say which
    of them belongs to which of several merged boxes of a frame, so they are assigned in order.
    """
    partner = np.full(len(frame), -1)
    merged = np.flatnonzero(kind == MERGED)
    if not len(merged):
        return partner
    chosen: Filters = [*_of_frames(frames), ("annotated", "=", True)]
    without_box = flags(read_rows(folder / "truth.parquet", chosen, ["detected"]), "detected").copy()
    without_box[target[target >= 0]] = False
    rows = np.flatnonzero(without_box)
    for where in np.unique(frame[merged]):
        boxes, seconds = merged[frame[merged] == where], rows[targets.frame[rows] == where]
        count = min(len(boxes), len(seconds))
        partner[boxes[:count]] = seconds[:count]
    return partner


def _of_frames(frames: CameraFrames) -> Filters:
    """The condition that a row belongs to one of these consecutive frames of a camera."""
    first, stop = (int(frames.steps[0]), int(frames.steps[-1]) + 1) if len(frames) else (0, 0)
    return [("camera", "=", frames.camera), *of_steps(first, stop)]


def _known_indices(table: pa.Table, name: str, names: Sequence[str], path: Path) -> Indices:
    """A column of names as indices; a name that is not known is an error."""
    found = indices(table, name, names)
    unknown = np.flatnonzero(found == NOBODY)
    if len(unknown):
        raise RunDirectoryError(
            f"{path}: the {name} '{table[name][int(unknown[0])]}' is not one of the detector file's "
            f"({', '.join(names)}): this detector cannot have made this run"
        )
    return found


def _targets(table: pa.Table, targets: Targets, frame: Indices, path: Path) -> Indices:
    """Row of the target that each detection came from, −1 for a false positive, shape (m,)."""
    count, vessel = len(targets.vessel_ids), indices(table, "vessel", targets.vessel_ids)
    row = positions(targets.frame * count + targets.vessel, np.where(vessel < 0, NOBODY, frame * count + vessel))
    strange = np.flatnonzero(table["vessel"].is_valid().to_numpy() & (row < 0))
    if len(strange):
        name = table["vessel"][int(strange[0])]
        raise RunDirectoryError(f"{path}: vessel '{name}' is detected at a step where it is not annotated")
    return row
