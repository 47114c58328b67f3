"""A run held against its detector file: what `modsim3d.verify_run` returns, and writes."""

from __future__ import annotations

from pathlib import Path

from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import column_table
from modsim3d.detector.file.reading import find_detector
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.files.stored_tables import detections_of, truth_of
from modsim3d.runs.pipeline import detector_inputs
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.scene.reading import load_scene
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.report import FILES, HEADER, conclusion, row_of, write_report
from modsim3d.verify.verification import CheckedRun, verify_evidence


class VerifiedRun(CheckedRun):
    """Verification of a run against a detector file, from `verify_run`.

    verified = modsim3d.verify_run("runs/first")
    verified.obeys, verified.failed, verified.write("checked")
    """

    def __repr__(self) -> str:
        """The outcome in a sentence."""
        return f"<VerifiedRun {self.run.folder}: {conclusion(self.verification)}>"

    def _repr_html_(self) -> str:
        """The outcome, and a table of what was tested, with what fails first."""
        tested = [verdict for verdict in self.verdicts if verdict.measured is not None and not verdict.fails]
        return column_table(conclusion(self.verification), HEADER, map(row_of, (*self.failed, *tested)))

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
    return VerifiedRun(run, path, model, evidence, verify_evidence(model, evidence))
