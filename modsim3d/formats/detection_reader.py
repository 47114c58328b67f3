"""A run's detections read back as the detector put them out, for a whole run of frames of one camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import corner_form
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, MERGED, CameraFrames, Detections, Targets
from modsim3d.errors import RunDirectoryError
from modsim3d.formats.table_reader import ERRORS, read_where
from modsim3d.formats.tables import CENTRE_FORM


def read_detections(folder: Path, model: DetectorModel, frames: CameraFrames, targets: Targets) -> Detections:
    """The detections of a camera in a finished run.

    Whether a box error was drawn anew is not in the tables, and so not in the record; nor is whether a vessel was lost
    to a limit on the number of detections, so that `gated` has the other gates only.

    Args:
        folder: The run directory.
        model: For the names of states and labels.
        frames: The camera's.
        targets: What its detector was given.

    Raises:
        RunDirectoryError: The tables name a state, label, kind or vessel that is not known.
    """
    chosen: list[tuple[str, str, Any]] = [("camera", "=", frames.camera)]
    path = folder / "detections.parquet"
    table = read_where(path, chosen)
    seen = read_where(folder / "frames.parquet", chosen, ["step", "state"])
    frame = np.searchsorted(frames.steps, table["step"].to_numpy())
    kind = _indices(table["kind"], KINDS, path, "kind")
    target = _targets(table, targets, frame, path)
    return Detections(
        states=_indices(seen["state"], [state.name for state in model.states], folder / "frames.parquet", "state"),
        frame=frame,
        target=target,
        partner=_partners(folder, frames, targets, frame, target, kind),
        kind=kind,
        label=_indices(table["label"], model.labels, path, "label"),
        confidence=_doubles(table, "confidence"),
        boxes_px=_boxes(table),
        errors_px=np.column_stack([_doubles(table, name) for name in ERRORS]),
        redrawn=np.zeros(len(table), dtype=bool),
        gated=~model.gates.passed(frames, targets),
    )


def _partners(
    folder: Path, frames: CameraFrames, targets: Targets, frame: Indices, target: Indices, kind: Indices
) -> Indices:
    """The second vessel of each merged box: one of its frame that was detected and has no box, else −1.

    Where a frame has several merged boxes, which of them is whose is not in the tables; they are given out in order.
    """
    partner = np.full(len(frame), -1)
    merged = np.flatnonzero(kind == MERGED)
    if not len(merged):
        return partner
    chosen: list[tuple[str, str, Any]] = [("camera", "=", frames.camera), ("annotated", "=", True)]
    table = read_where(folder / "truth.parquet", chosen, ["detected"])
    waiting = np.asarray(table["detected"].to_numpy(zero_copy_only=False), dtype=bool)
    waiting[target[target >= 0]] = False
    rows = np.flatnonzero(waiting)
    for where in np.unique(frame[merged]):
        ours, theirs = merged[frame[merged] == where], rows[targets.frame[rows] == where]
        count = min(len(ours), len(theirs))
        partner[ours[:count]] = theirs[:count]
    return partner


def _doubles(table: pa.Table, name: str) -> Array:
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.float64)


def _boxes(table: pa.Table) -> Array:
    return corner_form(np.column_stack([_doubles(table, name) for name in CENTRE_FORM]))


def _indices(column: pa.ChunkedArray, names: Any, path: Path, what: str) -> Indices:
    index = {name: i for i, name in enumerate(names)}
    found = column.unique().to_pylist()
    unknown = [str(name) for name in found if name not in index]
    if unknown:
        raise RunDirectoryError(
            f"{path}: the {what} '{unknown[0]}' is not one of the detector file's ({', '.join(map(str, names))}): "
            "this detector cannot have made this run"
        )
    return np.array([index[name] for name in column.to_pylist()], dtype=np.int64)


def _targets(table: pa.Table, targets: Targets, frame: Indices, path: Path) -> Indices:
    """Row of the target that each detection came from, −1 for a false positive."""
    vessels = {name: i for i, name in enumerate(targets.vessel_ids)}
    names = table["vessel"].to_pylist()
    vessel = np.array([-1 if name is None else vessels.get(name, -2) for name in names], dtype=np.int64)
    size = len(targets.vessel_ids)
    keys = targets.frame * size + targets.vessel
    order = np.argsort(keys, kind="stable")
    place = np.searchsorted(keys[order], frame * size + vessel)
    row = order[np.minimum(place, len(order) - 1)] if len(order) else np.full(len(frame), -1)
    of_vessel = vessel != -1
    missing = of_vessel & ((row < 0) | (keys[row] != frame * size + vessel) if len(order) else of_vessel)
    if missing.any():
        first = int(np.flatnonzero(missing)[0])
        raise RunDirectoryError(f"{path}: vessel '{names[first]}' is detected at a step where it is not annotated")
    return np.where(of_vessel, row, -1)
