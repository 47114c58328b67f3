"""The layers of a run, each made from the one before or read from the disk, and in memory while runs share it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from modsim3d.campaign.file.keys import CampaignKeys
from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.work.digests import detector_digest, digest, truth_digest
from modsim3d.campaign.work.latest import Latest
from modsim3d.campaign.work.layer_tables import (
    DETECTIONS,
    TRACKS,
    TRUTH,
    TruthLayer,
    rows_of,
    stored_detections,
    tracks_of_table,
)
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.stored_layers import StoredLayers
from modsim3d.runs.camera_sequences import sequences_of
from modsim3d.runs.files.block_files import TABLES
from modsim3d.runs.pipeline import Simulation, open_renderer, scene_census, step_ranges, truth_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.truth_check import check_block
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.registry import NamedTracker, named_tracker
from modsim3d.tracking.trackers.running import tracked
from modsim3d.tracks.files.track_columns import track_table
from modsim3d.tracks.tracks import Tracks

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer


@dataclass(frozen=True, eq=False)
class Made:
    """One run in all its layers.

    Attributes:
        rows: Truth and detections.
        tracks: The tracks.
        truth_key: Checksum of all that decides the truth.
        detections_key: The same for the detections.
        tracks_key: The same for the tracks.
    """

    rows: RunRows
    tracks: Tracks
    truth_key: str
    detections_key: str
    tracks_key: str


class Layers:
    """Makes the layers of runs, in one process with one OpenGL context."""

    def __init__(self, keys: CampaignKeys, folder: Path, cache: Path) -> None:
        """Take the campaign file, the folder that its paths are relative to, and that of layers on the disk."""
        self._scenes = Scenes(keys.steps, folder, learned=keys.uncertainty == "learned")
        self._stored = StoredLayers(cache, keys.keep)
        self._opened = ExitStack()
        self._renderer: IdRenderer | None = None
        self._truth: Latest[TruthLayer] = Latest(2)
        self._rows: Latest[RunRows] = Latest(1)

    def close(self) -> None:
        """End the OpenGL context."""
        self._opened.close()

    def made(self, run: PlannedRun) -> Made:
        """All layers of a run.

        Raises:
            ModsimError: The scene, the detector or the tracker cannot be what the run asks for.
            OutputError: A layer that is kept cannot be written.
        """
        scene = self._scenes.of(run.condition, run.traffic_seed, run.detector_seed)
        renderer = self._open(scene)
        truth_key = truth_digest(scene, renderer.context.description if renderer else "none")
        detections_key = digest(truth_key, detector_digest(scene.detector), scene.detector_seed)
        rows = self._rows.get(detections_key, lambda: self._rows_of(scene, renderer, truth_key, detections_key))
        named = named_tracker(run.tracker.tracker, {**run.tracker.settings, **run.condition.of_tracker()}, scene.name)
        plugin = [named.plugin.sha256] if named.plugin else []
        tracks_key = digest(detections_key, vars(named.origin), *plugin)
        return Made(rows, self._tracks_of(rows, named, tracks_key), truth_key, detections_key, tracks_key)

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
        tables = detected(scene, truth)
        rows = RunRows.of_tables(scene, scene.steps, tables)
        if self._stored.keeps("detections"):
            self._stored.write("detections", key, stored_detections(tables))
        return rows

    def _truth_of(self, scene: Scene, renderer: IdRenderer | None, key: str) -> TruthLayer:
        """The truth, from the disk if it is there."""
        stored = self._stored.read("truth", key, TRUTH)
        if stored is not None:
            return TruthLayer.of_table(stored["truth"], scene)
        blocks = [(truth_block(scene, first, stop, renderer), first, stop) for first, stop in step_ranges(scene)]
        for block in blocks:
            check_block(scene, *block, renderer)
        truth = TruthLayer.of_blocks(blocks, scene)
        if self._stored.keeps("truth"):
            self._stored.write("truth", key, {"truth": truth.table})
        return truth

    def _tracks_of(self, rows: RunRows, named: NamedTracker, key: str) -> Tracks:
        """The tracks of all cameras, from the disk if they are there."""
        stored = self._stored.read("tracks", key, TRACKS)
        if stored is not None:
            return tracks_of_table(stored["tracks"], rows.scene)
        tracks = tracks_of(rows, named)
        if self._stored.keeps("tracks"):
            self._stored.write("tracks", key, {"tracks": track_table(tracks, rows.scene)})
        return tracks


def tracks_of(rows: RunRows, named: NamedTracker) -> Tracks:
    """The tracks of all cameras."""
    cameras = tuple(range(len(rows.scene.cameras)))
    return tracked(named, sequences_of(rows, cameras), cameras, rows.scene)


def detected(scene: Scene, truth: TruthLayer) -> dict[str, pa.Table]:
    """The tables of a run, by their names: those that `run_scene` would write."""
    simulation = Simulation(scene, scene_census(scene, truth.blocks))
    made = [simulation.detect(*block) for block in truth.blocks]
    return {name: pa.concat_tables([table(block, scene) for block in made]) for name, (_, table) in TABLES.items()}
