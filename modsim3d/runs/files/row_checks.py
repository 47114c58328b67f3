"""Rules for the rows of a run's tables: each value alone, in its row, in its frame, and between the tables. Rows are
checked as they are read, so that no reader has to guess. An error names file, row, column and value."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, positions
from modsim3d.core.boxes import centre_form
from modsim3d.core.errors import RunDirectoryError
from modsim3d.detector.records import FALSE_KINDS, FALSE_POSITIVE, KINDS, MERGED, PERSISTENT
from modsim3d.io.validation import MAX_COORDINATE_M, shown
from modsim3d.runs.files import tables
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM, ERRORS
from modsim3d.scene.scene import Scene

ROUNDING = 1e-6  # relative error that sums of areas and boxes in another form may have
MAX_DEPTH_M = 4 * MAX_COORDINATE_M
MAX_ERROR_PX = 1e12
OF_NO_VESSEL = (FALSE_POSITIVE, PERSISTENT)  # kinds of detections that belong to no vessel


@dataclass(frozen=True, eq=False)
class TableRows:
    """Consecutive rows of a table of a run, with the steps that they may belong to, first to stop − 1."""

    path: Path
    first_row: int  # number of the first of these rows in the file
    table: pa.Table
    first: int
    stop: int

    def refuse(self, column: str, wrong: Mask, right: str) -> None:
        """Raise RunDirectoryError for the first row that is wrong; `right` says what the value must be."""
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RunDirectoryError(
                f"{self.path} is not what a run has written: row {self.first_row + row}, column '{column}': "
                f"must be {right} (got {_text(self.table[column][row])})"
            )

    def filled(self, column: str) -> None:
        """Refuse null."""
        if self.table[column].null_count:
            self.refuse(column, self.table[column].is_null().to_numpy(), "there")

    def integers(self, column: str, least: int = 0) -> Indices:
        """A column of whole numbers, shape (n,)."""
        self.filled(column)
        values = tables.integer_column(self.table, column)
        self.refuse(column, values < least, f"at least {least}")
        return values

    def flags(self, column: str) -> Mask:
        """A column of truth values, shape (n,)."""
        self.filled(column)
        return tables.flags(self.table, column)

    def numbers(
        self, column: str, least: float, greatest: float | Array, *, slack: float = 0.0, nullable: bool = False
    ) -> Array:
        """A column of numbers, at most `slack` outside their range (`greatest` may be one for each row). NaN for null,
        shape (n,)."""
        values = tables.number_column(self.table, column)
        if not nullable:
            self.refuse(column, np.isnan(values), "a number")
        wrong = (values < least - slack) | (values > greatest + slack)
        if wrong.any():
            most = float(np.broadcast_to(greatest, values.shape)[np.argmax(wrong)])
            self.refuse(column, wrong, f"from {least:g} to {most:g}")
        return values

    def names(self, column: str, choices: Sequence[str], *, nullable: bool = False) -> Indices:
        """A column of names as indices, `NOBODY` for null, shape (n,)."""
        indices = tables.indices(self.table, column, choices)
        wrong = indices == NOBODY
        if nullable and wrong.any():
            wrong &= self.table[column].is_valid().to_numpy()
        self.refuse(column, wrong, f"one of {', '.join(choices[:12])}{', …' if len(choices) > 12 else ''}")
        return indices


def _text(value: pa.Scalar) -> str:
    try:
        return "null" if value.as_py() is None else shown(value.as_py())
    except UnicodeDecodeError:
        return "bytes that are no UTF-8"


def check_frames(rows: TableRows, scene: Scene) -> Indices:
    """Check rows of `frames`; the index of each frame's performance state, shape (n,). Raises RunDirectoryError, as all
    checks here do, for a value that is not what a run has written."""
    frame, taken = _frame_numbers(rows, scene), frames_taken(scene, rows.first, rows.stop)
    if not np.array_equal(frame, taken):
        common = min(len(frame), len(taken))
        row = int(np.argmax(np.append(frame[:common] != taken[:common], True)))
        raise RunDirectoryError(
            f"{rows.path} is not what a run has written: row {rows.first_row + row} must be "
            + (_frame_text(scene, int(taken[row])) if row < len(taken) else "that of a later step")
            + f" (got {_frame_text(scene, int(frame[row])) if row < len(frame) else 'none'})"
        )
    for name in ("n_annotated", "n_detected", "n_false"):
        rows.integers(name)
    return rows.names("state", [state.name for state in scene.detector.states])


def frames_taken(scene: Scene, first: int, stop: int) -> Indices:
    """Numbers (step × cameras + camera) of the frames that a scene's cameras take at steps first to stop − 1."""
    cameras = len(scene.cameras)
    of_cameras = [scene.frame_steps(camera, first, stop) * cameras + i for i, camera in enumerate(scene.cameras)]
    return np.sort(np.concatenate(of_cameras))


def _frame_text(scene: Scene, frame: int) -> str:
    step, camera = divmod(frame, len(scene.cameras))
    return f"step {step} of camera '{scene.cameras[camera].name}'"


def _frame_numbers(rows: TableRows, scene: Scene) -> Indices:
    """Check camera, step and timestamp; the number of each row's frame, shape (n,)."""
    step = rows.integers("step")
    rows.refuse("step", (step < rows.first) | (step >= rows.stop), f"from {rows.first} to {rows.stop - 1}")
    camera = rows.names("camera", [camera.name for camera in scene.cameras])
    times = pa.array(scene.timestamps(rows.first, rows.stop), pa.string()).take(pa.array(step - rows.first))
    written = rows.table["timestamp"].combine_chunks()
    if not written.equals(times):
        wrong = np.array([a != b for a, b in zip(written.cast(pa.binary()), times.cast(pa.binary()), strict=True)])
        rows.refuse("timestamp", wrong, f"'{times[int(np.argmax(wrong))]}', the time of its step")
    return step * len(scene.cameras) + camera


def check_truth(rows: TableRows, scene: Scene) -> None:
    """Check rows of `truth`."""
    frame, taken = _frame_numbers(rows, scene), frames_taken(scene, rows.first, rows.stop)
    rows.refuse("step", positions(taken, frame) == NOBODY, "one at which the camera takes a frame")
    vessel = rows.names("vessel", scene.vessel_names)
    key = frame * len(scene.vessels) + vessel
    rows.refuse("vessel", np.diff(key, prepend=-1) <= 0, "after the row before, in order of step, camera and vessel")
    label = rows.names("label", labels := list(dict.fromkeys(vessel.label for vessel in scene.vessels)))
    of_vessel = np.array([labels.index(vessel.label) for vessel in scene.vessels])
    rows.refuse("label", label != of_vessel[vessel], "the vessel's")
    size_px = _image_sizes_px(frame, scene)
    _check_boxes(rows, "full_", tables.truth_boxes_px(rows.table, "full"), size_px, nullable=False)
    visible = tables.truth_boxes_px(rows.table, "visible")
    _check_boxes(rows, "visible_", visible, size_px, nullable=True)
    _check_visibility(rows, scene, size_px.prod(axis=1) * (1 + ROUNDING))
    annotated, detected = rows.flags("annotated"), rows.flags("detected")
    if scene.annotation.mode == 2:
        rows.refuse("annotated", annotated & np.isnan(visible[:, 0]), "false, as the vessel has no visible box")
    rows.refuse("detected", detected & ~annotated, "false, as the vessel is not annotated")


def _image_sizes_px(frame: Indices, scene: Scene) -> Array:
    """Width and height of the image of each row, by the number of its frame (n,), shape (n, 2)."""
    sizes_px = np.array([camera.intrinsics.image_size_px for camera in scene.cameras], dtype=np.float64)
    return sizes_px[frame % len(scene.cameras)]


def _check_boxes(rows: TableRows, prefix: str, boxes_px: Array, size_px: Array, *, nullable: bool) -> None:
    """Check that boxes, shape (n, 4), lie in their images and have no side below 0; a missing one has no number."""
    slack = ROUNDING * float(size_px.max(initial=1.0))
    for i, side in enumerate(BOX_SIDES):
        rows.numbers(f"{prefix}{side}", 0.0, size_px[:, i % 2], slack=slack, nullable=nullable)
        missing = np.isnan(boxes_px[:, i]) != np.isnan(boxes_px[:, 0])
        rows.refuse(f"{prefix}{side}", missing, "a number like the other sides of the box, or null like them")
    for i, side in enumerate(BOX_SIDES[2:]):
        wrong = boxes_px[:, i + 2] < boxes_px[:, i] - slack
        rows.refuse(f"{prefix}{side}", wrong, f"at least {prefix}{BOX_SIDES[i]}")


def _check_visibility(rows: TableRows, scene: Scene, most_px: Array) -> None:
    silhouette_px = rows.numbers("silhouette_px", 0.0, most_px)
    rows.numbers("visible_px", 0.0, silhouette_px * (1 + ROUNDING) + ROUNDING, nullable=True)
    rows.numbers("visible_fraction", 0.0, 1 + ROUNDING, nullable=True)
    rows.numbers("in_frame_fraction", 0.0, 1 + ROUNDING, nullable=True)
    rows.numbers("depth_m", -MAX_DEPTH_M, MAX_DEPTH_M, nullable=scene.labels is not None)
    rows.filled("occluded_by")
    occluders, wrong = tables.Occluders.of(rows.table, scene.occluder_names), np.zeros(len(rows.table), dtype=bool)
    wrong[occluders.hidden[occluders.name == NOBODY]] = True
    rows.refuse("occluded_by", wrong, "a list of vessels and obstacles of the scene")
    hidden = occluders.hidden
    wrong[hidden[~((occluders.px >= 0) & (occluders.px <= most_px[hidden]))]] = True
    rows.refuse("occluded_by", wrong, "a list with numbers of pixels")


def check_detections(rows: TableRows, scene: Scene) -> None:
    """Check rows of `detections`."""
    frame, taken = _frame_numbers(rows, scene), frames_taken(scene, rows.first, rows.stop)
    rows.refuse("step", positions(taken, frame) == NOBODY, "one at which the camera takes a frame")
    rows.refuse("step", np.diff(frame, prepend=-1) < 0, "after the row before, in order of step and camera")
    number = np.arange(len(frame)) - np.searchsorted(frame, frame)
    rows.refuse("detection", rows.integers("detection") != number, "the number of the row in its frame, from 0")
    rows.names("label", scene.detector.labels)
    rows.names("state", [state.name for state in scene.detector.states])
    kind, vessel = rows.names("kind", KINDS), rows.names("vessel", scene.vessel_names, nullable=True)
    of_nobody = np.isin(kind, OF_NO_VESSEL)
    rows.refuse("vessel", of_nobody != (vessel == NOBODY), "null for a false positive and for nothing else")
    rows.numbers("confidence", 0.0, 1.0)
    size_px, boxes_px = _image_sizes_px(frame, scene), tables.detection_boxes_px(rows.table)
    _check_boxes(rows, "", boxes_px, size_px, nullable=False)
    for i, (name, number) in enumerate(zip(CENTRE_FORM, centre_form(boxes_px).T, strict=True)):
        apart = np.abs(rows.numbers(name, 0.0, size_px[:, i % 2] * (1 + ROUNDING)) - number)
        right = f"that of the box from {BOX_SIDES[i % 2]} to {BOX_SIDES[i % 2 + 2]}"
        rows.refuse(name, apart > ROUNDING * size_px[:, i % 2], right)
    errors = np.column_stack([rows.numbers(name, -MAX_ERROR_PX, MAX_ERROR_PX, nullable=True) for name in ERRORS])
    for i, name in enumerate(ERRORS):
        one_missing = np.isnan(errors[:, i]) != np.isnan(errors[:, 0])
        rows.refuse(name, one_missing, "a number like the other errors of the box, or null like them")
    rows.numbers("iou", 0.0, 1.0, slack=ROUNDING, nullable=True)


def check_together(frames: TableRows, truth: TableRows, detections: TableRows, scene: Scene) -> None:
    """Raise RunDirectoryError unless the rows of the same steps in the three tables, checked before, are of one run."""
    frame, of_truth, drawn = (tables.frame_numbers(rows.table, scene) for rows in (frames, truth, detections))
    state = tables.indices(frames.table, "state", [state.name for state in scene.detector.states])
    written = tables.indices(detections.table, "state", [state.name for state in scene.detector.states])
    detections.refuse("state", written != state[positions(frame, drawn)], "that of the frame in frames.parquet")
    annotated, detected = tables.flags(truth.table, "annotated"), tables.flags(truth.table, "detected")
    kind = tables.indices(detections.table, "kind", KINDS)
    own = ~np.isin(kind, FALSE_KINDS)
    boxes = _boxes_of(truth, detections, drawn, own, scene)
    truth.refuse("detected", (boxes > 0) & ~detected, "true, as detections.parquet has a box of the vessel")

    def count(numbers: Indices) -> Indices:
        """Number of times that the number of each row of `frames` is among some frame numbers."""
        return np.bincount(positions(frame, numbers), minlength=len(frame))

    merged, without_box = count(drawn[kind == MERGED]), count(of_truth[detected & (boxes == 0)])
    strange, right = merged != without_box, "so that each merged box has a second vessel, detected without a box"
    truth.refuse("detected", detected & (boxes == 0) & strange[positions(frame, of_truth)], right)
    detections.refuse("kind", (kind == MERGED) & strange[positions(frame, drawn)], right)
    counts = count(of_truth[annotated]), count(drawn[own]), count(drawn[~own])
    for name, tally in zip(("n_annotated", "n_detected", "n_false"), counts, strict=True):
        right = "the number in truth.parquet and detections.parquet"
        frames.refuse(name, tables.integer_column(frames.table, name) != tally, right)


def _boxes_of(truth: TableRows, detections: TableRows, drawn: Indices, own: Mask, scene: Scene) -> Indices:
    """Number of boxes of its own that each row of the truth has, 0 or 1, shape (n,). For each detection, `drawn` is the
    number of its frame, and `own` whether it is the one box of its vessel, shape (m,)."""
    vessels = len(scene.vessels)
    rows = np.flatnonzero(tables.flags(truth.table, "annotated"))
    key = tables.frame_numbers(truth.table, scene) * vessels
    key = (key + tables.indices(truth.table, "vessel", scene.vessel_names))[rows]
    vessel = tables.indices(detections.table, "vessel", scene.vessel_names)
    place = positions(key, drawn * vessels + vessel)
    strange = (vessel != NOBODY) & (place == NOBODY)
    detections.refuse("vessel", strange, "annotated in truth.parquet in this frame")
    own_rows = np.flatnonzero(own)
    second = np.ones(len(own), dtype=bool)
    second[own_rows[np.unique(place[own_rows], return_index=True)[1]]] = False
    detections.refuse("vessel", second & own, "in one box of its own in a frame")
    return np.bincount(rows[place[own]], minlength=len(truth.table))
