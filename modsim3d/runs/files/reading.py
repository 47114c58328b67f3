"""The truth and detections of a finished run, read back from its tables as the pipeline had them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, MERGED, CameraFrames, Detections, Targets
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.columns import (
    NOBODY,
    Occluders,
    detection_boxes_px,
    flags,
    indices,
    integers,
    numbers,
    positions,
    truth_boxes_px,
)
from modsim3d.runs.files.table_columns import ERRORS, TRUTH_NUMBERS
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth


def truth_of(table: pa.Table, scene: Scene) -> Truth:
    """The truth in rows of the table `truth` of a run of a scene.

    The table does not say which boxes intersect in space, so `intersections` is empty.
    """
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
        drawn=np.zeros(len(table), dtype=bool),
        intersections=np.empty((0, 4), dtype=np.int64),
    )


def detections_of(
    tables: Mapping[str, pa.Table], model: DetectorModel, frames: CameraFrames, targets: Targets
) -> Detections:
    """The detections of a camera in a run, whose detector was given these targets.

    The tables do not say which box errors were resampled, so `redrawn` is false. They do not say which vessels the
    limit on the number of detections or the operating threshold removed either, so `gated` knows only the other gates.

    Args:
        tables: Rows of `frames`, `truth` and `detections` of the same steps as the camera's frames.
        model: The detector, which need not be the run's.
        frames: All frames of the camera at these steps.
        targets: The annotated vessels in these frames.

    Raises:
        RunDirectoryError: The model does not know a performance state or a label in the tables.
    """
    chosen = {name: table.filter(pc.equal(table["camera"], frames.camera)) for name, table in tables.items()}
    table = chosen["detections"]
    frame, kind = np.searchsorted(frames.steps, integers(table, "step")), indices(table, "kind", KINDS)
    count, vessel = len(targets.vessel_ids), indices(table, "vessel", targets.vessel_ids)
    wanted = np.where(vessel == NOBODY, NOBODY, frame * count + vessel)
    target = positions(targets.frame * count + targets.vessel, wanted)
    return Detections(
        states=_known_indices(chosen["frames"], "state", [state.name for state in model.states]),
        frame=frame,
        target=target,
        partner=_partners(chosen["truth"], targets, frame, target, kind),
        kind=kind,
        label=_known_indices(table, "label", model.labels),
        confidence=numbers(table, "confidence"),
        boxes_px=detection_boxes_px(table),
        errors_px=np.column_stack([numbers(table, name) for name in ERRORS]),
        redrawn=np.zeros(len(table), dtype=bool),
        gated=~model.gates.passed(frames, targets),
    )


def _partners(truth: pa.Table, targets: Targets, frame: Indices, target: Indices, kind: Indices) -> Indices:
    """Row of the second target of each merged box, else −1, shape (m,).

    The second targets of a frame are those that were detected and have no box of their own. The tables do not say which
    of them belongs to which of several merged boxes of a frame, so they are assigned in order.
    """
    partner = np.full(len(frame), -1)
    merged = np.flatnonzero(kind == MERGED)
    without_box = flags(truth, "detected")[flags(truth, "annotated")]
    without_box[target[target >= 0]] = False
    rows = np.flatnonzero(without_box)
    for where in np.unique(frame[merged]):
        partner[merged[frame[merged] == where]] = rows[targets.frame[rows] == where]
    return partner


def _known_indices(table: pa.Table, name: str, names: Sequence[str]) -> Indices:
    """A column of names as indices; a name that the detector does not know is an error."""
    found = indices(table, name, names)
    unknown = np.flatnonzero(found == NOBODY)
    if len(unknown):
        raise RunDirectoryError(
            f"the run has the {name} '{table[name][int(unknown[0])]}', which is not one of the detector file's "
            f"({', '.join(names)}): this detector cannot have made this run"
        )
    return found
