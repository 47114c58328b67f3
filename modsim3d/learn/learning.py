"""Learning from files or from a run, and what comes of it: a detector, its file and a page."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from modsim3d.core.document import Block, Document, Result
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import detector_text, parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import LabelledSet, joined
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.reading.pair import read_pair
from modsim3d.io.atomic_write import write_files
from modsim3d.io.input_files import inputs_noted, read_text
from modsim3d.io.overwrite_guard import claimed
from modsim3d.learn import learn_detector as labelled_sets
from modsim3d.learn.learn_detector import LearnRequest, Method, NumberModel, parse_states
from modsim3d.learn.learned_detector import uncertainty_file, uncertainty_text
from modsim3d.learn.report import LearnReport, lead
from modsim3d.learn.report_page import Sources, document, page_text
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.stored_run import StoredRun, opened_run

Paths = StrPath | Sequence[StrPath]


@dataclass(frozen=True, eq=False, repr=False)
class LearnResult(Result):
    """A detector that was learned, from `learn_detector`.

        learned = modsim3d.learn_detector(run="runs/first")
        learned.detector, learned.write("learned.yaml")

    Attributes:
        report: Every number with its interval, and the figures of an evaluation.
        inputs: The files that it was learned from; none of them is written over.
        sources: The same with what the page says of them.
        sections: Further sections of the page, such as those of a voyage.
    """

    report: LearnReport
    inputs: tuple[Path, ...]
    sources: Sources
    sections: tuple[Block, ...] = ()

    def __repr__(self) -> str:
        """From how much it was learned, and that most matches are lost where they are."""
        warning = f" WARNING: {self.report.warning}." if self.report.warning else ""
        return f"<LearnResult: {self.detector.in_words()}; {lead(self.report)}{warning}>"

    def _document(self) -> Document:
        return document(self.report, "detector", self.sources.names, self.sections)

    @property
    def content(self) -> dict[str, Any]:
        """The keys of its detector file."""
        return self.report.learned.detector()

    @cached_property
    def detector(self) -> DetectorModel:
        """The detector, as `load_detector` would read it from its file."""
        return parse_detector(self.content, "learned detector")

    def write(self, path: StrPath, *, overwrite: bool = False) -> tuple[Path, Path]:
        """Write the detector file, and beside it a page with every number and its interval, as `.html`.

        Also `NAME.uncertainty.json`, from which a campaign with `uncertainty: learned` draws detectors.

        Args:
            path: The detector file, such as `learned.yaml`.
            overwrite: Replace files that are there; those that it was learned from are never replaced.

        Returns:
            Paths of the detector file and of the page.

        Raises:
            OutputError: A file exists, or cannot be written.
            TypeError: The path is neither text nor a path.
        """
        out = as_path(path, "path")
        written = detector_files(out)
        with claimed(written, overwrite=overwrite, inputs=self.inputs):
            write_files(learned_files(self, out))
        return written[0], written[1]


def learned_files(result: LearnResult, out: Path) -> dict[Path, bytes | str]:
    """Content of the files that are written: the detector, its page, and how well the numbers are known."""
    detector = detector_text(result.content, comments(result.report))
    text = page_text(result.report, out, detector, result.sources, result.sections)
    texts = detector, text, uncertainty_text(result.report.learned, detector)
    return dict(zip(detector_files(out), texts, strict=True))


def detector_files(out: Path) -> list[Path]:
    """The detector file, its page, and how well numbers are known. Raises InputError if the page would be the file."""
    page = out.parent / f"{out.stem}.html"
    if os.path.realpath(page) == os.path.realpath(out):
        raise InputError("--out", [f"the page would be written over the detector file: name it .yaml (got {out})"])
    return [out, page, uncertainty_file(out)]


def comments(report: LearnReport) -> list[str]:
    """The lines at the head of a learned detector file."""
    states = report.state_map.states.items()
    return [
        f"Learned by modsim3d learn. {lead(report)}",
        *(f"States: {name} = {', '.join(names)}" for name, names in states),
        *([f"Warning: {report.warning}"] if report.warning else []),
        *(f"Remark: {remark}" for remark in report.remarks),
        *(f"Left simple: {note}" for note in report.learned.notes),
    ]


@dataclass(frozen=True, eq=False)
class LearnInputs:
    """Labelled sets that are learned from, as one, and where they came from."""

    labelled: LabelledSet  # all sets and runs together
    truth: tuple[Path, ...]  # of each pair, as it was given
    detections: tuple[Path, ...]
    runs: tuple[StoredRun, ...]
    read: tuple[Path, ...]  # every file that was opened, but those of runs

    @classmethod
    def of(
        cls, request: LearnRequest, truth: Sequence[Path], results: Sequence[Path], runs: Sequence[StoredRun | StrPath]
    ) -> LearnInputs:
        """Read pairs of truth and detections, and runs. Raises ModsimError if there is nothing, not one of both for
        each condition, or a file cannot be read."""
        names = request.conditions
        if len(truth) != len(results):
            counts = f"{len(truth)} of truth and {len(results)} of detections are given"
            raise ModsimError(f"{counts}: give one pair for each condition")
        if names and len(names) != len(truth):
            counts = f"{len(names)} conditions are named for {len(truth)} pairs of truth and detections"
            raise ModsimError(f"{counts}: name each pair, in their order")
        if not truth and not runs:
            raise ModsimError("nothing to learn from: give truth and detections, or a run")
        if truth and runs and request.match is None:
            raise ModsimError(
                "runs and files are matched differently unless a rule is named: give --match confidence, optimal or "
                "centre for both, or learn from each alone"
            )
        names = names or (("usual",) if len(truth) == 1 else tuple(f"condition_{k + 1}" for k in range(len(truth))))
        with inputs_noted() as read:  # also of files that are not named, such as data.yaml
            parts = [read_pair(*pair, request.read_options) for pair in zip(names, truth, results, strict=True)]
            opened = tuple(opened_run(run) for run in runs)
            parts += [labelled_run(run)[0] for run in opened]
        return cls(joined(parts), tuple(truth), tuple(results), opened, tuple(read))

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that was read; none of them is written over."""
        return (*self.read, *(path for run in self.runs for path in read_of_run(run.folder)))

    def learn(self, request: LearnRequest, call: str) -> LearnResult:
        """Learn a detector; the page shows `call`. Raises ModsimError if nothing can be learned from this."""
        interval_s = self.runs[-1].scene.detector.transition_interval_s if self.runs else None
        settings = request.settings(self.labelled)
        options = replace(request.options(interval_s), check=request.check)
        report = labelled_sets.learn_detector(self.labelled, settings, options)
        sources = Sources(self.truth, self.detections, self.runs, self.read, settings, call)
        return LearnResult(report, self.files, sources)


def learn_detector(
    *,
    truth: Paths | None = None,
    detections: Paths | None = None,
    run: StoredRun | StrPath | Sequence[StoredRun | StrPath] | None = None,
    conditions: Sequence[str] = (),
    states: int | Mapping[str, Sequence[str]] | None = None,
    sequence: StrPath | None = None,
    interval_s: float | None = None,
    match: Method | None = None,
    least_iou: float = 0.5,
    most_distance_px: float = 50.0,
    confidence: float | None = None,
    confidence_scale: tuple[float, float] | None = None,
    replicates: int = 300,
    seed: int = 0,
    level: float = 0.95,
    beta: float = 2.0,
    false_positives: NumberModel = "auto",
    without: Sequence[str] = (),
    labels: Sequence[str] = (),
    image_size_px: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    first_frame: int | None = None,
    horizon: float | tuple[float, float, float, float] | None = None,
    category_offset: int = 0,
    skip_bad: bool = False,
    check: bool = True,
) -> LearnResult:
    """Learn a detector from its results on a labelled set, with intervals that say how well each number is known.

        learned = modsim3d.learn_detector(truth="gt.json", detections="dt.json")
        learned.write("my_detector.yaml")

    Args:
        truth, detections: A labelled set and the detector's results on it, both COCO, MOT, KITTI or YOLO, each a file
            or a folder; as many of both, in pairs, for several conditions.
        run: A run, or its directory, or several, in place of both.
        conditions, states: A name for each pair, and which of them make each performance state, such as `{"good":
            ["day"], "bad": ["fog", "rain"]}`, or a number of states to be found by F1; one for each if None.
        sequence, interval_s: Text file with a state on each line, in time order, for transitions; seconds between two.
        match: How boxes are matched: `confidence`, `optimal`, `centre` or `provenance`, by what each detection came
            from; if None, by that in runs, which know it, else by `confidence`, or `optimal` without confidences.
        least_iou: Least IoU of a match by `confidence` and `optimal`.
        most_distance_px: Largest distance between centres of a match by `centre`, in pixels.
        confidence: Least confidence of a detection that counts; 0.2 if None. Without confidences all count.
        replicates, seed, level: Number of replicates of the bootstrap, its seed, and confidence level of the intervals.
        beta: How many times more recall weighs than precision in F-beta.
        false_positives: Model of the number of false positives: `auto`, `calibrated` or `per_image`.
        without: Models to leave out, whatever the data carry; docs/learn.md has their names.
        labels: Names of the classes, for MOT and YOLO; types of KITTI.
        image_size_px, frame_rate_hz, first_frame, horizon, confidence_scale, skip_bad: As those of `detect_truth`.
        category_offset: Number to add to the category IDs of COCO results.
        check: Compare what each half of the data teaches with the other half; it takes several times as long.

    Raises:
        ModsimError: A file cannot be read, an argument is wrong, or nothing can be learned from this.
        TypeError: A path is neither text nor a path.
    """
    return _learned(**locals())


def _learned(truth: Any, detections: Any, run: Any, states: Any, sequence: Any, **options: Any) -> LearnResult:
    """Result of learning from the arguments of `learn_detector`."""
    text = None if sequence is None else read_text(as_path(sequence, "sequence"), "sequence")
    plain = {name: options[name] for name in LearnRequest.model_fields.keys() & options.keys()}
    chosen = {"sequence": text} | parse_states(states, "learn_detector")
    request = LearnRequest.of("learn_detector", **plain | chosen)
    runs = () if run is None else tuple(run) if isinstance(run, list | tuple) else (run,)
    inputs = LearnInputs.of(request, _paths(truth, "truth"), _paths(detections, "detections"), runs)
    call = f"modsim3d.learn_detector({'run=…' if runs else 'truth=…, detections=…'}).write(…) from Python"
    result = inputs.learn(request, call)
    return result if sequence is None else replace(result, inputs=(*result.inputs, as_path(sequence, "sequence")))


def _paths(given: Paths | None, name: str) -> list[Path]:
    if given is None:
        return []
    paths = [given] if isinstance(given, str | bytes | os.PathLike) or not isinstance(given, Iterable) else given
    return [as_path(path, name, "a path or a list of paths") for path in paths]
