"""One run into a run directory."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from modsim3d.box_sample import BoxSample
from modsim3d.counts import Counts
from modsim3d.detector.reference import Reference
from modsim3d.formats.run_directory import LOG_FILE, RunDirectory
from modsim3d.scene import Scene
from modsim3d.simulate import block_ranges, block_steps
from modsim3d.workers import Range, Workers, open_workers

FORMAT = 1
VERSIONED = ("modsim3d", "numpy", "scipy", "shapely", "pyarrow", "orjson")


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        folder: The run directory.
        counts: What happened.
        seconds: Wall-clock time.
        resumed_steps: Steps whose truth was taken from an interrupted run.
        intersecting: Pairs of vessels whose boxes overlap in space, of which the analytic source knows nothing.
        reference: What the detector had to know of the whole scene; None if nothing.
        truncation: What drawing degenerate boxes anew does to the box errors, by state; as in `run.json`.
    """

    folder: Path
    counts: Counts
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
    counts, boxes, resumed, pairs = Counts(), BoxSample(), 0, set[tuple[int, int]]()
    with RunDirectory(folder, scene, settings, overwrite=overwrite, resume=resume) as directory:
        ranges = block_ranges(scene.steps, block_steps(scene))
        reference = None
        if scene.detector.needs_reference:
            reference, resumed = _survey(made, directory.work, ranges, progress)
        for block in made.blocks(directory.work, ranges, reference):
            directory.write(block.files)
            counts += block.counts
            boxes += block.boxes
            pairs |= block.intersecting
            if reference is None:
                resumed += block.steps if block.resumed else 0
                progress(block.steps)
        truncation = boxes.truncation(scene)
        directory.finish({**settings, "counts": asdict(counts), "truncation": truncation})
    seconds = time.perf_counter() - started
    (folder / LOG_FILE).write_text(
        f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')} on {platform.node()}\n"
        f"{counts.frames} frames in {seconds:.3f} s, {resumed} steps taken from an interrupted run\n"
    )
    names = scene.vessel_names
    intersecting = tuple((names[a], names[b]) for a, b in sorted(pairs))
    return RunResult(folder, counts, seconds, resumed, intersecting, reference, truncation)


def _survey(
    made: Workers, folder: Path, ranges: Sequence[Range], progress: Callable[[int], None]
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
        "versions": {name: version(name) for name in VERSIONED},
    }
