"""A finished run held against its detector file, or against another one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from modsim3d.detector.model import DetectorModel
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.reading import read_detections
from modsim3d.runs.pipeline import detector_inputs
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.reading import load_scene
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.parameters import Verification
from modsim3d.verify.verification import verify


@dataclass(frozen=True, eq=False)
class VerifiedRun:
    """A run, what it shows, and the verdicts on it.

    Attributes:
        run: The run.
        detector: The file that it was held against, None for its own.
        model: What that file says.
        evidence: What the run shows.
        verification: The verdicts.
    """

    run: StoredRun
    detector: Path | None
    model: DetectorModel
    evidence: Evidence
    verification: Verification


def verify_run(run: StoredRun, detector: Path | None = None) -> VerifiedRun:
    """Hold a finished run against a detector file.

    Args:
        run: The run.
        detector: The file; the run's own copy if None.

    Raises:
        ModsimError: The run was interrupted, or this detector cannot have made it.
    """
    if not run.finished:
        raise RunDirectoryError(f"{run.folder} holds an interrupted run: {run.how_to_finish}")
    scene = run.scene if detector is None else load_scene(run.scene.path, detector=detector)
    model = scene.detector
    seen = [
        CameraEvidence(part.frames, part.targets, read_detections(run.folder, model, part.frames, part.targets))
        for part in detector_inputs(scene, run.truth(0, run.steps), 0, run.steps)
    ]
    evidence = Evidence.of(seen)
    return VerifiedRun(run, detector, model, evidence, verify(model, evidence))
