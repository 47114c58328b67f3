"""The layers of a run, each made from the one before or read from the disk, and in memory while runs share it."""

from __future__ import annotations

import errno
import shutil
import uuid
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.campaign.keys import CampaignKeys, Layer
from modsim3d.campaign.plan import PlannedRun
from modsim3d.campaign.work.scenes import LruCache, Scenes, detector_digest, digest, tracker_of, truth_digest
from modsim3d.core.errors import OutputError
from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.runs.files import tables
from modsim3d.runs.files.block_files import detected_tables
from modsim3d.runs.files.stored_tables import truth_of
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.files.tables import indices, integer_column, number_column
from modsim3d.runs.pipeline import detected_block, open_renderer, step_ranges, truth_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.truth_check import check_block
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.command import CommandTracker
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracking.trackers.running import run_tracker
from modsim3d.tracks.tracks import COVARIANCES, SCHEMA, Tracks, WorldTracks, track_table
from modsim3d.truth.record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

DETECTED = "detected"  # the only column of a run's truth that depends on the detector; in the layer of detections
TRUTH = {"truth": tables.TRUTH.remove(tables.TRUTH.get_field_index(DETECTED))}
DETECTIONS = {
    "frames": tables.FRAMES,
    "detections": tables.DETECTIONS,
    DETECTED: pa.schema([tables.TRUTH.field(DETECTED)]),
}
TRACKS = {"tracks": SCHEMA}
Blocks = Sequence[tuple[Truth, int, int]]  # the truth of some steps, the first of them, and the step after the last


@dataclass(frozen=True, eq=False)
class TruthLayer:
    """Truth of a run: as blocks for its detector, and as a table; one is made from the other when it is needed."""

    scene: Scene  # with any detector
    made: Blocks | None = None  # the blocks, if they were made here
    stored: pa.Table | None = None  # the table, if it was read

    @cached_property
    def blocks(self) -> Blocks:
        """The truth of each block of steps."""
        if self.made is not None:
            return self.made
        table = self.with_detected(pa.nulls(len(self.table), pa.bool_()))
        step = integer_column(table, "step")
        blocks = []
        for first, stop in step_ranges(self.scene):
            low, high = np.searchsorted(step, (first, stop)).tolist()
            blocks.append((truth_of(table.slice(low, high - low), self.scene), first, stop))
        return blocks

    @cached_property
    def table(self) -> pa.Table:
        """The rows of the table `truth` of a run, without the column that depends on the detector."""
        if self.stored is not None:
            return self.stored.combine_chunks()
        scene = self.scene
        blocks = [detected_block(scene, *block, _nothing_detected) for block in self.blocks]
        rows = [tables.truth_table(block, scene).drop_columns([DETECTED]) for block in blocks]
        return pa.concat_tables(rows).combine_chunks()

    def with_detected(self, detected: pa.Array | pa.ChunkedArray) -> pa.Table:
        """Table `truth` of a run, given whether each row was detected."""
        return self.table.append_column(tables.TRUTH.field(DETECTED), detected)


def _nothing_detected(frames: CameraFrames, targets: Targets) -> Detections:
    none, no_boxes, nobody = np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty(0, dtype=bool)
    states, gated = np.zeros(len(frames.steps), dtype=np.int64), np.zeros(len(targets.frame), dtype=bool)
    return Detections(states, none, none, none, none, none, np.empty(0), no_boxes, no_boxes, nobody, gated)


def stored_detections(made: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """Tables of the detections that are kept, from the tables of a run."""
    detected = pa.table([made["truth"][DETECTED]], schema=DETECTIONS[DETECTED])
    return {"frames": made["frames"], "detections": made["detections"], DETECTED: detected}


def rows_of(stored: Mapping[str, pa.Table], truth: TruthLayer, scene: Scene) -> RunRows | None:
    """Rows of a run from its layers, `stored` of which is what was kept of the detections; None if they do not fit."""
    detected = stored[DETECTED]
    if len(detected) != len(truth.table):
        return None
    content = {"frames": stored["frames"], "detections": stored["detections"]}
    return RunRows.of_tables(scene, scene.steps, {**content, "truth": truth.with_detected(detected[DETECTED])})


def tracks_of_table(table: pa.Table, scene: Scene) -> Tracks:
    """The tracks in a table that `track_table` made."""
    x, xy, y = (number_column(table, name) for name in COVARIANCES)
    return Tracks.of(
        len(scene.cameras),
        tables.frame_numbers(table, scene),
        integer_column(table, "track"),
        np.column_stack([number_column(table, name) for name in BOX_SIDES]),
        indices(table, "label", scene.detector.labels),
        number_column(table, "confidence"),
        np.stack([x, xy, xy, y], axis=-1).reshape(-1, 2, 2),
    )


CACHE_FOLDER = "cache"  # in the folder of a campaign, unless another one is named
_KEY = b"modsim3d_layer"


class StoredLayers:
    """Layers in a folder that any number of processes, campaigns and machines may share. A layer is in
    `LAYER/AB/ABCD…/`, a Parquet file for each of its tables. Its folder is complete from the moment at which it has its
    name. Pages carry checksums, so that a damaged layer is noticed and made anew."""

    def __init__(self, folder: Path, kept: Collection[Layer]) -> None:
        """Take the folder, and the layers that are written; those that are there are read, whichever they are."""
        self._folder, self._kept = folder, frozenset(kept)

    def keeps(self, layer: Layer) -> bool:
        """Whether this layer is written."""
        return layer in self._kept

    def path(self, layer: Layer, key: str) -> Path:
        """Folder of a layer; `key` is the checksum of all that decides it, in hexadecimal."""
        return self._folder / layer / key[:2] / key

    def read(self, layer: Layer, key: str, schemas: Mapping[str, pa.Schema]) -> dict[str, pa.Table] | None:
        """The tables of a layer, by their names; None if they are not there, or are damaged."""
        folder = self.path(layer, key)
        if not folder.is_dir():
            return None
        try:
            return {name: _read(folder / f"{name}.parquet", schema, key) for name, schema in schemas.items()}
        except (OSError, ValueError, KeyError, pa.ArrowException):
            return None

    def write(self, layer: Layer, key: str, tables: Mapping[str, pa.Table]) -> None:
        """Write a layer, in place of a damaged one if there is one; OutputError if it cannot be written. Nothing waits
        for the disk here: what a machine that stops leaves half written is damaged, and made anew."""
        final = self.path(layer, key)
        partial = final.with_name(f".{uuid.uuid4().hex}")
        try:
            partial.mkdir(parents=True)
            for name, table in tables.items():
                _write(partial / f"{name}.parquet", table, key)
            _put_in_place(partial, final)
        except OSError as error:
            raise OutputError(f"{final} cannot be written: {error.strerror or error}") from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _put_in_place(partial: Path, final: Path) -> None:
    """Give a complete folder its name; one that is there is damaged, or another process has made the same meanwhile.
    Raises OSError if it cannot be renamed."""
    if final.exists():
        damaged = final.with_name(f".{uuid.uuid4().hex}")
        with suppress(FileNotFoundError):
            final.rename(damaged)
        shutil.rmtree(damaged, ignore_errors=True)
    try:
        partial.rename(final)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # another process was faster
            raise


def _write(path: Path, table: pa.Table, key: str) -> None:
    table = table.replace_schema_metadata({_KEY: key.encode()})
    with path.open("wb") as out:
        pq.write_table(table, out, compression="zstd", write_page_checksum=True)


def _read(path: Path, schema: pa.Schema, key: str) -> pa.Table:
    """A table of a layer; ValueError if it is of another layer or has other columns, OSError if it cannot be read."""
    with path.open("rb") as file:
        table = pq.read_table(file, page_checksum_verification=True, use_threads=False)
    if (table.schema.metadata or {}).get(_KEY) != key.encode() or not table.schema.equals(schema):
        raise ValueError(f"{path} is of another layer")
    return table.cast(schema)  # its descriptions of columns are those of the schema


@dataclass(frozen=True, eq=False)
class LayeredRun:
    """One run in all its layers, with the checksums of all that decides each."""

    rows: RunRows
    tracks: Tracks | WorldTracks
    truth_key: str
    detections_key: str
    tracks_key: str
    took: Mapping[str, Any] = field(default_factory=dict)
    """Costs of the tracker by the name of a column, and whether a program's output `repeats`; empty if it is not
    noted."""


class RunLayers:
    """Makes the layers of runs, in one process with one OpenGL context."""

    def __init__(self, keys: CampaignKeys, folder: Path, cache: Path) -> None:
        """Take the campaign file, the folder that its paths are relative to, and that of layers on the disk."""
        self._keys = keys
        self._scenes = Scenes(keys.steps, folder, learned=keys.uncertainty == "learned")
        self._stored = StoredLayers(cache, keys.keep)
        self._opened = ExitStack()
        self._renderer: IdRenderer | None = None
        self._truth: LruCache[TruthLayer] = LruCache(2)
        self._rows: LruCache[RunRows] = LruCache(1)

    def close(self) -> None:
        """End the OpenGL context."""
        self._opened.close()

    def layers_of(self, run: PlannedRun) -> LayeredRun:
        """All layers of a run. Raises ModsimError if the scene, the detector or the tracker cannot be what the run asks
        for, and OutputError if a layer that is kept cannot be written."""
        scene = self._scenes.of(run.condition, run.traffic_seed, run.detector_seed)
        renderer = self._open(scene)
        truth_key = truth_digest(scene, renderer.context.description if renderer else "none")
        detections_key = digest(truth_key, detector_digest(scene.detector), scene.detector_seed)
        rows = self._rows.get(detections_key, lambda: self._rows_of(scene, renderer, truth_key, detections_key))
        named = tracker_of(run.tracker, run.condition.of_tracker(), scene.name, self._scenes.folder)
        plugin = [named.plugin.sha256] if named.plugin else []
        tracks_key = digest(detections_key, vars(named.origin), *plugin)
        if not self._keys.timed:
            return LayeredRun(rows, self._tracks_of(rows, named, tracks_key), truth_key, detections_key, tracks_key)
        output = run_tracker(named, rows)
        self._keep(output.tracks, rows.scene, tracks_key)
        took: dict[str, Any] = {f"frame_ms_{name}": value for name, value in output.frame_ms.items()}
        took["peak_memory_mb"] = output.peak_memory_mb
        if run.number < len(self._keys.trackers) and isinstance(named.tracker, CommandTracker):
            took["repeats"] = same_tracks(output.tracks, run_tracker(named, rows).tracks)
        return LayeredRun(rows, output.tracks, truth_key, detections_key, tracks_key, took)

    def _open(self, scene: Scene) -> IdRenderer | None:
        """The renderer of the process, which is opened once; None if the scene needs none."""
        if scene.annotation.source != "rendered":
            return None
        if self._renderer is None:
            self._renderer = self._opened.enter_context(open_renderer(scene))
        return self._renderer

    def _rows_of(self, scene: Scene, renderer: IdRenderer | None, truth_key: str, key: str) -> RunRows:
        """Truth and detections, from the disk if they are there."""
        truth = self._truth.get(truth_key, lambda: self._truth_of(scene, renderer, truth_key))
        stored = self._stored.read("detections", key, DETECTIONS)
        if stored is not None and (rows := rows_of(stored, truth, scene)) is not None:
            return rows
        content = detected_tables(scene, truth.blocks)
        if self._stored.keeps("detections"):
            self._stored.write("detections", key, stored_detections(content))
        return RunRows.of_tables(scene, scene.steps, content)

    def _truth_of(self, scene: Scene, renderer: IdRenderer | None, key: str) -> TruthLayer:
        """The truth, from the disk if it is there."""
        stored = self._stored.read("truth", key, TRUTH)
        if stored is not None:
            return TruthLayer(scene, stored=stored["truth"])
        blocks = [(truth_block(scene, first, stop, renderer), first, stop) for first, stop in step_ranges(scene)]
        for block in blocks:
            check_block(scene, *block, renderer)
        truth = TruthLayer(scene, made=blocks)
        if self._stored.keeps("truth"):
            self._stored.write("truth", key, {"truth": truth.table})
        return truth

    def _tracks_of(self, rows: RunRows, named: NamedTracker, key: str) -> Tracks | WorldTracks:
        """The tracks of all cameras, from the disk if they are there."""
        stored = self._stored.read("tracks", key, TRACKS)
        if stored is not None:
            return tracks_of_table(stored["tracks"], rows.scene)
        tracks = run_tracker(named, rows).tracks
        self._keep(tracks, rows.scene, key)
        return tracks

    def _keep(self, tracks: Tracks | WorldTracks, scene: Scene, key: str) -> None:
        if self._stored.keeps("tracks") and isinstance(tracks, Tracks):
            self._stored.write("tracks", key, {"tracks": track_table(tracks, scene)})


def same_tracks(one: Tracks | WorldTracks, other: Tracks | WorldTracks) -> bool:
    """Whether two trackers have said the same, number for number."""
    return type(one) is type(other) and all(
        np.array_equal(column, getattr(other, name), equal_nan=column.dtype.kind == "f")
        for name, column in vars(one).items()
        if isinstance(column, np.ndarray)
    )
