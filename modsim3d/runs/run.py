"""Runs a scene and writes its run directory: workers make the blocks, the directory takes them in order."""

import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from modsim3d.core.boxes import Overlaps
from modsim3d.core.document import Result
from modsim3d.core.errors import InputError, ModsimError, RunDirectoryError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.io.processes import WorkerCount, worker_count
from modsim3d.runs.counts import Counts
from modsim3d.runs.files.run_directory import RunDirectory, locked_run
from modsim3d.runs.files.stored_tables import damage_named
from modsim3d.runs.pipeline import BLOCK_VESSELS, Range, check_scene, step_ranges
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.runs.workers import BlockMaker, BlockTally, BlockWorkers, backend_of, open_block_workers
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.truth.crosscheck.comparison import CheckCounts
from modsim3d.world.poses.labelled import LABELS

FORMAT = 2  # format 1 had no counts for each camera, and only the centre form of the detections' boxes
VERSIONED = ("modsim3d", "numpy", "scipy", "shapely", "pyarrow", "orjson")
Progress = Callable[[int], None]


@dataclass(frozen=True, repr=False)
class RunResult(Result):
    """A finished run, from `run_scene` or `detect_run`; `modsim3d.open_run(result.folder)` reads what it has written.

    Attributes:
        folder: The run directory.
        steps: Number of steps.
        camera_counts: What happened in the frames of each camera, by its name.
        seconds: Wall-clock time.
        resumed_steps: Number of steps whose truth was taken from an interrupted run.
        damaged_blocks: Number of blocks whose truth an interrupted run had kept in a damaged file; it was made anew.
        intersecting: Pairs of vessels or obstacles whose hulls intersect: the analytic source cannot tell what is
            visible of them.
        truncation: How resampling shifts the box errors, by state, as in `run.json`.
        checked: What the cross-check of the truth found; None if the truth is that of a run before there was one.
    """

    folder: Path
    camera_counts: dict[str, Counts]
    steps: int
    seconds: float
    resumed_steps: int
    damaged_blocks: int
    intersecting: tuple[tuple[str, str], ...]
    truncation: dict[str, dict[str, Any]]
    checked: CheckCounts | None = None

    @property
    def iou(self) -> Overlaps:
        """IoU of the true detections with the annotated boxes of their vessels, from `detections.parquet`."""
        with damage_named(path := self.folder / "detections.parquet"):
            column = pq.read_table(path, columns=["iou"])["iou"]
        return Overlaps.of(column.drop_null().to_numpy())

    def _rows(self) -> dict[str, str]:
        counts = self.counts
        return {
            "steps": f"{self.steps:,}",
            "frames": f"{counts.frames:,}",
            "annotated vessels": f"{counts.annotated:,}",
            "detected": f"{counts.detected:,}",
            "false positives": f"{counts.false_positives:,}",
            "time": f"{self.seconds:.1f} s",
        }

    @property
    def counts(self) -> Counts:
        """Counts over the frames of all cameras."""
        return Counts.total(self.camera_counts)


def run_scene(
    scene: Scene,
    folder: StrPath,
    *,
    overwrite: bool = False,
    resume: bool = False,
    thesis_json: bool = True,
    workers: WorkerCount = 1,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Run a scene and write its run directory.

        result = modsim3d.run_scene(modsim3d.load_scene("strait"), "runs/first")
        result.counts.detected

    Args:
        scene: From `load_scene`.
        folder: The run directory; folders that are missing are made.
        overwrite: Replace a run that is there.
        resume: Continue an interrupted run that is there.
        thesis_json: Write the thesis's JSON, `annotations_<camera>.json` and `detections_<camera>.json`. Everything in
            it is in the tables too, and nothing that reads a run needs it.
        workers: Number of processes, or `auto` for one for each CPU; the bytes of the files do not depend on it.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The scene asks for what cannot be, or the folder cannot be used.
        TypeError: The scene is none, or the folder is neither text nor a path.
    """
    check_scene(scene)
    count = 1 if scene.live and workers == "auto" else worker_count(workers)
    if scene.live and count > 1:
        raise ModsimError(
            f"{scene.title}: a stream's steps come one by one, so there is nothing to share between {count} "
            "workers: leave --workers out"
        )
    return write_run(
        scene,
        as_path(folder, "folder"),
        open_block_workers(scene, count),
        lambda opened: settings_of(scene, backend_of(opened)),
        overwrite=overwrite,
        resume=resume,
        thesis_json=thesis_json,
        progress=progress,
    )


def write_run(
    scene: Scene,
    folder: Path,
    opened_workers: AbstractContextManager[BlockWorkers],
    settings_by: Callable[[BlockWorkers], dict[str, Any]],
    *,
    most_steps: int | None = None,
    truth_run: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    thesis_json: bool = True,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Write the run directory of a scene from the blocks that workers make; see `run_scene`. The folder is locked until
    the workers have ended. `settings_by` gives the settings, see `settings_of`; `most_steps` is that of `step_ranges`;
    `truth_run` is the content of `run.json` of the run whose truth is taken. Raises ModsimError if the scene cannot be
    run or the folder cannot be used."""
    started = time.perf_counter()
    if scene.live and resume:
        raise ModsimError(
            f"{scene.title}: --resume needs poses that can be read again, and a stream's come once. What an "
            "interrupted run took in is in unfinished/poses.jsonl of its folder: run a scene with poses: {file: ...}"
        )
    with locked_run(folder), opened_workers as workers:
        settings = settings_by(workers)
        directory = RunDirectory(folder, scene, settings, overwrite=overwrite, resume=resume, thesis_json=thesis_json)
        with directory:
            total = _write_blocks(scene, directory, workers, most_steps, progress)
            directory.write_live_own_ships(total.steps)
            with directory.completing():
                truncation = total.boxes.truncation(scene)
            entries = {**settings, **directory.live_settings(total.steps)}
            seconds = time.perf_counter() - started
            checked = {"crosscheck": asdict(total.checked)}
            if truth_run is not None:
                checked = {key: truth_run[key] for key in checked if key in truth_run}
            counts = {
                "counts": asdict(Counts.total(total.camera_counts)),
                "camera_counts": {name: asdict(numbers) for name, numbers in total.camera_counts.items()},
            }
            directory.finish({**entries, **counts, "truncation": truncation, **checked}, _log(total, seconds))
    names = scene.occluder_names
    intersecting = tuple((names[one], names[other]) for one, other in sorted(total.intersecting))
    return RunResult(
        folder,
        total.camera_counts,
        total.steps,
        seconds,
        total.resumed_steps,
        total.damaged_blocks,
        intersecting,
        truncation,
        CheckCounts(**checked["crosscheck"]) if checked else None,
    )


def _log(total: BlockTally, seconds: float) -> str:
    """Text of `run.log`; times and the host are named nowhere else."""
    frames = sum(counts.frames for counts in total.camera_counts.values())
    damaged = f"{total.damaged_blocks} damaged blocks of it made anew\n" if total.damaged_blocks else ""
    return (
        f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')} on {platform.node()}\n"
        f"{frames} frames in {seconds:.3f} s, {total.resumed_steps} steps taken from an interrupted run\n"
        f"{damaged}"
    )


def _write_blocks(
    scene: Scene, directory: RunDirectory, workers: BlockWorkers, most_steps: int | None, progress: Progress
) -> BlockTally:
    """Make all blocks and write them; one that needs target statistics needs all truth first."""
    counted, statistics = BlockTally(), TargetStatistics()
    if scene.detector.needs_target_statistics:
        count = partial(BlockMaker.count_targets, folder=directory.work)
        for tally, part in workers.map(count, step_ranges(scene, most_steps)):
            counted, statistics = counted + tally, statistics + part
            progress(tally.steps)
    total = BlockTally()
    make = partial(BlockMaker.make, folder=directory.work, statistics=statistics, kinds=directory.line_kinds)
    for tally, files in workers.map(make, _with_steps_kept(scene, directory.work, most_steps)):
        directory.write(files)
        directory.write_poses(total.steps, total.steps + tally.steps)
        total += tally
        if not counted.steps:
            progress(tally.steps)
    # After target statistics all truth is from what they kept, and only they know what was kept before.
    if not counted.steps:
        return total
    kept = {name: getattr(counted, name) for name in ("resumed_steps", "damaged_blocks", "checked")}
    return replace(total, **kept)


def _with_steps_kept(scene: Scene, folder: Path, most_steps: int | None) -> Iterator[Range]:
    """The blocks of a scene; an error in the input of a stream also says where the earlier steps are kept."""
    done = 0
    try:
        for first, stop in step_ranges(scene, most_steps):
            yield first, stop
            done = stop
    except InputError as error:
        if not scene.live or not done:
            raise
        kept = f"the {done} steps before are kept as complete lines in {folder}"
        raise InputError(error.source, [*error.problems, kept]) from None


def settings_of(scene: Scene, backend: str) -> dict[str, Any]:
    """Everything that decides the content of the files; no times and no host names."""
    traffic = {"traffic_seed": scene.traffic_seed, "traffic_sha256": scene.traffic_sha256()}  # where the seed draws it
    return {
        "format": FORMAT,
        "scene": scene.name,
        "scene_sha256": scene.sha256,
        "seed": scene.seed,
        "detector_seed": scene.detector_seed,
        **{key: value for key, value in traffic.items() if value is not None},
        "steps": scene.steps,
        "annotation": asdict(scene.annotation),
        "cameras": [camera.name for camera in scene.cameras],
        "backend": backend,
        "plugins": {plugin.key: plugin.package for plugin in scene.plugins},
        **({"plugins_sha256": {plugin.key: plugin.sha256 for plugin in scene.plugins}} if scene.plugins else {}),
        "versions": dict(_versions()),
    }


@cache
def _versions() -> dict[str, str]:
    return {name: str(import_module(name).__version__) for name in VERSIONED}


def detect_run(
    run: StoredRun | StrPath,
    folder: StrPath,
    *,
    detector: StrPath | None = None,
    seed: int | None = None,
    settings: Mapping[str, object] | None = None,
    state: str | None = None,
    state_from: StrPath | None = None,
    overwrite: bool = False,
    workers: WorkerCount = 1,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Run a detector alone: write the run directory that another detector or seed would have given, without rendering.

        modsim3d.detect_run("runs/first", "runs/second", detector="my/detector.yaml", seed=7)

    Args:
        run: A finished run, or its directory.
        folder: The new run directory.
        detector: A detector file or the name of a shipped detector, in place of the run's.
        seed: Seed of the detector, in place of the run's.
        settings: Keys below `detector`, as those of `load_scene`.
        state: As that of `load_scene`.
        state_from: As that of `load_scene`.
        overwrite: Replace a run that is there.
        workers: Number of processes, or `auto` for one for each CPU; the bytes of the files do not depend on it.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The run was interrupted, the detector does not suit it, or the folder cannot be used.
        TypeError: The run, the folder or the detector is neither text nor a path.
    """
    run, folder = opened_run(run), as_path(folder, "folder")
    run.finished_tables.check_checksums()
    if Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(run.folder)):
        raise RunDirectoryError(f"{folder} is, or is in, the run that the truth is read from: choose another folder")
    scene = _with_detector(run, seed, detector=detector, settings=settings or {}, state=state, state_from=state_from)
    facts = settings_of(scene, run.settings["backend"])
    if facts["versions"] != run.settings["versions"]:
        facts["truth_versions"] = run.settings["versions"]
    block_workers = open_block_workers(scene, workers, truth_run=run.folder)
    return write_run(
        scene,
        folder,
        block_workers,
        lambda _: facts,
        overwrite=overwrite,
        truth_run=run.settings,
        most_steps=max(1, BLOCK_VESSELS // len(scene.vessels)),  # no images, so that only the rows count
        progress=progress,
    )


def _with_detector(run: StoredRun, seed: int | None, *, settings: Mapping[str, object], **detector: Any) -> Scene:
    """A run's scene with another detector or another seed of it; the seed of the scene changes too, unless the truth
    depends on it. Raises InputError if the detector is wrong or does not know a vessel's label, or a setting."""
    for key in settings:
        if key.partition(".")[0] not in ("detector", "detector_seed"):
            raise InputError(f"--set {key}", ["a finished run keeps its truth: set keys of the detector only"])
    scene_seed = None if run.scene.truth_has_seed else seed
    if run.scene.labels is not None and run.scene.labels.detections is not None:
        if not (detector.get("detector") or detector.get("state_from")):
            reason = "has the detections of a real detector, which no seed and no setting changes"
            raise ModsimError(f"{run.folder}: {reason}: give a detector, which works on the labels in its place")
        poses = run.scene.copy.document["poses"][LABELS]
        settings = {**settings, f"poses.{LABELS}": {**(poses if isinstance(poses, dict) else {"file": poses}),
                                                    "simulated": True}}  # fmt: skip
    return load_scene(run.scene.path, seed=scene_seed, detector_seed=seed, settings=settings, **detector)
