"""The Parquet tables of a detector over other people's truth: those of a run, with columns of their own."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.arrays import Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.other_truth.detecting import Part
from modsim3d.other_truth.sought import Sought
from modsim3d.runs.files.table_columns import BOX_SIDES, COLUMNS, Column
from modsim3d.runs.files.tables import ROW_GROUP_ROWS, detection_columns, named, numbers

IMAGE = Column("image", pa.string(), "", "what the file of truth calls the image: its ID in COCO, the frame in MOT")
FROM_OVERLAP = Column(
    "from_overlap", pa.bool_(), "", "whether visible_fraction comes from the overlap of boxes and not from the file"
)
_TRUTH = ("camera", "step", "timestamp", "vessel", "label", *(f"full_{side}" for side in BOX_SIDES))
_TRUTH_NUMBERS = ("visible_fraction", "depth_m", "annotated", "detected")


def _columns(table: str, names: Sequence[str]) -> tuple[Column, ...]:
    known = {column.name: column for column in COLUMNS[table]}
    return tuple(known[name] for name in names)


TABLES = {
    "frames": (*COLUMNS["frames"], IMAGE),
    "truth": (*_columns("truth", (*_TRUTH, *_TRUTH_NUMBERS)), FROM_OVERLAP),
    "detections": COLUMNS["detections"],
}
"""The columns of each table, in order."""


def tables_of(
    parts: Sequence[Part],
    sought: Sought,
    tracks: Sequence[int | str],
    images: Sequence[int | str],
    model: DetectorModel,
) -> dict[str, bytes]:
    """The files of all tables, by the name of the table."""
    names = [str(track) for track in tracks]
    made = {
        "frames": [_frames(part, images, model) for part in parts],
        "truth": [_truth(part, sought, names, model) for part in parts],
        "detections": [_detections(part, sought, names, model) for part in parts],
    }
    return {table: _file(TABLES[table], columns) for table, columns in made.items()}


def _file(columns: Sequence[Column], parts: Sequence[dict[str, Any]]) -> bytes:
    schema = pa.schema([column.field for column in columns])
    whole = pa.concat_tables([pa.table([part[name] for name in schema.names], schema=schema) for part in parts])
    buffer = io.BytesIO()
    pq.write_table(whole.combine_chunks(), buffer, compression="zstd", row_group_size=ROW_GROUP_ROWS)
    return buffer.getvalue()


def _keys(part: Part, frame: Indices) -> dict[str, Any]:
    times = [repr(time_s) for time_s in part.times_s.tolist()]
    return {
        "camera": named([part.video.name], np.zeros(len(frame), dtype=np.int64)),
        "step": part.steps[frame],
        "timestamp": named(times, frame),
    }


def _frames(part: Part, images: Sequence[int | str], model: DetectorModel) -> dict[str, Any]:
    detections, count = part.detections, len(part.steps)
    false = detections.false()
    return {
        **_keys(part, np.arange(count)),
        "state": named([state.name for state in model.states], detections.states),
        "n_annotated": np.bincount(part.frame[part.target_rows], minlength=count),
        "n_detected": np.bincount(detections.frame[~false], minlength=count),
        "n_false": np.bincount(detections.frame[false], minlength=count),
        "image": pa.array([str(images[image]) for image in part.video.images[part.steps].tolist()], pa.string()),
    }


def _truth(part: Part, sought: Sought, names: Sequence[str], model: DetectorModel) -> dict[str, Any]:
    rows = part.rows
    return {
        **_keys(part, part.frame),
        "vessel": named(names, sought.track[rows]),
        "label": named(model.labels, sought.label[rows]),
        **{f"full_{side}": sought.boxes_px[rows, k] for k, side in enumerate(BOX_SIDES)},
        "visible_fraction": sought.visible_fraction[rows],
        "depth_m": numbers(sought.depth_m[rows]),
        "annotated": sought.visible[rows],
        "detected": part.detected,
        "from_overlap": sought.from_overlap[rows],
    }


def _detections(part: Part, sought: Sought, names: Sequence[str], model: DetectorModel) -> dict[str, Any]:
    origin = part.origin
    vessel = np.where(origin >= 0, sought.track[origin], -1) if len(sought) else origin
    return {
        **_keys(part, part.detections.frame),
        **detection_columns(part.detections, model),
        "vessel": named(names, vessel),
    }
