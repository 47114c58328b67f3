"""A block as rows of tables and JSON lines; and the truth of a block, kept so that a run can be resumed."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import centre_form
from modsim3d.detector.records import DUPLICATE, FRAGMENT, ON_VESSEL
from modsim3d.io.atomic_write import written_whole
from modsim3d.runs.blocks import Block, CameraBlock
from modsim3d.runs.files import table_columns, tables
from modsim3d.runs.files.row_checks import MAX_DEPTH_M, ROUNDING, frames_taken
from modsim3d.runs.files.run_file import Column, frame_lines, string_texts
from modsim3d.runs.pipeline import Simulation, scene_statistics
from modsim3d.runs.tracker_view import TRACKER_INPUT, tracker_lines
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import COLUMNS, Truth, annotation_boxes, no_truth

JOINED_BYTES = 1 << 17  # bytes of lines that are joined at a time


def annotation_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The annotations of a camera, one line a frame: timestamp → vessel ID → label and box with depth."""
    truth, rows = part.truth, part.target_rows
    names = string_texts(scene.vessel_names)
    labels = _label_texts([vessel.label for vessel in scene.vessels], b"bbox")
    heads = [name + label + b"{" for name, label in zip(names, labels, strict=True)]
    boxes = centre_form(annotation_boxes(truth, scene.annotation.mode)[rows])
    return _lines(
        block,
        part,
        np.searchsorted(part.steps, truth.step[rows]),
        [heads[vessel] for vessel in truth.vessel[rows].tolist()],
        *_box_columns(boxes),
        b',"depth":',
        truth.depth_m[rows],
        b"}}",
    )


def detection_lines(block: Block, part: CameraBlock, scene: Scene) -> bytes:
    """The detections of a camera, one line a frame: timestamp → vessel ID or `false_positive_<n>` → label and so on."""
    detections = part.detections
    second = np.isin(detections.kind, (DUPLICATE, FRAGMENT, ON_VESSEL))
    order = np.lexsort((second, detections.frame))  # a vessel's first detection gets its plain name
    frame, rows = detections.frame[order], part.truth_row[order]
    vessel = np.full(len(rows), -1)
    vessel[rows >= 0] = part.truth.vessel[rows[rows >= 0]]
    before = _before_in_group(frame * (len(scene.vessels) + 1) + vessel + 1)
    labels = _label_texts(scene.detector.labels, b"confidenceScore")
    return _lines(
        block,
        part,
        frame,
        _keys(scene, vessel, before),
        [labels[label] for label in detections.label[order].tolist()],
        detections.confidence[order],
        b',"bbox":{',
        *_box_columns(centre_form(detections.boxes_px[order])),
        b"}}",
    )


def _before_in_group(group: Indices) -> Indices:
    """Number of rows before each row that are of its group, shape (n,)."""
    order = np.argsort(group, kind="stable")
    ordered, before = group[order], np.empty_like(order)
    before[order] = np.arange(len(group)) - np.searchsorted(ordered, ordered)
    return before


def _keys(scene: Scene, vessel: Indices, before: Indices) -> list[bytes]:
    """The key of each of m detections in the object of its frame: the vessel's ID, and `<vessel ID>#2` for the vessel's
    second box; false positives, of `vessel` −1, are numbered from 1. `before` counts the detections of the frame before
    each that are of its vessel, shape (m,)."""
    names = string_texts(scene.vessel_names)
    keys = [names[index] for index in vessel.tolist()]
    for row in np.flatnonzero((vessel < 0) | (before > 0)).tolist():
        prefix = f"{scene.vessel_names[vessel[row]]}#" if vessel[row] >= 0 else "false_positive_"
        keys[row] = orjson.dumps(f"{prefix}{before[row] + 1}")
    return keys


def _label_texts(labels: Sequence[str], after: bytes) -> list[bytes]:
    """Text after the key of an entry, up to what comes after its label."""
    return [b':{"label":' + label + b',"' + after + b'":' for label in string_texts(labels)]


def _box_columns(boxes: Array) -> tuple[Column, ...]:
    """Boxes in centre form, shape (n, 4), up to the width."""
    x, y, width, height = boxes.T
    return b'"centre":{"x":', x, b',"y":', y, b'},"height":', height, b',"width":', width


def _lines(block: Block, part: CameraBlock, frame: Indices, *columns: Column) -> bytes:
    timestamps = string_texts(block.timestamps)
    heads = [b"{" + timestamps[step - block.first] + b":{" for step in part.steps.tolist()]
    return frame_lines(heads, b"}}\n", frame, *columns)


def join_lines(lines: Path, out: IO[bytes]) -> None:
    """Join a file of such lines to one JSON object. JSON escapes line breaks inside strings, so the bytes `}`, line
    break, `{` occur only between two lines."""
    with lines.open("rb") as source:
        if not source.read(1):
            out.write(b"{}\n")
            return
        out.write(b"{\n")
        end = b""  # perhaps a part of what is between two lines
        while some := source.read(JOINED_BYTES):
            text = (end + some).replace(b"}\n{", b",\n")
            out.write(memoryview(text)[:-2])
            end = text[-2:]
        out.write(b"\n}\n")


_INTEGERS = ("step", "camera", "vessel", "occluder_offsets", "occluder", "intersections")
_OF_OCCLUDERS = ("occluder", "occluder_px")
_EMPTY = {name: getattr(no_truth(), name) for name in COLUMNS}


def truth_of_columns(columns: Mapping[str, NDArray[Any]], scene: Scene, first: int, stop: int) -> Truth | None:
    """The truth of steps first to stop − 1 of a scene; None if the columns cannot be that."""
    if not _has_form(columns):
        return None
    truth = Truth(**columns)
    return truth if _has_places(truth, scene, first, stop) and _has_values(truth, scene) else None


def _has_form(columns: Mapping[str, NDArray[Any]]) -> bool:
    """Whether all columns are there, each of its kind and with as many rows as it must have."""
    if columns.keys() != set(COLUMNS) or any(columns[name].ndim != _EMPTY[name].ndim for name in COLUMNS):
        return False
    rows, occluders = len(columns["step"]), len(columns["occluder"])
    own = {"occluder_offsets": rows + 1, "intersections": len(columns["intersections"])}
    counts = {**dict.fromkeys(COLUMNS, rows), **dict.fromkeys(_OF_OCCLUDERS, occluders), **own}
    kinds = {**dict.fromkeys(COLUMNS, "if"), **dict.fromkeys(_INTEGERS, "i"), "annotated": "b", "drawn": "b"}
    return all(
        columns[name].shape == (counts[name], *_EMPTY[name].shape[1:]) and columns[name].dtype.kind in kinds[name]
        for name in COLUMNS
    )


def _has_places(truth: Truth, scene: Scene, first: int, stop: int) -> bool:
    """Whether rows are in order, of frames that were taken, and whether indices name what the scene has."""
    names = len(scene.occluder_names)
    indices = ((truth.camera, len(scene.cameras)), (truth.vessel, len(scene.vessels)), (truth.occluder, names))
    if not all(((index >= 0) & (index < count)).all() for index, count in indices):
        return False
    frame = truth.step * len(scene.cameras) + truth.camera
    offsets, pairs = truth.occluder_offsets, truth.intersections[:, 2:]
    return bool(
        ((first <= truth.step) & (truth.step < stop)).all()
        and np.isin(frame, frames_taken(scene, first, stop)).all()
        and (np.diff(frame * len(scene.vessels) + truth.vessel) > 0).all()
        and offsets[0] == 0
        and offsets[-1] == len(truth.occluder)
        and (np.diff(offsets) >= 0).all()
        and ((pairs >= 0) & (pairs < names)).all()
    )


def _has_values(truth: Truth, scene: Scene) -> bool:
    """Whether boxes lie in their images, and numbers in their ranges; NaN only where it may be."""
    sizes_px = np.array([camera.intrinsics.image_size_px for camera in scene.cameras], dtype=np.float64)[truth.camera]
    most_px = sizes_px.prod(axis=1) * (1 + ROUNDING)
    hidden = np.repeat(most_px, np.diff(truth.occluder_offsets))
    unseen = np.isnan(truth.visible_boxes_px).all(axis=1)
    if scene.annotation.mode == 2 and (truth.annotated & unseen).any():
        return False
    ranges = (
        (truth.silhouette_px, 0.0, most_px, False),
        (truth.visible_px, 0.0, most_px, True),
        (truth.visible_fraction, 0.0, 1 + ROUNDING, True),
        (truth.in_frame_fraction, 0.0, 1 + ROUNDING, True),
        (truth.depth_m, -MAX_DEPTH_M, MAX_DEPTH_M, scene.labels is not None),
        (truth.occluder_px, 0.0, hidden, False),
    )
    boxes = _in_image(truth.full_boxes_px, sizes_px) & (unseen | _in_image(truth.visible_boxes_px, sizes_px))
    return bool(boxes.all()) and all(
        bool((((least <= values) & (values <= most)) | (np.isnan(values) & unknown)).all())
        for values, least, most, unknown in ranges
    )


def _in_image(boxes_px: Array, sizes_px: Array) -> Mask:
    """Whether boxes, shape (n, 4), are within images of these sizes, shape (n, 2), with no side below 0, shape (n,)."""
    slack = ROUNDING * sizes_px
    low, high = boxes_px[:, :2], boxes_px[:, 2:]
    return np.asarray(((low >= -slack) & (high <= sizes_px + slack) & (high >= low - slack)).all(axis=1))


TABLES = {
    "frames": (tables.FRAMES, tables.frame_table),
    "truth": (tables.TRUTH, tables.truth_table),
    "detections": (tables.DETECTIONS, tables.detection_table),
}


def detected_tables(scene: Scene, blocks: Sequence[tuple[Truth, int, int]]) -> dict[str, pa.Table]:
    """The tables of a run, by their names: those that `run_scene` would write of the truth of all blocks, each with its
    first step and the step after its last."""
    simulation = Simulation(scene, scene_statistics(scene, blocks))
    made = [simulation.detect(*block) for block in blocks]
    return {name: pa.concat_tables([table(block, scene) for block in made]) for name, (_, table) in TABLES.items()}


DIGEST_BYTES = hashlib.sha256().digest_size
OWN_SHIP = "ownship"
SETTINGS_FILE = "settings.json"  # the settings of a run, beside its kept blocks
THESIS_LINES = {"annotations": annotation_lines, "detections": detection_lines}
"""Kinds of JSON lines that become one JSON object at the end of a run."""
JSON_LINES = {**THESIS_LINES, TRACKER_INPUT: tracker_lines}  # all kinds of JSON lines, each in a file for each camera


def line_kinds(thesis_json: bool) -> tuple[str, ...]:
    """The kinds of JSON lines of a run, with or without those of the thesis's JSON."""
    return tuple(kind for kind in JSON_LINES if thesis_json or kind not in THESIS_LINES)


def schemas_of(scene: Scene) -> dict[str, pa.Schema]:
    """The schema of each table that a run of the scene has."""
    own_ship = {OWN_SHIP: table_columns.OWN_SHIP_SCHEMA} if scene.own_ships else {}
    return {**{name: schema for name, (schema, _) in TABLES.items()}, **own_ship}


@dataclass(frozen=True, eq=False)
class BlockFiles:
    """Additions of a block to the files of a run."""

    tables: dict[str, pa.Table]  # new rows by the name of the table
    lines: dict[tuple[str, int], bytes]  # new complete lines by the kind of file and the index of the camera

    @classmethod
    def of(cls, block: Block, scene: Scene, kinds: Sequence[str]) -> BlockFiles:
        """Format a block, with these kinds of JSON lines."""
        rows = {name: table(block, scene) for name, (_, table) in TABLES.items()}
        if scene.own_ships and not scene.live:  # accelerations need later steps: written at the end
            rows[OWN_SHIP] = table_columns.own_ship_table(scene, block.first, block.stop)
        lines = {(kind, part.camera): JSON_LINES[kind](block, part, scene) for part in block.cameras for kind in kinds}
        return cls(rows, lines)


KEPT_TRUTH = "truth_*.npz"  # the files with the truth of blocks


def kept_truth_path(folder: Path, first: int, stop: int) -> Path:
    """The file with the truth of a block: NumPy's `.npz`, and after it a digest."""
    return folder / f"truth_{first:09d}_{stop:09d}.npz"


def finished_truth(folder: Path, scene: Scene, first: int, stop: int) -> Truth | None:
    """The truth of a block that an interrupted run of a scene kept; None if it kept none, or if the file is damaged. A
    file of another run or with other steps is damaged too."""
    path = kept_truth_path(folder, first, stop)
    if not path.is_file():
        return None
    try:
        content = path.read_bytes()
    except OSError:
        return None
    packed = content[:-DIGEST_BYTES]
    if _digest(path, packed) != content[-DIGEST_BYTES:]:
        return None
    try:
        with np.load(io.BytesIO(packed)) as columns:
            return truth_of_columns(dict(columns), scene, first, stop)
    except (ValueError, TypeError, KeyError, OSError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


@contextmanager
def truth_kept(folder: Path, truth: Truth, first: int, stop: int) -> Iterator[None]:
    """Keep the truth of a block on the disk, so that an interrupted run can be resumed. A thread waits for the disk,
    while what is made of the truth is made; at the end the truth is on the disk."""
    path, packed = kept_truth_path(folder, first, stop), io.BytesIO()
    np.savez(packed, **{name: getattr(truth, name) for name in COLUMNS})
    with packed.getbuffer() as content, ThreadPoolExecutor(1) as thread:
        kept = thread.submit(_keep, path, content)
        yield
        kept.result()


def _keep(path: Path, packed: memoryview) -> None:
    with written_whole(path) as partial, partial.open("wb") as out:
        out.write(packed)
        out.write(_digest(path, packed))


def _digest(path: Path, packed: bytes | memoryview) -> bytes:
    """SHA-256 of a block with its run and its steps: of the run's settings, the file's name and what is in it."""
    digest = hashlib.sha256(path.with_name(SETTINGS_FILE).read_bytes() + path.name.encode())
    digest.update(packed)
    return digest.digest()
