"""Does a run obey its detector file?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from modsim3d.detector.file.finding import find_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import CONFUSION, MARKOV_CHAIN, Part, used_models
from modsim3d.display import column_table
from modsim3d.outputs.claims import claimed
from modsim3d.paths import StrPath, as_path
from modsim3d.runs.files.reading import detections_of, truth_of
from modsim3d.runs.files.replacing import read_of_run
from modsim3d.runs.pipeline import detector_inputs
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.scene.reading import load_scene
from modsim3d.verify.box_error_checks import fit_checks, state_fits
from modsim3d.verify.class_checks import EFFECT_CHECKS, class_checks
from modsim3d.verify.clutter_checks import RATE_CHECKS, clutter_checks
from modsim3d.verify.confidence_checks import SCORE_CHECKS, confidence_checks
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.error_likelihoods import LIKELIHOODS
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.independence_checks import independence_checks
from modsim3d.verify.parameters import Parameter, Verdict, Verification, judge
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
    fits = state_fits(model, evidence, table or MomentTable())
    # In the order in which the detector works.
    parameters = [
        *state_checks(model, evidence),
        *class_checks(model, evidence),
        *fit_checks(model, evidence, fits),
        *clutter_checks(model, evidence),
        *confidence_checks(model, evidence),
        *independence_checks(model, evidence, [fit for fit in fits.values() if fit is not None]),
    ]
    return judge([*parameters, *unchecked(model)])


def unchecked(model: DetectorModel) -> list[Parameter]:
    """A row for each model that the detector uses and no check knows."""
    return [
        Parameter(used.key, used.part, None, state=used.state, note=f"no check for model '{used.name}'", checked=False)
        for used in used_models(model)
        if used.name not in CHECKED[used.part]
    ]


@dataclass(frozen=True, eq=False, repr=False)
class VerifiedRun:
    """What a run shows against a detector file, from `verify_run`.

        verified = modsim3d.verify_run("runs/first")
        verified.obeys, verified.failed, verified.write("checked")

    Attributes:
        run: The run.
        detector: The detector file that it was held against; None for its own.
        model: What that file says.
        evidence: What the run shows.
        verification: The verdicts, and the level of each test.
    """

    run: StoredRun
    detector: Path | None
    model: DetectorModel
    evidence: Evidence
    verification: Verification

    def __repr__(self) -> str:
        """The outcome in a sentence."""
        from modsim3d.verify.report import conclusion  # the report knows this module

        return f"<VerifiedRun {self.run.folder}: {conclusion(self.verification)}>"

    def _repr_html_(self) -> str:
        """The outcome, and a table of what was tested, with what fails first."""
        from modsim3d.verify.report import HEADER, conclusion, row_of

        tested = [verdict for verdict in self.verdicts if verdict.measured is not None and not verdict.fails]
        return column_table(conclusion(self.verification), HEADER, map(row_of, (*self.failed, *tested)))

    @property
    def obeys(self) -> bool:
        """Whether nothing speaks against the run."""
        return self.verification.obeys

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """A verdict on each parameter of the detector file, in the order in which the detector works."""
        return self.verification.verdicts

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts against the run."""
        return self.verification.failed

    def write(self, folder: StrPath | None = None, *, overwrite: bool = False) -> tuple[Path, ...]:
        """Write `verify.json` and `verify.html`.

        Args:
            folder: Where to; the run directory if None.
            overwrite: Replace those that are there.

        Returns:
            The paths of both.

        Raises:
            OutputError: A file exists, or cannot be written.
            TypeError: The folder is neither text nor a path.
        """
        from modsim3d.verify.report import FILES, write_report

        target = self.run.folder if folder is None else as_path(folder, "folder")
        paths = tuple(target / name for name in FILES)
        read = [*read_of_run(self.run.folder), *([self.detector] if self.detector else [])]
        with claimed(paths, overwrite=overwrite, inputs=read):
            write_report(self, target)
        return paths


def verify_run(run: StoredRun | StrPath, detector: StrPath | None = None) -> VerifiedRun:
    """Check that a finished run obeys a detector file: every parameter as given and as measured, with a verdict.

        verified = modsim3d.verify_run("runs/first")
        verified.obeys, len(verified.verdicts)

    Args:
        run: A finished run, or its directory.
        detector: A detector file or the name of a shipped detector; the run's own if None.

    Raises:
        ModsimError: The run was interrupted, or this detector cannot have made it.
        TypeError: The run or the detector is neither text nor a path.
    """
    run = opened_run(run)
    path = None if detector is None else find_detector(detector)
    tables = run.finished_tables.rows(0, run.steps)
    scene = run.scene if path is None else load_scene(run.scene.path, detector=path)
    model = scene.detector
    evidence = Evidence.of(
        [
            CameraEvidence(part.frames, part.targets, detections_of(tables, model, part.frames, part.targets))
            for part in detector_inputs(scene, truth_of(tables["truth"], scene), 0, run.steps)
        ]
    )
    return VerifiedRun(run, path, model, evidence, verify(model, evidence))
