"""Does a run obey its detector file?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import CONFUSION, MARKOV_CHAIN, Part, used_models
from modsim3d.runs.files.reading import detections_of, truth_of
from modsim3d.runs.pipeline import detector_inputs
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.reading import load_scene
from modsim3d.verify.box_error_checks import box_error_checks
from modsim3d.verify.class_checks import EFFECT_CHECKS, class_checks
from modsim3d.verify.clutter_checks import RATE_CHECKS, clutter_checks
from modsim3d.verify.confidence_checks import SCORE_CHECKS, confidence_checks
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.error_likelihoods import LIKELIHOODS
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.parameters import Parameter, Verification, judge
from modsim3d.verify.state_checks import state_checks

CHECKED: Mapping[Part, Collection[str]] = {
    Part.STATE: {MARKOV_CHAIN},
    Part.CLASS: {CONFUSION} | EFFECT_CHECKS.keys(),
    Part.BOX_ERROR: LIKELIHOODS.keys(),
    Part.FALSE_POSITIVES: RATE_CHECKS.keys(),
    Part.CONFIDENCE: SCORE_CHECKS.keys(),
}
"""The models of each part that have checks, by the names in `detector.parts.MODELS`."""


def verify(model: DetectorModel, evidence: Evidence, table: MomentTable | None = None) -> Verification:
    """Hold what a run shows against a detector's parameters.

    The table keeps expectations of box errors: give it to further calls over the same truth to save most of their work.
    """
    box_errors = partial(box_error_checks, table=table or MomentTable())
    # In the order in which the detector works.
    parts = (state_checks, class_checks, box_errors, clutter_checks, confidence_checks)
    parameters = [parameter for checks in parts for parameter in checks(model, evidence)]
    return judge([*parameters, *unchecked(model)])


def unchecked(model: DetectorModel) -> list[Parameter]:
    """A row for each model that the detector uses and no check knows."""
    return [
        Parameter(used.key, used.part, None, state=used.state, note=f"no check for model '{used.name}'", checked=False)
        for used in used_models(model)
        if used.name not in CHECKED[used.part]
    ]


@dataclass(frozen=True, eq=False)
class VerifiedRun:
    """A run, the detector file that it was held against (None for its own), what it shows, and the verdicts on it."""

    run: StoredRun
    detector: Path | None
    model: DetectorModel
    evidence: Evidence
    verification: Verification


def verify_run(run: StoredRun, detector: Path | None = None) -> VerifiedRun:
    """Hold a finished run against a detector file, the run's own copy if None.

    Raises:
        ModsimError: The run was interrupted, or this detector cannot have made it.
    """
    tables = run.finished_tables.rows(0, run.steps)
    scene = run.scene if detector is None else load_scene(run.scene.path, detector=detector)
    model = scene.detector
    evidence = Evidence.of(
        [
            CameraEvidence(part.frames, part.targets, detections_of(tables, model, part.frames, part.targets))
            for part in detector_inputs(scene, truth_of(tables["truth"], scene), 0, run.steps)
        ]
    )
    return VerifiedRun(run, detector, model, evidence, verify(model, evidence))
