"""A block as rows of tables and JSON lines; and the truth of a block, kept so that a run can be resumed."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from modsim3d.outputs.placing import written_whole
from modsim3d.runs.blocks import Block
from modsim3d.runs.files import own_ships_table, tables, thesis_json
from modsim3d.runs.files.kept_truth import truth_of_columns
from modsim3d.runs.files.tracker_input import TRACKER_INPUT, tracker_lines
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import COLUMNS, Truth

TABLES = {
    "frames": (tables.FRAMES, tables.frame_table),
    "truth": (tables.TRUTH, tables.truth_table),
    "detections": (tables.DETECTIONS, tables.detection_table),
}
DIGEST_BYTES = hashlib.sha256().digest_size
OWN_SHIP = "ownship"
SETTINGS_FILE = "settings.json"
"""The settings of a run, beside its kept blocks."""
THESIS_LINES = {"annotations": thesis_json.annotation_lines, "detections": thesis_json.detection_lines}
"""Kinds of JSON lines that become one JSON object at the end of a run."""
JSON_LINES = {**THESIS_LINES, TRACKER_INPUT: tracker_lines}
"""All kinds of JSON lines; there is a file of each for each camera."""


def line_kinds(thesis_json: bool) -> tuple[str, ...]:
    """The kinds of JSON lines of a run, with or without those of the thesis's JSON."""
    return tuple(kind for kind in JSON_LINES if thesis_json or kind not in THESIS_LINES)


def schemas_of(scene: Scene) -> dict[str, pa.Schema]:
    """The schema of each table that a run of the scene has."""
    own_ship = {OWN_SHIP: own_ships_table.OWN_SHIP} if scene.own_ships else {}
    return {**{name: schema for name, (schema, _) in TABLES.items()}, **own_ship}


@dataclass(frozen=True, eq=False)
class BlockFiles:
    """What a block adds to the files of a run.

    Attributes:
        tables: New rows by the name of the table.
        lines: New complete lines by the kind of file and the index of the camera.
    """

    tables: dict[str, pa.Table]
    lines: dict[tuple[str, int], bytes]

    @classmethod
    def of(cls, block: Block, scene: Scene, kinds: Sequence[str]) -> BlockFiles:
        """Format a block, with these kinds of JSON lines."""
        rows = {name: table(block, scene) for name, (_, table) in TABLES.items()}
        if scene.own_ships and not scene.live:  # accelerations need later steps: written at the end
            rows[OWN_SHIP] = own_ships_table.own_ship_table(scene, block.first, block.stop)
        lines = {(kind, part.camera): JSON_LINES[kind](block, part, scene) for part in block.cameras for kind in kinds}
        return cls(rows, lines)


KEPT_TRUTH = "truth_*.npz"
"""The files with the truth of blocks."""


def kept_truth_path(folder: Path, first: int, stop: int) -> Path:
    """The file with the truth of a block: NumPy's `.npz`, and after it a digest."""
    return folder / f"truth_{first:09d}_{stop:09d}.npz"


def finished_truth(folder: Path, scene: Scene, first: int, stop: int) -> Truth | None:
    """The truth of a block that an interrupted run of a scene kept; None if it kept none, or if the file is damaged.

    A file of another run or with other steps is damaged too.
    """
    path = kept_truth_path(folder, first, stop)
    if not path.is_file():
        return None
    try:
        content = path.read_bytes()
    except OSError:
        return None
    packed, digest = content[:-DIGEST_BYTES], content[-DIGEST_BYTES:]
    if _digest(path, packed) != digest:
        return None
    try:
        with np.load(io.BytesIO(packed)) as columns:
            return truth_of_columns(dict(columns), scene, first, stop)
    except (ValueError, TypeError, KeyError, OSError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


@contextmanager
def truth_kept(folder: Path, truth: Truth, first: int, stop: int) -> Iterator[None]:
    """Keep the truth of a block on the disk, so that an interrupted run can be resumed.

    A thread waits for the disk, while what is made of the truth is made; at the end the truth is on the disk.
    """
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
    """The SHA-256 of a block with its run and its steps: of the run's settings, the file's name and what is in it."""
    digest = hashlib.sha256(path.with_name(SETTINGS_FILE).read_bytes() + path.name.encode())
    digest.update(packed)
    return digest.digest()
