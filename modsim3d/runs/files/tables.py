"""The Parquet tables of a run: frames, truth, detections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.boxes import centre_form, iou
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import KINDS, Detections
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM, ERRORS, TRUTH_NUMBERS, schema_of
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import annotation_boxes

ROW_GROUP_ROWS = 65_536
MAX_WAITING = 64  # small tables that wait to be written before they are joined: one of a row takes thousands of bytes

FRAMES, TRUTH, DETECTIONS = (schema_of(name) for name in ("frames", "truth", "detections"))


def frame_table(block: Block, scene: Scene) -> pa.Table:
    """One row for each frame: state and counts."""
    states = [state.name for state in scene.detector.states]
    tables = []
    for part in block.cameras:
        frames, false = len(part.steps), part.detections.false()
        annotated = np.searchsorted(part.steps, part.truth.step[part.target_rows])
        tables.append(
            {
                **_keys(block, part, scene, part.steps),
                "state": names_of(states, part.detections.states),
                "n_annotated": numbers(np.bincount(annotated, minlength=frames)),
                "n_detected": numbers(np.bincount(part.detections.frame[~false], minlength=frames)),
                "n_false": numbers(np.bincount(part.detections.frame[false], minlength=frames)),
            }
        )
    return _in_order(FRAMES, tables)


def truth_table(block: Block, scene: Scene) -> pa.Table:
    """One row for each step, camera and vessel whose silhouette is in the image."""
    labels = [vessel.label for vessel in scene.vessels]
    tables = []
    for part in block.cameras:
        truth = part.truth
        tables.append(
            {
                **_keys(block, part, scene, truth.step),
                "vessel": names_of(scene.vessel_names, truth.vessel),
                "label": names_of(labels, truth.vessel),
                **_box_columns("full", truth.full_boxes_px),
                **_box_columns("visible", truth.visible_boxes_px),
                **{name: numbers(getattr(truth, name)) for name in TRUTH_NUMBERS},
                "occluded_by": _occluders(part, scene),
                "annotated": pa.array(truth.annotated),
                "detected": pa.array(part.detected),
            }
        )
    return _in_order(TRUTH, tables)


def detection_table(block: Block, scene: Scene) -> pa.Table:
    """One row for each detection, with its origin."""
    tables = []
    for part in block.cameras:
        detections, rows = part.detections, part.truth_row
        true, overlap = ~detections.false(), np.full(len(rows), np.nan)
        annotated_px = annotation_boxes(part.truth, scene.annotation.mode)[rows[true]]
        overlap[true] = iou(detections.boxes_px[true], annotated_px)
        vessels = np.where(rows >= 0, part.truth.vessel[rows] if len(part.truth) else -1, -1)
        tables.append(
            {
                **_keys(block, part, scene, part.steps[detections.frame]),
                **detection_columns(detections, scene.detector),
                "vessel": names_of(scene.vessel_names, vessels),
                "iou": numbers(overlap),
            }
        )
    return _in_order(DETECTIONS, tables)


def detection_columns(detections: Detections, model: DetectorModel) -> dict[str, Any]:
    """The columns of the table of detections that say nothing of frames and vessels."""
    starts = np.searchsorted(detections.frame, detections.frame)
    return {
        "detection": numbers(np.arange(len(detections)) - starts),
        "label": names_of(model.labels, detections.label),
        "confidence": numbers(detections.confidence),
        **_by_name(BOX_SIDES, detections.boxes_px),
        **_by_name(CENTRE_FORM, centre_form(detections.boxes_px)),
        "state": names_of([state.name for state in model.states], detections.states[detections.frame]),
        "kind": names_of(KINDS, detections.kind),
        **_by_name(ERRORS, detections.errors_px),
    }


def _keys(block: Block, part: CameraBlock, scene: Scene, step: Indices) -> dict[str, Any]:
    return {
        "camera": names_of([camera.name for camera in scene.cameras], np.full(len(step), part.camera)),
        "step": numbers(step),
        "timestamp": names_of(block.timestamps, step - block.first),
    }


def names_of(names: Sequence[str], indices: Indices) -> pa.Array:
    """Names by index; null where the index is negative."""
    return pa.array(list(names), pa.string()).take(pa.array(indices, mask=indices < 0))


def numbers(values: NDArray[np.number[Any]]) -> pa.Array:
    """Numbers of shape (n,) with null for NaN."""
    return pa.array(values, from_pandas=True)


def _by_name(names: Sequence[str], values: Array) -> dict[str, pa.Array]:
    """The columns of an array of shape (n, k) by their names."""
    return {name: numbers(column) for name, column in zip(names, values.T, strict=True)}


def _box_columns(prefix: str, boxes_px: Array) -> dict[str, pa.Array]:
    return _by_name([f"{prefix}_{side}" for side in BOX_SIDES], boxes_px)


def _occluders(part: CameraBlock, scene: Scene) -> pa.Array:
    truth = part.truth
    entries = pa.StructArray.from_arrays(
        [names_of(scene.occluder_names, truth.occluder), numbers(truth.occluder_px)], names=["id", "px"]
    )
    return pa.ListArray.from_arrays(numbers(truth.occluder_offsets.astype(np.int32)), entries)


def _in_order(schema: pa.Schema, tables: list[dict[str, Any]]) -> pa.Table:
    """The tables of all cameras as one, in order of step and then camera."""
    joined = pa.concat_tables([pa.table([columns[name] for name in schema.names], schema=schema) for columns in tables])
    if len(tables) == 1:
        return joined
    return joined.take(numbers(np.argsort(joined["step"].to_numpy(), kind="stable")))


class TableWriter:
    """Writes a Parquet file whose row groups all have the same size, so that its bytes do not depend on the blocks.
    Each row group is written from one contiguous chunk: the ends of pages may depend on chunks."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        """Open the file."""
        self._writer = pq.ParquetWriter(path, schema, compression="zstd")
        self._waiting: list[pa.Table] = []
        self._rows = 0
        self._failed = False

    def write(self, table: pa.Table) -> None:
        """Add rows. Raises OSError if they cannot be written; the file is of no use then."""
        self._waiting.append(table)
        self._rows += len(table)
        if len(self._waiting) == MAX_WAITING:
            self._waiting = [pa.concat_tables(self._waiting).combine_chunks()]
        while self._rows > ROW_GROUP_ROWS:  # at least one row is left for close()
            self._write_group(ROW_GROUP_ROWS)

    def close(self) -> None:
        """Write the remaining rows and the footer, unless rows before could not be written; OSError as in `write`."""
        if self._failed:
            return
        if self._waiting:
            self._write_group(self._rows)
        with self._once():
            self._writer.close()

    def _write_group(self, count: int) -> None:
        """Write the first rows that wait; they are copied, and the tables they come from are given up first."""
        pool = pa.default_memory_pool()
        pool.release_unused()  # what blocks and row groups took is kept, until it is told not to be
        joined = pa.concat_tables(self._waiting)
        group = joined.slice(0, count).combine_chunks()
        self._waiting, self._rows = [joined.slice(count)] if count < self._rows else [], self._rows - count
        del joined
        with self._once():
            self._writer.write_table(group)
        del group
        pool.release_unused()

    @contextmanager
    def _once(self) -> Iterator[None]:
        """Write nothing more after an error, also not when the writer is disposed of: it would be another error."""
        try:
            yield
        except BaseException:
            self._failed, self._writer.is_open = True, False
            raise


def number_column(table: pa.Table, name: str) -> Array:
    """A column of numbers, NaN for null, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.float64)


def integer_column(table: pa.Table, name: str) -> Indices:
    """A column of whole numbers without nulls, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.int64)


def flags(table: pa.Table, name: str) -> Mask:
    """A column of truth values without nulls, shape (n,)."""
    return np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=bool)


def indices(table: pa.Table, name: str, names: Sequence[str]) -> Indices:
    """A column of names as indices, `NOBODY` for null and for a name that is not among them, shape (n,)."""
    index = pc.index_in(table[name], value_set=pa.array(list(names), pa.string()))
    return np.asarray(index.fill_null(NOBODY).to_numpy(zero_copy_only=False), dtype=np.int64)


def frame_numbers(table: pa.Table, scene: Scene) -> Indices:
    """Number (step × cameras + camera) of the frame of each row, shape (n,)."""
    cameras = [camera.name for camera in scene.cameras]
    return integer_column(table, "step") * len(cameras) + indices(table, "camera", cameras)


def truth_boxes_px(table: pa.Table, prefix: str) -> Array:
    """The `full` or `visible` boxes of a truth table as x_min, y_min, x_max, y_max; NaN for no box, shape (n, 4)."""
    return np.column_stack([number_column(table, f"{prefix}_{side}") for side in BOX_SIDES])


def detection_boxes_px(table: pa.Table) -> Array:
    """The boxes of a table of detections as x_min, y_min, x_max, y_max, shape (n, 4)."""
    return np.column_stack([number_column(table, name) for name in BOX_SIDES])


@dataclass(frozen=True, eq=False)
class Occluders:
    """Pairs of a hidden vessel and its occluder: m entries of the n rows of a truth table."""

    counts: Indices  # number of entries of each row, (n,)
    name: Indices  # index of the occluder's name, (m,)
    px: Array  # number of pixels that it hides, (m,)

    @classmethod
    def of(cls, truth: pa.Table, occluder_names: Sequence[str]) -> Occluders:
        """Read the column `occluded_by`."""
        lists = truth["occluded_by"].combine_chunks()
        entries = lists.flatten()
        table = pa.table({name: entries.field(name) for name in ("id", "px")})
        counts = np.asarray(lists.value_lengths(), dtype=np.int64)
        return cls(counts, indices(table, "id", occluder_names), number_column(table, "px"))

    @property
    def hidden(self) -> Indices:
        """Row of the hidden vessel of each entry, shape (m,)."""
        return np.repeat(np.arange(len(self.counts)), self.counts)

    @property
    def offsets(self) -> Indices:
        """Beginnings of the entries of each row, and the end, shape (n + 1,)."""
        return np.concatenate([[0], np.cumsum(self.counts)])
