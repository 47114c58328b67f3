"""The four layers of a run, each made from the one before and kept in memory while runs share it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from modsim3d.campaign.file.keys import CampaignKeys
from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.work.digests import detector_digest, digest, truth_digest
from modsim3d.campaign.work.latest import Latest
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.runs.camera_sequences import sequences_of
from modsim3d.runs.files.block_files import TABLES
from modsim3d.runs.pipeline import Simulation, open_renderer, scene_census, step_ranges, truth_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.registry import NamedTracker, named_tracker
from modsim3d.tracking.trackers.running import tracked
from modsim3d.tracks.tracks import Tracks
from modsim3d.truth.truth_record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

Blocks = list[tuple[Truth, int, int]]
"""The truth of some steps, the first of them, and the step after the last."""


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

    def __init__(self, keys: CampaignKeys, folder: Path) -> None:
        """Take the campaign file, and the folder that its paths are relative to."""
        self._scenes = Scenes(keys.steps, folder, learned=keys.uncertainty == "learned")
        self._opened = ExitStack()
        self._renderer: IdRenderer | None = None
        self._truth: Latest[Blocks] = Latest(2)
        self._rows: Latest[RunRows] = Latest(1)

    def close(self) -> None:
        """End the OpenGL context."""
        self._opened.close()

    def made(self, run: PlannedRun) -> Made:
        """All layers of a run.

        Raises:
            ModsimError: The scene, the detector or the tracker cannot be what the run asks for.
        """
        scene = self._scenes.of(run.condition, run.traffic_seed, run.detector_seed)
        renderer = self._open(scene)
        truth_key = truth_digest(scene, renderer.context.description if renderer else "none")
        blocks = self._truth.get(truth_key, lambda: list(_truth(scene, renderer)))
        detections_key = digest(truth_key, detector_digest(scene.detector), scene.detector_seed)
        rows = self._rows.get(detections_key, lambda: detected(scene, blocks))
        named = named_tracker(run.tracker.tracker, {**run.tracker.settings, **run.condition.of_tracker()}, scene.name)
        tracks_key = digest(detections_key, vars(named.origin))
        return Made(rows, tracks_of(rows, named), truth_key, detections_key, tracks_key)

    def _open(self, scene: Scene) -> IdRenderer | None:
        """The renderer of the process, which is opened once; None if the scene needs none."""
        if scene.annotation.source != "rendered":
            return None
        if self._renderer is None:
            self._renderer = self._opened.enter_context(open_renderer(scene))
        return self._renderer


def tracks_of(rows: RunRows, named: NamedTracker) -> Tracks:
    """The tracks of all cameras."""
    cameras = tuple(range(len(rows.scene.cameras)))
    return tracked(named, sequences_of(rows, cameras), cameras, rows.scene)


def detected(scene: Scene, blocks: Blocks) -> RunRows:
    """The rows of a run, in memory: those that `run_scene` would write."""
    simulation = Simulation(scene, scene_census(scene, blocks))
    made = [simulation.detect(*block) for block in blocks]
    tables = {name: pa.concat_tables([table(block, scene) for block in made]) for name, (_, table) in TABLES.items()}
    return RunRows.of_tables(scene, scene.steps, tables)


def _truth(scene: Scene, renderer: IdRenderer | None) -> Iterator[tuple[Truth, int, int]]:
    return ((truth_block(scene, first, stop, renderer), first, stop) for first, stop in step_ranges(scene))
