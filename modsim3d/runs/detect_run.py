"""Runs the detector again over the truth of a finished run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from modsim3d.errors import InputError, RunDirectoryError
from modsim3d.paths import StrPath, as_path
from modsim3d.processes import WorkerCount
from modsim3d.runs.pipeline import BLOCK_VESSELS
from modsim3d.runs.run import RunResult, settings_of, write_run
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.runs.workers import open_block_workers
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene


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
    """A run's scene with another detector or another seed of it.

    The seed of the scene changes too, unless the truth depends on it.

    Raises:
        InputError: The detector is wrong or does not know the label of a vessel, or a setting is not of the detector.
    """
    for key in settings:
        if key.partition(".")[0] not in ("detector", "detector_seed"):
            raise InputError(f"--set {key}", ["a finished run keeps its truth: set keys of the detector only"])
    scene_seed = None if run.scene.truth_has_seed else seed
    return load_scene(run.scene.path, seed=scene_seed, detector_seed=seed, settings=settings, **detector)
