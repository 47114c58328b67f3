"""One run into a run directory."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from modsim3d.box_sample import BoxSample
from modsim3d.counts import Counts
from modsim3d.detector.reference import Reference
from modsim3d.errors import InputError, ModsimError
from modsim3d.formats.pose_lines import pose_lines
from modsim3d.formats.run_directory import LOG_FILE, RunDirectory
from modsim3d.scene import Scene
from modsim3d.simulate import step_ranges
from modsim3d.workers import Range, Workers, open_workers

FORMAT = 1
VERSIONED = ("modsim3d", "numpy", "scipy", "shapely", "pyarrow", "orjson")


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        folder: The run directory.
        counts: What happened.
        steps: Number of time steps.
        seconds: Wall-clock time.
        resumed_steps: Steps whose truth was taken from an interrupted run.
        intersecting: Pairs of vessels whose boxes overlap in space, of which the analytic source knows nothing.
        reference: What the detector had to know of the whole scene; None if nothing.
        truncation: What drawing degenerate boxes anew does to the box errors, by state; as in `run.json`.
    """

    folder: Path
    counts: Counts
    steps: int
    seconds: float
    resumed_steps: int
    intersecting: tuple[tuple[str, str], ...]
    reference: Reference | None
    truncation: dict[str, dict[str, Any]]


def run_scene(
    scene: Scene,
    folder: Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    workers: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Run a scene and write its run directory.

    Args:
        scene: From `load_scene`.
        folder: The run directory.
        overwrite: Replace a run that is there.
        resume: Continue an interrupted run that is there.
        workers: Processes that make blocks; the files are the same bytes whatever their number.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The scene asks for what cannot be, or the folder cannot be used.
    """
    if scene.live and workers > 1:
        raise ModsimError(
            f"scene {scene.path}: a stream's steps come one by one, so there is nothing to share between {workers} "
            "workers: leave --workers out"
        )
    with open_workers(scene, workers) as made:
        return write_run(
            scene, folder, made, settings_of(scene, made.backend), overwrite=overwrite, resume=resume, progress=progress
        )


def write_run(
    scene: Scene,
    folder: Path,
    made: Workers,
    settings: dict[str, Any],
    *,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Write the run directory of a scene from the blocks that workers make.

    Args:
        scene: The scene.
        folder: The run directory.
        made: Who makes the blocks.
        settings: Everything that decides the content of the files, see `settings_of`.
        overwrite: Replace a run that is there.
        resume: Continue an interrupted run that is there.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The scene asks for what cannot be, or the folder cannot be used.
    """
    started = time.perf_counter()
    if scene.live:
        _refuse_for_live(scene, resume)
    counts, boxes, steps, resumed, pairs = Counts(), BoxSample(), 0, 0, set[tuple[int, int]]()
    with RunDirectory(folder, scene, settings, overwrite=overwrite, resume=resume) as directory:
        reference = None
        if scene.detector.needs_reference:
            reference, resumed = _survey(made, directory.work, step_ranges(scene), progress)
        ranges = _told_what_is_kept(step_ranges(scene), scene, directory.work)
        for block in made.blocks(directory.work, ranges, reference):
            directory.write(block.files)
            if scene.live:
                directory.write_poses(pose_lines(scene, steps, steps + block.steps))
            counts += block.counts
            boxes += block.boxes
            steps += block.steps
            pairs |= block.intersecting
            if reference is None:
                resumed += block.steps if block.resumed else 0
                progress(block.steps)
        directory.write_live_own_ships(steps)
        truncation = boxes.truncation(scene)
        known = {**settings, **directory.live_settings(steps)}
        directory.finish({**known, "counts": asdict(counts), "truncation": truncation})
    seconds = time.perf_counter() - started
    (folder / LOG_FILE).write_text(
        f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')} on {platform.node()}\n"
        f"{counts.frames} frames in {seconds:.3f} s, {resumed} steps taken from an interrupted run\n"
    )
    names = scene.occluder_names
    intersecting = tuple((names[a], names[b]) for a, b in sorted(pairs))
    return RunResult(folder, counts, steps, seconds, resumed, intersecting, reference, truncation)


def _refuse_for_live(scene: Scene, resume: bool) -> None:
    if resume:
        raise ModsimError(
            f"scene {scene.path}: --resume needs poses that can be read again, and a stream's come once. What an "
            "interrupted run took in is in unfinished/poses.jsonl of its folder: run a scene with poses: {file: ...}"
        )


def _told_what_is_kept(ranges: Iterator[Range], scene: Scene, work: Path) -> Iterator[Range]:
    """The ranges; an error in what a stream brings also says where the steps before it are."""
    done = 0
    try:
        for first, stop in ranges:
            yield first, stop
            done = stop
    except InputError as error:
        if not scene.live or not done:
            raise
        kept = f"what came before, {done} steps, is kept as complete lines in {work}"
        raise InputError(error.source, [*error.problems, kept]) from None


def _survey(
    made: Workers, folder: Path, ranges: Iterable[Range], progress: Callable[[int], None]
) -> tuple[Reference, int]:
    """Make and keep all truth first; what the detector must know of it, and steps of an interrupted run."""
    reference, resumed = Reference(), 0
    for block in made.surveys(folder, ranges):
        reference += block.reference
        resumed += block.steps if block.resumed else 0
        progress(block.steps)
    return reference, resumed


def settings_of(scene: Scene, backend: str) -> dict[str, Any]:
    """Everything that decides the content of the files; no times and no host names."""
    return {
        "format": FORMAT,
        "scene": scene.name,
        "scene_sha256": scene.sha256,
        "seed": scene.seed,
        "detector_seed": scene.detector_seed,
        "steps": scene.steps,
        "annotation": asdict(scene.annotation),
        "cameras": [camera.name for camera in scene.cameras],
        "backend": backend,
        "plugins": {f"{plugin.group}:{plugin.name}": plugin.package for plugin in scene.plugins},
        "versions": {name: version(name) for name in VERSIONED},
    }
