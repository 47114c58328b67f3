"""The tables in which layers are kept on the disk: those of a run, with the detector's part of the truth apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa

from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.runs.files import tables
from modsim3d.runs.files.columns import indices, integers, numbers
from modsim3d.runs.files.reading import truth_of
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.pipeline import detected_block, step_ranges
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.tracks.files.track_columns import COVARIANCES, SCHEMA
from modsim3d.tracks.tracks import Tracks
from modsim3d.truth.truth_record import Truth

DETECTED = "detected"
"""The only column of a run's truth that depends on the detector; a table of its own in the layer of detections."""
TRUTH = {"truth": tables.TRUTH.remove(tables.TRUTH.get_field_index(DETECTED))}
DETECTIONS = {
    "frames": tables.FRAMES,
    "detections": tables.DETECTIONS,
    DETECTED: pa.schema([tables.TRUTH.field(DETECTED)]),
}
TRACKS = {"tracks": SCHEMA}
Blocks = Sequence[tuple[Truth, int, int]]
"""The truth of some steps, the first of them, and the step after the last."""


@dataclass(frozen=True, eq=False)
class TruthLayer:
    """The truth of a run: as blocks for its detector, and as a table; one is made from the other when it is needed.

    Attributes:
        scene: The scene, with any detector.
        made: The blocks, if they were made here.
        stored: The table, if it was read.
    """

    scene: Scene
    made: Blocks | None = None
    stored: pa.Table | None = None

    @classmethod
    def of_blocks(cls, blocks: Blocks, scene: Scene) -> TruthLayer:
        """Truth that was made."""
        return cls(scene, made=blocks)

    @classmethod
    def of_table(cls, table: pa.Table, scene: Scene) -> TruthLayer:
        """Truth that was read."""
        return cls(scene, stored=table)

    @cached_property
    def blocks(self) -> Blocks:
        """The truth of each block of steps."""
        if self.made is not None:
            return self.made
        table = self.with_detected(pa.nulls(len(self.table), pa.bool_()))
        step = integers(table, "step")
        found = []
        for first, stop in step_ranges(self.scene):
            low, high = np.searchsorted(step, (first, stop)).tolist()
            found.append((truth_of(table.slice(low, high - low), self.scene), first, stop))
        return found

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
        """The table `truth` of a run.

        Args:
            detected: Whether each row was detected.
        """
        return self.table.append_column(tables.TRUTH.field(DETECTED), detected)


def _nothing_detected(frames: CameraFrames, targets: Targets) -> Detections:
    none, no_boxes, nobody = np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty(0, dtype=bool)
    states, gated = np.zeros(len(frames.steps), dtype=np.int64), np.zeros(len(targets.frame), dtype=bool)
    return Detections(states, none, none, none, none, none, np.empty(0), no_boxes, no_boxes, nobody, gated)


def stored_detections(made: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """What is kept of the detections, from the tables of a run."""
    detected = pa.table([made["truth"][DETECTED]], schema=DETECTIONS[DETECTED])
    return {"frames": made["frames"], "detections": made["detections"], DETECTED: detected}


def rows_of(stored: Mapping[str, pa.Table], truth: TruthLayer, scene: Scene) -> RunRows | None:
    """The rows of a run from its layers; None if they do not belong together.

    Args:
        stored: What was kept of the detections.
        truth: The truth.
        scene: The scene with its detector.
    """
    detected = stored[DETECTED]
    if len(detected) != len(truth.table):
        return None
    found = {"frames": stored["frames"], "detections": stored["detections"]}
    return RunRows.of_tables(scene, scene.steps, {**found, "truth": truth.with_detected(detected[DETECTED])})


def tracks_of_table(table: pa.Table, scene: Scene) -> Tracks:
    """The tracks in a table that `track_table` made."""
    cameras = [camera.name for camera in scene.cameras]
    frame = integers(table, "step") * len(cameras) + indices(table, "camera", cameras)
    x, xy, y = (numbers(table, name) for name in COVARIANCES)
    return Tracks.of(
        len(cameras),
        frame,
        integers(table, "track"),
        np.column_stack([numbers(table, name) for name in BOX_SIDES]),
        indices(table, "label", scene.detector.labels),
        numbers(table, "confidence"),
        np.stack([x, xy, xy, y], axis=-1).reshape(-1, 2, 2),
    )
