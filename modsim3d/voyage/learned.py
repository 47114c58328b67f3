"""Learning a detector from a voyage: its log and its scene in, what was learned out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from modsim3d.formats.matching import Rule, usual_method
from modsim3d.inputs.opening import inputs_noted
from modsim3d.learn import learn_detector as labelled_sets
from modsim3d.learn.form import left_out
from modsim3d.learn.learn_detector import LearnOptions
from modsim3d.learn.learned import Settings
from modsim3d.learn.learning import LearnResult
from modsim3d.learn.sources import Sources
from modsim3d.paths import StrPath, as_path
from modsim3d.runs.files.replacing import RUN_FILE, read_of_run
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.voyage.attitude import read_attitude
from modsim3d.voyage.correction import NO_CORRECTION, Correction
from modsim3d.voyage.labelled_voyage import Registrar, VoyageOptions, labelled_voyage
from modsim3d.voyage.left_out import STALE_S
from modsim3d.voyage.logs.log import NO_OPTIONS, LogOptions
from modsim3d.voyage.logs.reading import read_log
from modsim3d.voyage.on_scene import on_scene

Method = Literal["confidence", "optimal", "centre"]


def learn_voyage(
    scene: Scene | StrPath,
    log: StrPath,
    *,
    camera: str | None = None,
    registration: Correction | Registrar = NO_CORRECTION,
    stale_s: float = STALE_S,
    attitude: StrPath | None = None,
    log_options: LogOptions = NO_OPTIONS,
    match: Method | None = None,
    least_iou: float = 0.5,
    most_distance_px: float = 50.0,
    confidence: float | None = None,
    replicates: int = 300,
    seed: int = 0,
    without: Sequence[str] = (),
) -> LearnResult:
    """Learn a detector from what it wrote during a voyage whose vessels' tracks are known.

    Args:
        scene: The scene, its file, or the name of a shipped scene: the vessels, their tracks, and the camera.
        log: What the detector wrote; docs/voyage.md has the formats.
        camera: The scene's camera that the log is of; needed where neither says it.
        registration: What is added to the camera and to the clock, or what finds it for each camera.
        stale_s: Least time without an AIS report of a vessel under way that is left out.
        attitude: File of own ship's roll, pitch and heading, in place of the scene's waves.
        log_options: What the log does not say itself.
        match: As that of `modsim3d.learn_detector`; as are the following.
        least_iou: Least IoU.
        most_distance_px: Largest distance between centres.
        confidence: Least confidence.
        replicates: Number of replicates of the bootstrap.
        seed: Seed of the bootstrap.
        without: Models to leave out.

    Raises:
        ModsimError: The scene or the log cannot be read, they do not fit each other, or nothing can be learned.
    """
    path = as_path(log, "log")
    with inputs_noted() as inputs:
        loaded = scene if isinstance(scene, Scene) else load_scene(scene)
        read = on_scene(read_log(path, log_options), loaded, camera)
        measured = None if attitude is None else read_attitude(as_path(attitude, "attitude"), loaded)
        labelled = labelled_voyage(read, VoyageOptions(registration, stale_s, measured))
    rule = Rule(match or usual_method(labelled), least_iou, most_distance_px)
    least = labelled_sets.least_confidence(labelled, confidence)
    settings = Settings(rule, least, replicates, seed, without=left_out(without, "learn_voyage: without"))
    report = labelled_sets.learn_detector(labelled, settings, LearnOptions())
    files = (*dict.fromkeys([*inputs, *read_besides(loaded, path)]),)
    call = "modsim3d.voyage.learned.learn_voyage(…).write(…) from Python"
    sources = Sources((loaded.path,), (path,), (), files, settings, call)
    return LearnResult(report, files, sources)


def read_besides(scene: Scene, log: Path) -> list[Path]:
    """Files of a scene and of a log that is a run, which are not written over either."""
    return [*scene.copy.read, *(read_of_run(log) if (log / RUN_FILE).is_file() else [])]
