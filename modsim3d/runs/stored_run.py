"""A run directory, opened for reading: its scene, truth, detections and frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa

from modsim3d.errors import ModsimError, RunDirectoryError
from modsim3d.runs.blocks import Block, Frame, frames_of
from modsim3d.runs.files.block_files import SETTINGS_FILE, TABLES, finished_truth
from modsim3d.runs.files.columns import read_rows
from modsim3d.runs.files.reading import read_detections, read_truth
from modsim3d.runs.files.replacing import POSES_FILE, RUN_FILE, SCENE_FOLDER, UNFINISHED
from modsim3d.runs.pipeline import Range, Simulation, block_ranges, block_steps, detected_block, scene_census
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.truth.truth_record import Truth


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A finished or an interrupted run.

    An interrupted run has kept its truth, and its detections are made from that truth again: the same that it would
    have written. They may differ only if the detector needs a census of the scene, since the truth of the later steps
    is not there.

    Attributes:
        folder: The run directory.
        settings: The content of `run.json`; of an interrupted run, without counts.
        scene: The scene, read from its copy in the folder.
        finished: Whether the run was finished.
        steps: Number of steps that are there; of an interrupted run, those whose truth was kept.
    """

    folder: Path
    settings: dict[str, Any]
    scene: Scene
    finished: bool
    steps: int

    @property
    def how_to_finish(self) -> str:
        """How a user finishes an interrupted run: the poses of a live one cannot come again, but are kept."""
        if (self.folder / UNFINISHED / POSES_FILE).is_file():
            return f"`modsim3d run {self.scene.path} --out DIR` makes a finished run of the poses that came in"
        return "finish it with `modsim3d run SCENE --resume` first"

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames of steps first to stop − 1, in order of step and camera."""
        stop = self.steps if stop is None else min(stop, self.steps)
        for start, end in self._ranges():
            wanted = range(max(start, first), min(end, stop))
            if wanted:
                yield from frames_of(self._block(start, end, wanted), self.scene, wanted)

    def frame(self, camera: str, step: int) -> Frame:
        """The frame that a camera took at a step."""
        return next(frame for frame in self.frames(step, step + 1) if frame.camera == camera)

    def tables(self) -> dict[str, pa.Table]:
        """All rows of `frames`, `truth` and `detections`: much faster than `frames()`, but all in memory."""
        if self.finished:
            return {name: read_rows(self.folder / f"{name}.parquet") for name in TABLES}
        blocks = (self._simulation.detect(truth, *steps) for truth, *steps in self._kept_blocks())
        parts = [{name: table(block, self.scene) for name, (_, table) in TABLES.items()} for block in blocks]
        return {name: pa.concat_tables([part[name] for part in parts]) for name in TABLES}

    def truth(self, first: int, stop: int) -> Truth:
        """The truth of steps first to stop − 1 of a finished run."""
        return read_truth(self.folder, self.scene, first, stop)

    def _block(self, first: int, stop: int, wanted: range) -> Block:
        """The truth and detections of the wanted steps at least, of a block of steps first to stop − 1."""
        if not self.finished:
            return self._simulation.detect(self._kept(first, stop), first, stop)
        first, stop = wanted.start, wanted.stop
        read = partial(read_detections, self.folder, self.scene.detector)
        return detected_block(self.scene, self.truth(first, stop), first, stop, read)

    @cached_property
    def _simulation(self) -> Simulation:
        """The detector of an interrupted run, with a census of the steps that were kept."""
        try:
            return Simulation(self.scene, scene_census(self.scene, self._kept_blocks()))
        except ModsimError as error:  # no vessel is annotated in these steps, and the detector needs one
            raise RunDirectoryError(f"{self.folder} holds an interrupted run: {error}; {self.how_to_finish}") from None

    def _kept_blocks(self) -> Iterator[tuple[Truth, int, int]]:
        return ((self._kept(*steps), *steps) for steps in self._ranges())

    def _ranges(self) -> list[Range]:
        """The blocks that are there."""
        return [steps for steps in block_ranges(self.scene.steps, block_steps(self.scene)) if steps[0] < self.steps]

    def _kept(self, first: int, stop: int) -> Truth:
        truth = finished_truth(self.folder / UNFINISHED, first, stop)
        if truth is None:
            raise RunDirectoryError(f"{self.folder} has lost the truth of steps {first} to {stop - 1}")
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
    """Number of steps, from the first on, whose truth an interrupted run has kept."""
    kept = 0
    for start, end in block_ranges(scene.steps, block_steps(scene)):
        if finished_truth(folder / UNFINISHED, start, end) is None:
            break
        kept = end
    return kept
