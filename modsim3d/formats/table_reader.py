"""A run's Parquet tables, read back as the records that they were written from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.annotate.truth_record import Truth
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.block import Frame, FrameDetections, FrameTruth
from modsim3d.boxes import corner_form
from modsim3d.errors import RunDirectoryError
from modsim3d.formats.tables import BOX_SIDES, CENTRE_FORM
from modsim3d.scene import Scene

ERRORS = ("e_x_px", "e_y_px", "e_w_px", "e_h_px")


def read_rows(path: Path, first: int, stop: int, columns: Sequence[str] | None = None) -> pa.Table:
    """Rows of steps first to stop − 1; only the row groups that hold them are read.

    Args:
        path: A table with the column `step`.
        first: First step.
        stop: The step after the last.
        columns: Names; all if None.
    """
    return read_where(path, [("step", ">=", first), ("step", "<", stop)], columns)


def read_where(path: Path, filters: list[tuple[str, str, Any]], columns: Sequence[str] | None = None) -> pa.Table:
    """Rows for which conditions hold.

    Raises:
        RunDirectoryError: The file is not the table that a run has written.
    """
    try:
        return pq.read_table(path, columns=columns, filters=filters)
    except (pa.ArrowException, KeyError) as error:
        raise RunDirectoryError(f"{path} is not what a run has written: {str(error).splitlines()[0]}") from None


def read_truth(folder: Path, scene: Scene, first: int, stop: int) -> Truth:
    """The truth of steps first to stop − 1 as the detector was given it.

    Which boxes intersect in space is not in the table, and so not in the record.

    Args:
        folder: A finished run directory.
        scene: That was run.
        first: First step.
        stop: The step after the last.
    """
    table = read_rows(folder / "truth.parquet", first, stop)
    hiders = table["occluded_by"].combine_chunks()
    lengths = np.asarray(hiders.value_lengths(), dtype=np.int64)
    entries = hiders.flatten()
    numbers = ("silhouette_px", "visible_px", "visible_fraction", "in_frame_fraction", "depth_m")
    return Truth(
        step=table["step"].to_numpy(),
        camera=_indices(table["camera"], [camera.name for camera in scene.cameras]),
        vessel=_indices(table["vessel"], scene.vessel_names),
        full_boxes_px=_boxes(table, "full"),
        visible_boxes_px=_boxes(table, "visible"),
        **{name: _doubles(table[name]) for name in numbers},
        occluder_offsets=np.concatenate([[0], np.cumsum(lengths)]),
        occluder=_indices(entries.field("id"), scene.occluder_names),
        occluder_px=_doubles(entries.field("px")),
        annotated=_flags(table["annotated"]),
        intersections=np.empty((0, 4), dtype=np.int64),
    )


def read_frames(folder: Path, scene: Scene, first: int, stop: int) -> Iterator[Frame]:
    """The frames of steps first to stop − 1, in order of step and camera.

    Args:
        folder: A finished run directory.
        scene: That was run.
        first: First step.
        stop: The step after the last.
    """
    frames = read_rows(folder / "frames.parquet", first, stop)
    truth = _by_frame(read_rows(folder / "truth.parquet", first, stop))
    detections = _by_frame(read_rows(folder / "detections.parquet", first, stop))
    if first >= stop:
        return
    cameras = {camera.name: camera for camera in scene.cameras}
    taken = {name: scene.frame_steps(camera, first, stop) for name, camera in cameras.items()}
    horizons = {name: scene.sea_half_planes(camera, taken[name]) for name, camera in cameras.items()}
    for row in frames.to_pylist():
        key = row["step"], row["camera"]
        yield Frame(
            camera=row["camera"],
            step=row["step"],
            timestamp=row["timestamp"],
            state=row["state"],
            truth=_frame_truth(truth(key), scene),
            detections=_frame_detections(detections(key)),
            image_size_px=cameras[row["camera"]].intrinsics.image_size_px,
            sea_half_plane=horizons[row["camera"]][np.searchsorted(taken[row["camera"]], row["step"])],
            scene_vessels=scene.vessel_names,
        )


def _by_frame(table: pa.Table) -> Any:
    """A function from (step, camera) to the rows of that frame; rows are ordered by step and then camera."""
    steps, cameras = table["step"].to_numpy(), table["camera"].to_numpy(zero_copy_only=False)
    begins = np.flatnonzero(np.append(True, (steps[1:] != steps[:-1]) | (cameras[1:] != cameras[:-1])))
    begins = begins if len(steps) else begins[:0]
    ends = np.append(begins[1:], len(steps))[: len(begins)]  # of an empty table: none
    where = {(int(steps[i]), str(cameras[i])): (int(i), int(end)) for i, end in zip(begins, ends, strict=True)}

    def rows(key: tuple[int, str]) -> pa.Table:
        start, end = where.get(key, (0, 0))
        return table.slice(start, end - start)

    return rows


def _frame_truth(rows: pa.Table, scene: Scene) -> FrameTruth:
    full, visible = _boxes(rows, "full"), _boxes(rows, "visible")
    return FrameTruth(
        vessels=tuple(rows["vessel"].to_pylist()),
        labels=tuple(rows["label"].to_pylist()),
        full_boxes_px=full,
        visible_boxes_px=visible,
        boxes_px=visible if scene.annotation.mode == 2 else full,
        silhouette_px=_doubles(rows["silhouette_px"]),
        visible_px=_doubles(rows["visible_px"]),
        visible_fraction=_doubles(rows["visible_fraction"]),
        in_frame_fraction=_doubles(rows["in_frame_fraction"]),
        depth_m=_doubles(rows["depth_m"]),
        occluded_by=tuple({entry["id"]: entry["px"] for entry in row} for row in rows["occluded_by"].to_pylist()),
        annotated=_flags(rows["annotated"]),
        detected=_flags(rows["detected"]),
    )


def _frame_detections(rows: pa.Table) -> FrameDetections:
    return FrameDetections(
        labels=tuple(rows["label"].to_pylist()),
        confidence=_doubles(rows["confidence"]),
        boxes_px=corner_form(np.column_stack([_doubles(rows[name]) for name in CENTRE_FORM])),
        kinds=tuple(rows["kind"].to_pylist()),
        vessels=tuple(rows["vessel"].to_pylist()),
        errors_px=np.column_stack([_doubles(rows[name]) for name in ERRORS]),
    )


def _doubles(column: pa.ChunkedArray) -> Array:
    """Numbers, with NaN for null."""
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _flags(column: pa.ChunkedArray) -> Mask:
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=bool)


def _boxes(table: pa.Table, prefix: str) -> Array:
    return np.column_stack([_doubles(table[f"{prefix}_{side}"]) for side in BOX_SIDES])


def _indices(column: pa.ChunkedArray | pa.Array, names: Sequence[str]) -> Indices:
    index = {name: i for i, name in enumerate(names)}
    return np.array([index[name] for name in column.to_pylist()], dtype=np.int64)
