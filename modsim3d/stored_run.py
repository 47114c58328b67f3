"""A run directory, opened again: its scene, and its frames without running it anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.annotate.truth_record import Truth
from modsim3d.block import Frame, frames_of
from modsim3d.detector.reference import Reference
from modsim3d.errors import RunDirectoryError
from modsim3d.formats.block_files import TABLES, finished_truth
from modsim3d.formats.run_directory import POSES_FILE, RUN_FILE, SCENE_FOLDER, SETTINGS_FILE, UNFINISHED
from modsim3d.formats.table_reader import read_frames, read_truth
from modsim3d.scene import Scene
from modsim3d.scene_reader import load_scene
from modsim3d.simulate import Simulation, block_ranges, block_steps, survey


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A finished or an interrupted run.

    Attributes:
        folder: The run directory.
        settings: Of `run.json`; of an interrupted run, without counts.
        scene: From the copy in the folder.
        finished: Whether the run was.
        steps: Steps that are there; of an interrupted run, those whose truth was kept.
    """

    folder: Path
    settings: dict[str, Any]
    scene: Scene
    finished: bool
    steps: int

    @property
    def how_to_finish(self) -> str:
        """What to do with an interrupted run: what came in live cannot come again, but is kept."""
        if (self.folder / UNFINISHED / POSES_FILE).is_file():
            return f"`modsim3d run {self.scene.path} --out DIR` makes a finished run of the poses that came in"
        return "finish it with `modsim3d run SCENE --resume` first"

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames of steps first to stop − 1, in order of step and camera.

        An interrupted run's detections are drawn again from its truth: they are the ones that it would have written,
        but for a detector that must know the whole scene, which then knows only what is there.
        """
        simulation = None if self.finished else Simulation(self.scene, self._reference())
        stop = self.steps if stop is None else min(stop, self.steps)
        for start, end in block_ranges(self.scene.steps, block_steps(self.scene)):
            low, high = max(start, first), min(end, stop)
            if low >= high:
                continue
            if simulation is None:
                yield from read_frames(self.folder, self.scene, low, high)
            else:
                block = simulation.detect(self._kept(start, end), start, end)
                yield from frames_of(block, self.scene, range(low, high))

    def tables(self) -> dict[str, pa.Table]:
        """All rows of `frames`, `truth` and `detections`; an interrupted run's are those that it would have written.

        For who wants columns: many times as fast as `frames`, but all in memory.
        """
        if self.finished:
            return {name: pq.read_table(self.folder / f"{name}.parquet") for name in TABLES}
        parts = []
        for first, stop in block_ranges(self.scene.steps, block_steps(self.scene)):
            if first < self.steps:
                block = Simulation(self.scene).detect(self._kept(first, stop), first, stop)
                parts.append({name: table(block, self.scene) for name, (_, table) in TABLES.items()})
        return {name: pa.concat_tables([part[name] for part in parts]) for name in TABLES}

    def truth(self, first: int, stop: int) -> Truth:
        """The truth of steps first to stop − 1 of a finished run."""
        return read_truth(self.folder, self.scene, first, stop)

    def _reference(self) -> Reference | None:
        if not self.scene.detector.needs_reference:
            return None
        ranges = block_ranges(self.steps, block_steps(self.scene))
        return sum((survey(self.scene, self._kept(*steps), *steps) for steps in ranges), Reference())

    def _kept(self, start: int, end: int) -> Truth:
        truth = finished_truth(self.folder / UNFINISHED, start, end)
        if truth is None:
            raise RunDirectoryError(f"{self.folder} has lost the truth of steps {start} to {end - 1}")
        return truth


def open_run(folder: Path) -> StoredRun:
    """Open a run directory.

    Raises:
        RunDirectoryError: There is no run in it.
        InputError: The scene in it cannot be read.
    """
    finished = (folder / RUN_FILE).is_file()
    settings_file = folder / RUN_FILE if finished else folder / UNFINISHED / SETTINGS_FILE
    scene_folder = (folder if finished else folder / UNFINISHED) / SCENE_FOLDER
    try:
        settings = orjson.loads(settings_file.read_bytes())
        name = settings["scene"]
    except FileNotFoundError:
        what = "is no run directory: it has no run.json" if folder.is_dir() else "does not exist"
        raise RunDirectoryError(f"{folder} {what}") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunDirectoryError(f"{settings_file} is not what a run has written: {error}") from None
    if not scene_folder.is_dir():
        raise RunDirectoryError(
            f"{folder} holds no copy of its scene ({scene_folder}): it was written by an older version"
        )
    scene = load_scene(scene_folder / f"{name}.json")
    return StoredRun(folder, settings, scene, finished, scene.steps if finished else _kept_steps(folder, scene))


def _kept_steps(folder: Path, scene: Scene) -> int:
    """How many steps from the first on an interrupted run has kept the truth of."""
    kept = 0
    for start, end in block_ranges(scene.steps, block_steps(scene)):
        if finished_truth(folder / UNFINISHED, start, end) is None:
            break
        kept = end
    return kept
