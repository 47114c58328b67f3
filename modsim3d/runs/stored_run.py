"""A run directory, opened for reading: its scene, truth, detections and frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from modsim3d.core.document import Result
from modsim3d.core.errors import ModsimError, RunDirectoryError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import listed
from modsim3d.io.validation import nearest
from modsim3d.runs.blocks import Block, frames_of
from modsim3d.runs.files import run_file
from modsim3d.runs.files.block_files import OWN_SHIP, SETTINGS_FILE, TABLES, finished_truth
from modsim3d.runs.files.overwrite import POSES_FILE, RUN_FILE, SCENE_FOLDER, UNFINISHED
from modsim3d.runs.files.stored_tables import StoredTables, detections_of, truth_of
from modsim3d.runs.files.tables import ROW_GROUP_ROWS
from modsim3d.runs.frames import Frame
from modsim3d.runs.pipeline import Range, Simulation, block_ranges, block_steps, detected_block, scene_statistics
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.truth.record import Truth


@dataclass(frozen=True, eq=False, repr=False)
class StoredRun(Result):
    """A finished or an interrupted run, from `open_run`.

        run = modsim3d.open_run("runs/first")
        run.table("truth"), run.scene, next(run.frames()).plot()

    An interrupted run has kept its truth, and its detections are made from that truth again: the same that it would
    have written. They may differ only if the detector needs the statistics of all targets, since the truth of the
    later steps is not there.

    Attributes:
        folder: The run directory.
        settings: The content of `run.json`; of an interrupted run, without counts.
        scene: The scene, read from its copy in the folder.
        steps: Number of steps that are there; of an interrupted run, those whose truth was kept.
        stored: The tables of a finished run; None of an interrupted one.
        made_of: Labels and detections that the run was made of for one command, which its folder does not outlive.
    """

    folder: Path
    settings: dict[str, Any]
    scene: Scene
    steps: int
    stored: StoredTables | None
    made_of: tuple[Path, ...] = ()

    def _rows(self) -> dict[str, str]:
        scene = self.scene
        return {
            "scene": f"{scene.name}",
            "steps": f"{self.steps:,}" + ("" if self.finished else f" of {scene.steps:,}, interrupted"),
            "cameras": listed([camera.name for camera in scene.cameras]),
            "seed": f"{scene.seed}",
            "detector": scene.detector.in_words(),
        }

    @property
    def finished(self) -> bool:
        """Whether the run was finished."""
        return self.stored is not None

    @property
    def finished_tables(self) -> StoredTables:
        """Tables of a finished run. Raises RunDirectoryError if the run was interrupted."""
        if self.stored is None:
            raise RunDirectoryError(f"{self.folder} holds an interrupted run: {self.how_to_finish}")
        return self.stored

    @property
    def how_to_finish(self) -> str:
        """Way for a user to finish an interrupted run: the poses of a live one cannot come again, but are kept."""
        if (self.folder / UNFINISHED / POSES_FILE).is_file():
            return f"`modsim3d run {self.scene.path} --out DIR` makes a finished run of the poses that came in"
        if self.scene.labels is not None:
            return "run `modsim3d detect --truth` again with --overwrite"
        return "finish it with `modsim3d run SCENE --resume` first"

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames of steps first to stop − 1, all from `first` on if stop is None, in order of step and camera.

        Raises:
            RunDirectoryError: A row of a table is not what a run has written.
        """
        stop = self.steps if stop is None else min(stop, self.steps)
        for start, end in self._ranges():
            wanted = range(max(start, first), min(end, stop))
            if wanted:
                yield from frames_of(self._block(start, end, wanted), self.scene, wanted)

    def blocks(self) -> Iterator[Block]:
        """Truth and detections of all steps that are there, in blocks of steps as columns: faster than `frames()`.

        Raises:
            RunDirectoryError: A row of a table is not what a run has written.
        """
        for first, stop in self._ranges():
            yield self._block(first, stop, range(first, stop))

    def frame(self, camera: str, step: int) -> Frame:
        """The frame that a camera took at a step.

        Raises:
            ModsimError: There is no such camera or no such step, or the camera took no frame then.
        """
        cameras = [scene_camera.name for scene_camera in self.scene.cameras]
        if camera not in cameras:
            raise ModsimError(f"{self.folder}: there is no camera '{camera}' ({nearest(camera, cameras)})")
        if not 0 <= step < self.steps:
            raise ModsimError(f"{self.folder}: there is no step {step}; it has steps 0 to {self.steps - 1}")
        for frame in self.frames(step, step + 1):
            if frame.camera == camera:
                return frame
        raise ModsimError(f"{self.folder}: camera '{camera}' took no frame at step {step}")

    def table(self, name: str) -> pa.Table:
        """All rows of one table: `frames`, `truth`, `detections`, or `ownship` where a vessel carries a camera.

        `run.table("truth").to_pandas()` makes a pandas frame of it, `polars.from_arrow(run.table("truth"))` a Polars
        one. The schema has each column's type, and its meaning as far as the table's file has it.

        Raises:
            RunDirectoryError: It is not what a run has written, or the run was interrupted and does not have it.
            ModsimError: There is no such table.
        """
        names = [*TABLES, *([OWN_SHIP] if self.scene.own_ships else [])]
        if name not in names:
            raise ModsimError(f"{self.folder}: there is no table '{name}' ({nearest(name, names)})")
        if name == OWN_SHIP:
            return self.finished_tables.own_ship()
        return self.tables()[name] if self.stored is None else self.stored.rows_of(name)

    def tables(self) -> dict[str, pa.Table]:
        """All rows of `frames`, `truth` and `detections`: much faster than `frames()`, but all in memory.

        Raises:
            RunDirectoryError: They are not what a run has written, or no step is there.
        """
        if self.stored is not None:
            return self.stored.rows(0, self.steps)
        self.check_has_steps()
        parts = [self._tables_of(*steps) for steps in self._ranges()]
        return {name: pa.concat_tables([part[name] for part in parts]) for name in TABLES}

    def tables_of_steps(self, count: int) -> Iterator[tuple[int, dict[str, pa.Table]]]:
        """Rows of `frames`, `truth` and `detections` of `count` steps at a time, each time after their first step.

        All rows are never in memory together.

        Raises:
            RunDirectoryError: They are not what a run has written.
        """
        if self.stored is not None:
            self.stored.check_checksums()
        chunk: dict[str, pa.Table] = {}
        done = 0
        for first, stop in self._chunks(count):
            rows = self._tables_of(first, stop)
            chunk = {name: pa.concat_tables([chunk[name], rows[name]]) for name in TABLES} if chunk else rows
            whole = stop if stop == self.steps else done + (stop - done) // count * count
            while done < whole:
                edge = min(done + count, self.steps)
                places = {name: int(np.searchsorted(table["step"].to_numpy(), edge)) for name, table in chunk.items()}
                yield done, {name: table.slice(0, places[name]) for name, table in chunk.items()}
                chunk = {name: table.slice(places[name]) for name, table in chunk.items()}
                done = edge

    def _chunks(self, count: int) -> Iterator[Range]:
        """Ranges of steps to read at once: blocks of an interrupted run; else about as many rows as a row group has."""
        if self.stored is None:
            yield from self._ranges()
            return
        rows = max(len(table) for table in self.stored.by_name.values())
        steps = max(count, ROW_GROUP_ROWS * self.steps // max(rows, 1))
        yield from block_ranges(self.steps, steps)

    def _tables_of(self, first: int, stop: int) -> dict[str, pa.Table]:
        """The tables of steps first to stop − 1, which are a block if the run was interrupted."""
        if self.stored is not None:
            return self.stored.rows(first, stop)
        block = self._simulation.detect(self._stored_truth(first, stop), first, stop)
        return {name: table(block, self.scene) for name, (_, table) in TABLES.items()}

    def check_has_steps(self) -> None:
        """Raise RunDirectoryError for an interrupted run that has no whole block."""
        if not self.steps:
            raise RunDirectoryError(
                f"{self.folder} holds an interrupted run that has not finished a single block of steps: "
                f"{self.how_to_finish}"
            )

    def _block(self, first: int, stop: int, wanted: range) -> Block:
        """The truth and detections of the wanted steps at least, of a block of steps first to stop − 1."""
        if self.stored is None:
            return self._simulation.detect(self._stored_truth(first, stop), first, stop)
        first, stop = wanted.start, wanted.stop
        tables = self.stored.rows(first, stop)
        read = partial(detections_of, tables, self.scene.detector)
        return detected_block(self.scene, truth_of(tables["truth"], self.scene), first, stop, read)

    @cached_property
    def _simulation(self) -> Simulation:
        """The detector of an interrupted run, with the statistics of the steps that were kept."""
        try:
            blocks = ((self._stored_truth(*steps), *steps) for steps in self._ranges())
            return Simulation(self.scene, scene_statistics(self.scene, blocks))
        except ModsimError as error:  # no vessel is annotated in these steps, and the detector needs one
            raise RunDirectoryError(f"{self.folder} holds an interrupted run: {error}; {self.how_to_finish}") from None

    def _ranges(self) -> list[Range]:
        return [steps for steps in block_ranges(self.scene.steps, block_steps(self.scene)) if steps[0] < self.steps]

    def _stored_truth(self, first: int, stop: int) -> Truth:
        truth = finished_truth(self.folder / UNFINISHED, self.scene, first, stop)
        if truth is None:
            raise RunDirectoryError(f"{self.folder} has lost the truth of steps {first} to {stop - 1}")
        return truth


def opened_run(run: StoredRun | StrPath) -> StoredRun:
    """A run that was opened, or that is opened now from its directory. Raises what `open_run` raises, and TypeError for
    what is neither a run, nor text, nor a path."""
    return run if isinstance(run, StoredRun) else open_run(as_path(run, "run", "a run directory or a StoredRun"))


def open_run(folder: StrPath) -> StoredRun:
    """Open a run directory, and check all of it that can be checked without reading it whole.

        run = modsim3d.open_run("runs/first")
        run.table("detections").to_pandas()

    Checked are `run.json`, the copy of the scene, the size of each file, and columns, types, steps and number of rows
    of each table. Rows are checked as they are read.

    Raises:
        RunDirectoryError: There is no run in it, or it is not what a run has written.
        InputError: The scene in it cannot be read.
        TypeError: The folder is neither text nor a path.
    """
    folder = as_path(folder, "folder", "a run directory")
    if (folder / RUN_FILE).is_file():
        return _finished_run(folder)
    if (folder / UNFINISHED / SETTINGS_FILE).is_file():
        return _interrupted_run(folder)
    if not folder.is_dir():
        file = "is a file, not a run directory, as modsim3d run makes one (labels of a video go with --truth)"
        raise RunDirectoryError(f"{folder} {file if folder.exists() else 'does not exist'}")
    if any((folder / f"{name}.parquet").exists() for name in TABLES):
        raise RunDirectoryError(f"{folder / RUN_FILE} is missing: a finished run has it; copy the whole run directory")
    raise RunDirectoryError(f"{folder} is no run directory: it has no run.json")


def _finished_run(folder: Path) -> StoredRun:
    finished = read_finished(folder)
    run, scene = finished.run, finished.scene
    run_file.check_files(folder, run)
    if run.poses_sha256 is not None:
        run_file.check_content(folder / POSES_FILE, run.poses_sha256, RUN_FILE)
    stored = StoredTables(folder, scene, run.files)
    stored.check_counts(run.counts)
    return StoredRun(folder, finished.settings, scene, scene.steps, stored)


class FinishedRun(NamedTuple):
    """A finished run before its tables are looked at: the content of `run.json`, as it is and validated; its scene."""

    folder: Path
    settings: dict[str, Any]
    run: run_file.RunFile
    scene: Scene


def read_finished(folder: Path) -> FinishedRun:
    """Read a finished run's `run.json` and its scene. Raises RunDirectoryError if there is no finished run, or one of
    these is not what a run has written; InputError if the scene cannot be read."""
    source = folder / RUN_FILE
    if not source.is_file():
        interrupted = (folder / UNFINISHED / SETTINGS_FILE).is_file()
        what = "holds an interrupted run: finish it first" if interrupted else "holds no run: it has no run.json"
        raise RunDirectoryError(f"{folder} {what}")
    content, run = run_file.read_settings(source, run_file.RunFile)
    run_file.check_scene_copy(folder / SCENE_FOLDER, run, source, run.files)
    scene = load_scene(folder / SCENE_FOLDER / f"{run.scene}.json")
    run_file.check_same_scene(run, scene, source)
    run_file.check_camera_counts(run, source)
    return FinishedRun(folder, content, run, scene)


def _interrupted_run(folder: Path) -> StoredRun:
    work = folder / UNFINISHED
    content, settings = run_file.read_settings(work / SETTINGS_FILE, run_file.RunSettings)
    run_file.check_scene_copy(work / SCENE_FOLDER, settings, work / SETTINGS_FILE, None)
    scene = load_scene(work / SCENE_FOLDER / f"{settings.scene}.json")
    if (work / POSES_FILE).is_file():  # the copy of a live scene has the steps that came in
        settings = settings.model_copy(update={"steps": scene.steps})
    run_file.check_same_scene(settings, scene, work / SETTINGS_FILE)
    return StoredRun(folder, content, scene, _kept_steps(folder, scene), None)


def _kept_steps(folder: Path, scene: Scene) -> int:
    kept = 0
    for start, end in block_ranges(scene.steps, block_steps(scene)):
        if finished_truth(folder / UNFINISHED, scene, start, end) is None:
            break
        kept = end
    return kept
