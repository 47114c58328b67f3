"""One frame as rows of the tables that a run writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.boxes import centre_form
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import nearest
from modsim3d.runs.blocks import Frame
from modsim3d.runs.files.tables import BOX_SIDES, CENTRE_FORM, DETECTIONS, ERRORS, FRAMES, TRUTH, TRUTH_NUMBERS

Columns = Mapping[str, Any]


def rows_of_frame(frame: Frame, name: str) -> pa.Table:
    """The rows of a frame in the table `frames`, `truth` or `detections`, as a run of its scene has them.

    Raises:
        ModsimError: There is no such table.
    """
    if name not in _TABLES:
        raise ModsimError(f"there is no table '{name}' of a frame ({nearest(name, _TABLES)})")
    schema, columns_of = _TABLES[name]
    columns, rows = columns_of(frame), {"frames": 1, "truth": len(frame.truth), "detections": len(frame.detections)}
    keys = {key: [getattr(frame, key)] * rows[name] for key in ("camera", "step", "timestamp", "state")}
    every = {**keys, **columns}
    arrays = [pa.array(every[field.name], field.type, from_pandas=True) for field in schema]  # null for NaN
    return pa.table(arrays, schema=schema)


def _frame_columns(frame: Frame) -> Columns:
    false = sum(kind in {KINDS[kind] for kind in FALSE_KINDS} for kind in frame.detections.kinds)
    return {
        "n_annotated": [np.count_nonzero(frame.truth.annotated)],
        "n_detected": [len(frame.detections) - false],
        "n_false": [false],
    }


def _truth_columns(frame: Frame) -> Columns:
    truth = frame.truth
    return {
        "vessel": truth.vessels,
        "label": truth.labels,
        **{f"full_{side}": truth.full_boxes_px[:, i] for i, side in enumerate(BOX_SIDES)},
        **{f"visible_{side}": truth.visible_boxes_px[:, i] for i, side in enumerate(BOX_SIDES)},
        **{name: getattr(truth, name) for name in TRUTH_NUMBERS},
        "occluded_by": [[{"id": name, "px": px} for name, px in each.items()] for each in truth.occluded_by],
        "annotated": truth.annotated,
        "detected": truth.detected,
    }


def _detection_columns(frame: Frame) -> Columns:
    found = frame.detections
    return {
        "detection": np.arange(len(found)),
        "label": found.labels,
        "confidence": found.confidence,
        **dict(zip(CENTRE_FORM, centre_form(found.boxes_px).T, strict=True)),
        **dict(zip(BOX_SIDES, found.boxes_px.T, strict=True)),
        "kind": found.kinds,
        "vessel": found.vessels,
        **dict(zip(ERRORS, found.errors_px.T, strict=True)),
    }


_TABLES: Mapping[str, tuple[pa.Schema, Callable[[Frame], Columns]]] = {
    "frames": (FRAMES, _frame_columns),
    "truth": (TRUTH, _truth_columns),
    "detections": (DETECTIONS, _detection_columns),
}
