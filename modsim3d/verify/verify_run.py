"""A run held against its detector file: what `modsim3d.verify_run` returns; its verdicts as rows, JSON and a page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import orjson

from modsim3d.core.document import Block, Document, Figure, Fold, Heading, Items, Result, Table, Text, Tiles, Where
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted, in_percent, significant
from modsim3d.detector.file.reading import find_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.io.atomic_write import write_files
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.files.stored_tables import detections_of, truth_of
from modsim3d.runs.pipeline import detector_inputs
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.scene.reading import load_scene
from modsim3d.verify import parameters
from modsim3d.verify.evidence import CameraEvidence, Evidence
from modsim3d.verify.figures import error_scatters, miss_lengths, reliability, timelines
from modsim3d.verify.measures import Exact
from modsim3d.verify.parameters import DIFFERS, FALLS_SHORT, OBEYS, OVERALL_ALPHA, UNCHECKED, UNTESTED, Verification
from modsim3d.verify.verification import verify_evidence
from modsim3d.view.pages.page import document_page
from modsim3d.view.pages.provenance import Provenance, file_input, run_inputs, run_seeds, run_versions

FORMAT = 1
FILES = ("verify.json", "verify.html")
HEADER = ("parameter", "asked", "measured", "interval", "noticed from", "verdict")


def row_of(verdict: parameters.TestResult) -> tuple[str, ...]:
    """A verdict as cells under `HEADER`."""
    parameter = verdict.parameter
    asked, promised = significant(verdict.asked) + (f" {parameter.unit}" if parameter.unit else ""), parameter.promised
    if verdict.measured is None or verdict.interval is None:
        return parameter.name, asked if math.isfinite(verdict.asked) else "–", "–", "–", "–", verdict.verdict
    if isinstance(parameter.measure, Exact):
        wrong = "{} of {} wrong".format(*_counts(parameter.measure))
        return parameter.name, "always" if parameter.asked is None else asked, wrong, "exact", "once", verdict.verdict
    asked = asked if promised is None else f"{significant(promised)}, by rule {asked}"
    interval = " … ".join(map(significant, verdict.interval))
    return parameter.name, asked, significant(verdict.measured), interval, _noticed(verdict), verdict.verdict


def named_notes(verification: Verification) -> list[tuple[str, str]]:
    """The names of parameters, and what a reader should know of each."""
    notes = []
    for verdict in verification.verdicts:
        parameter = verdict.parameter
        if verdict.verdict == FALLS_SHORT and parameter.promised is not None:
            short = (
                f"asked for is {significant(parameter.promised)}; the rule of eq. 7.35 gives "
                f"{significant(verdict.asked)} on this run, {significant(parameter.promised - verdict.asked)} short of "
                f"it; measured {significant(verdict.measured or 0.0)}"
            )
            notes.append((parameter.name, short))
        elif parameter.note and verdict.verdict != FALLS_SHORT:
            notes.append((parameter.name, parameter.note))
    return notes


def conclusion(verification: Verification) -> str:
    """The outcome in a sentence."""
    tested = sum(verdict.verdict not in (UNTESTED, UNCHECKED) for verdict in verification.verdicts)
    cause = verification.cause
    if cause is None:
        short = sum(verdict.verdict == FALLS_SHORT for verdict in verification.verdicts)
        also = f"; {short} obey the thesis's rule and fall short of what is asked for" if short else ""
        return f"The run obeys its detector file: nothing in {tested} tests speaks against it{also}."
    measure = cause.parameter.measure
    finding = f"asked {significant(cause.asked)}, measured {significant(cause.measured or 0.0)}"
    if isinstance(measure, Exact):
        finding = "wrong {} times of {}".format(*_counts(measure))
    return (
        f"The run does NOT obey the detector file: {len(verification.failed)} of {tested} tests fail. What stands out "
        f"is {cause.parameter.name}: {finding}."
    )


def _counts(measure: Exact) -> tuple[str, str]:
    return f"{measure.wrong:,}", f"{measure.count:,.0f}"


def _noticed(verdict: parameters.TestResult) -> str:
    below, above = verdict.noticed
    if below is not None and above is not None and abs(below - above) <= 0.1 * above:
        return f"± {significant(max(below, above))}"
    parts = [f"−{significant(below)}"] if below is not None else []
    parts += [f"+{significant(above)}"] if above is not None else []
    return " ".join(parts) or "–"


def report_data(verified: VerifiedRun) -> dict[str, Any]:
    """Content of `verify.json`."""
    verification = verified.verification
    cause = verification.cause
    return {
        "format": FORMAT,
        "scene": verified.run.scene.name,
        "detector": str(verified.detector) if verified.detector else str(Path("scene") / "detector"),
        "obeys": verification.obeys,
        "cause": cause.parameter.name if cause else None,
        "overall_alpha": OVERALL_ALPHA,
        "alpha": verification.alpha,
        "parameters": [_entry(verdict) for verdict in verification.verdicts],
    }


def _entry(verdict: parameters.TestResult) -> dict[str, Any]:
    parameter, measure = verdict.parameter, verdict.parameter.measure
    return {
        "name": parameter.name,
        "group": parameter.group,
        "state": parameter.state,
        "in_file": parameter.in_file,
        "unit": parameter.unit,
        "asked": _finite(verdict.asked),
        "promised": parameter.promised,
        "measured": _finite(verdict.measured),
        "interval": verdict.interval,
        "p_value": verdict.p_value,
        "strength": _finite(measure.strength()) if measure else None,
        "effective_count": _finite(measure.count) if measure else None,
        "noticed_below": verdict.noticed[0],
        "noticed_above": verdict.noticed[1],
        "verdict": verdict.verdict,
        "note": parameter.note,
    }


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def write_report(verified: VerifiedRun, folder: StrPath, command: str | None = None) -> None:
    """Write `verify.json` and `verify.html` into a folder; the page names the command, or the call if it is None."""
    target = as_path(folder, "folder")
    page = document_page(document(verified), _provenance(verified, command))
    data = orjson.dumps(report_data(verified), option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY) + b"\n"
    write_files(dict(zip((target / name for name in FILES), (data, page), strict=True)))


def document(verified: VerifiedRun) -> Document:
    """The verdicts, to be read."""
    verification, model, evidence = verified.verification, verified.model, verified.evidence
    hits, false = evidence.true_detections, evidence.false_positives
    tested = [verdict for verdict in verification.verdicts if verdict.measured is not None and not verdict.fails]
    about = (
        f"{verified.run.steps:,} steps, {len(evidence.instances.state):,} chances to detect a vessel, "
        f"{len(hits.instance):,} true detections, {len(false.frame_row):,} false ones. Each interval holds the values "
        f"that its test would not have rejected; the level of all tests together is {in_percent(OVERALL_ALPHA)}. "
        "“Noticed from” is the smallest change of the file that this run would have shown, with 90 % power."
    )
    misses_and_confidence = (
        "Left: how many frames in a row a vessel is missed; line: expected. Right: share of true ones among the "
        "detections of each confidence, with 95 % intervals; one that is a probability follows the dashes."
    )
    lead = Text(conclusion(verification), "lead" if verification.obeys else "bad", Where.EVERYWHERE & ~Where.PAGE)
    return Document(
        f"{verified.run.scene.name}: does the run obey its detector file?",
        [replace(lead, text=f"{'✓' if verification.obeys else '✗'} {lead.text}", where=Where.PAGE), lead],
        [
            Text(about, "soft", Where.PAGE),
            Text(f"IoU of the true detections with their vessels: {evidence.iou}."),
            Tiles(_results(verification)),
            Heading("What fails"),
            _table(verification.failed, Where.PAGE | Where.BRIEF),
            _table([*verification.failed, *tested], Where.NOTEBOOK),
            Heading("Performance states"),
            *timelines(model, evidence),
            Heading("Box errors"),
            *error_scatters(verification, model, evidence),
            Heading("Misses and confidence"),
            Figure(lambda: miss_lengths(model, evidence) + reliability(evidence), misses_and_confidence),
            Heading("Every test"),
            *_groups(verification),
            Heading("Notes"),
            *_notes(verification),
        ],
    )


def _notes(verification: Verification) -> Iterator[Block]:
    """The notes, each once with the names that it is about."""
    names: dict[str, list[str]] = {}
    for name, note in named_notes(verification):
        names.setdefault(note, []).append(name)
    yield Items([f"{group[0]}: {note}" for note, group in names.items() if len(group) == 1], Where.PAGE | Where.FULL)
    for note, group in names.items():
        if len(group) > 1:
            yield Fold(
                f"{note[0].upper()}{note[1:]}: {len(group)} entries",
                [Text(", ".join(group))],
                where=Where.PAGE | Where.FULL,
            )


def _provenance(verified: VerifiedRun, command: str | None) -> Provenance:
    run, given = verified.run, verified.detector
    call = f"modsim3d.verify_run({str(run.folder)!r}{'' if given is None else f', {str(given)!r}'}).write(…)"
    level = in_percent(OVERALL_ALPHA)
    named = () if given is None else (file_input("detector file that it is held against", given),)
    return Provenance(
        page="verification: does a run obey its detector file?",
        made_by=command or f"{call} from Python",
        inputs=(*named, *run_inputs(run)),
        seeds=run_seeds(run),
        options=(("Level", f"{level} for all tests together, {verified.verification.alpha:.2g} for each"),),
        made_before=run_versions(run),
    )


def _results(verification: Verification) -> list[tuple[str, str, str]]:
    count = Counter(verdict.verdict for verdict in verification.verdicts)
    unmade = count[UNTESTED] + count[UNCHECKED]
    tested = len(verification.verdicts) - unmade
    tiles = [
        ("Passed", f"{tested - count[DIFFERS]:,}", f"of {tested:,} tests"),
        ("Failed", f"{count[DIFFERS]:,}", "tests in which the run speaks against its file"),
        ("Not tested", f"{unmade:,}", "too little seen, or a model without a check"),
    ]
    if count[FALLS_SHORT]:
        tiles.append(("Fall short", f"{count[FALLS_SHORT]:,}", "obey the thesis's rule, not the rate asked for"))
    return tiles


def _groups(verification: Verification) -> Iterator[Block]:
    """The tests of each part of the detector, folded; those that fail stand at the top of the page too."""
    groups: dict[str, list[parameters.TestResult]] = {}
    for verdict in verification.verdicts:
        groups.setdefault(verdict.parameter.group, []).append(verdict)
    for name, verdicts in groups.items():
        count = Counter(verdict.verdict for verdict in verdicts)
        clauses = [f"{counted(count[OBEYS], 'test')} passed"] if count[OBEYS] else []
        clauses += [f"{count[DIFFERS]:,} failed"] if count[DIFFERS] else []
        clauses += [f"{count[FALLS_SHORT]:,} fall short of the asked rate"] if count[FALLS_SHORT] else []
        clauses += [f"{count[UNTESTED]:,} not tested: too little seen"] if count[UNTESTED] else []
        clauses += [f"{count[UNCHECKED]:,} without a check"] if count[UNCHECKED] else []
        passed = " (all within the interval of their test)" if count[OBEYS] == len(verdicts) else ""
        title = f"{name.capitalize()}: {', '.join(clauses)}{passed}"
        yield Items([title], Where.BRIEF)
        yield Fold(title, [_table(verdicts)], where=Where.PAGE | Where.FULL)


def _table(verdicts: Sequence[parameters.TestResult], where: Where = Where.TEXT) -> Table:
    bad = {index for index, verdict in enumerate(verdicts) if verdict.fails}
    return Table("", HEADER, [row_of(verdict) for verdict in verdicts], bad, where=where)


@dataclass(frozen=True, eq=False, repr=False)
class VerifiedRun(Result):
    """Verification of a run against a detector file, from `verify_run`.

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

    @property
    def obeys(self) -> bool:
        """Whether nothing speaks against the run."""
        return self.verification.obeys

    @property
    def verdicts(self) -> tuple[parameters.TestResult, ...]:
        """A verdict on each parameter of the detector file, in the order in which the detector works."""
        return self.verification.verdicts

    @property
    def failed(self) -> tuple[parameters.TestResult, ...]:
        """The verdicts against the run."""
        return self.verification.failed

    def _document(self) -> Document:
        return document(self)

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
    if run.scene.labels is not None and run.scene.labels.detections is not None:
        raise ModsimError(f"{run.folder}: holds what a real detector found, which obeys no detector file")
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
