"""Learning from files or from a run, and what comes of it: a detector, its file and a page."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from modsim3d.core.document import Block
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.file.writing import detector_text
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import LabelledSet, joined
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, usual_method
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.io.atomic_write import write_files
from modsim3d.io.input_files import inputs_noted
from modsim3d.io.overwrite_guard import claimed
from modsim3d.io.validation import Count, Number, Positive, Probability, Strict, describe, shown
from modsim3d.learn import learn_detector as labelled_sets
from modsim3d.learn.learn_detector import LearnOptions
from modsim3d.learn.learned import LearnSettings, uncertainty_file, uncertainty_text
from modsim3d.learn.model_selection import left_out
from modsim3d.learn.report import LearnReport, lead
from modsim3d.learn.report_page import Sources, document, page_text
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.stored_run import StoredRun, opened_run

Paths = StrPath | Sequence[StrPath]
Method = Literal["confidence", "optimal", "centre", "provenance"]


@dataclass(frozen=True, eq=False, repr=False)
class LearnResult:
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

    def _repr_html_(self) -> str:
        """From how much it was learned, what to be careful about, and how well the detector detects."""
        return document(self.report).notebook()

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
        page, unsure = out.parent / f"{out.stem}.html", uncertainty_file(out)
        if page == out:
            raise InputError("path", [f"the page would be written over the detector file: name it .yaml (got {out})"])
        with claimed([out, page, unsure], overwrite=overwrite, inputs=self.inputs):
            write_files(learned_files(self.report, out, page, self.sources, sections=self.sections))
        return out, page


def learned_files(
    report: LearnReport,
    out: Path,
    page: Path,
    sources: Sources,
    corrected: bool = False,
    sections: Sequence[Block] = (),
) -> dict[Path, bytes | str]:
    """The content of the files that are written: the detector, the page, and how well the numbers are known.

    Args:
        report: What was learned.
        out: The detector file.
        page: The page.
        sources: What it was learned from.
        corrected: Whether to take the bias of matching off the numbers.
        sections: Further sections of the page.
    """
    learned = report.bias.corrected() if corrected and report.bias else report.learned
    detector = detector_text(learned.detector(), comments(report, corrected))
    text = page_text(report, out, detector, sources, sections)
    return {out: detector, page: text, uncertainty_file(out): uncertainty_text(learned, detector)}


def comments(report: LearnReport, corrected: bool = False) -> list[str]:
    """The lines at the head of a learned detector file; `corrected` says that the bias of matching was taken off."""
    states = report.state_map.states.items()
    return [
        f"Learned by modsim3d learn. {lead(report)}",
        *(f"States: {name} = {', '.join(names)}" for name, names in states),
        *([f"Warning: {report.warning}"] if report.warning else []),
        *(f"Remark: {remark}" for remark in report.remarks),
        *(["Corrected once for the bias of the matching."] if corrected else []),
        *(f"Left simple: {note}" for note in report.learned.notes),
    ]


class _Choices(Strict):
    """The arguments that are neither paths nor runs."""

    conditions: tuple[str, ...]
    match: Method | None
    least_iou: Annotated[float, Field(strict=True, gt=0, le=1)]
    most_distance_px: Positive
    confidence: Probability | None
    confidence_scale: tuple[Number, Number] | None
    replicates: Annotated[int, Field(strict=True, ge=20)]
    seed: Count
    without: tuple[str, ...]
    labels: tuple[str, ...]
    image_size_px: tuple[Positive, Positive] | None
    frame_rate_hz: Positive | None
    horizon: Number | tuple[Number, Number, Number, Number] | None


def learn_detector(
    *,
    truth: Paths | None = None,
    detections: Paths | None = None,
    run: StoredRun | StrPath | None = None,
    conditions: Sequence[str] = (),
    states: int | Mapping[str, Sequence[str]] | None = None,
    match: Method | None = None,
    least_iou: float = 0.5,
    most_distance_px: float = 50.0,
    confidence: float | None = None,
    confidence_scale: tuple[float, float] | None = None,
    replicates: int = 300,
    seed: int = 0,
    without: Sequence[str] = (),
    labels: Sequence[str] = (),
    image_size_px: tuple[float, float] | None = None,
    frame_rate_hz: float | None = None,
    horizon: float | tuple[float, float, float, float] | None = None,
) -> LearnResult:
    """Learn a detector from its results on a labelled set, with intervals that say how well each number is known.

        learned = modsim3d.learn_detector(truth="gt.json", detections="dt.json")
        learned.write("my_detector.yaml")

    Args:
        truth: The labelled set: COCO's JSON, MOT's `gt.txt` or a folder of YOLO labels; several for several conditions.
        detections: The detector's results on it, in the same format, as many.
        run: A run, or its directory, in place of both.
        conditions: A name for each pair of truth and detections.
        states: Which conditions make each performance state, such as `{"good": ["day"], "bad": ["fog", "rain"]}`, or
            a number of states to be found by F1; a state for each condition if None.
        match: How boxes are matched: `confidence`, `optimal`, `centre` or `provenance`; if None, by provenance, that
            is by what each detection came from, where that is known, which is in runs; else by `confidence`, or
            by `optimal` without confidences.
        least_iou: Least IoU of a match by `confidence` and `optimal`.
        most_distance_px: Largest distance between centres of a match by `centre`, in pixels.
        confidence: Least confidence of a detection that counts; 0.2 if None. Without confidences all count.
        confidence_scale: Confidences in the files that stand for 0 and for 1, such as (0, 100); None if they are from
            0 to 1.
        replicates: Number of replicates of the bootstrap.
        seed: Seed of the bootstrap.
        without: Models to leave out, whatever the data carry; docs/learn.md has their names.
        labels: Names of the classes, for MOT and YOLO.
        image_size_px: Width and height, for MOT without `seqinfo.ini` and YOLO without its images.
        frame_rate_hz: Frames in a second, where the files do not say.
        horizon: Row of the horizon in images that do not say theirs, or x and y of two of its points.

    Raises:
        ModsimError: A file cannot be read, an argument is wrong, or nothing can be learned from this.
        TypeError: A path is neither text nor a path.
    """
    given = _choices(
        conditions=conditions,
        match=match,
        least_iou=least_iou,
        most_distance_px=most_distance_px,
        confidence=confidence,
        confidence_scale=confidence_scale,
        replicates=replicates,
        seed=seed,
        without=without,
        labels=labels,
        image_size_px=image_size_px,
        frame_rate_hz=frame_rate_hz,
        horizon=horizon,
    )
    wanted, interval_s = _states(states), None
    runs: tuple[StoredRun, ...] = ()
    pairs: list[tuple[str, Path, Path]] = []
    if run is not None:
        if truth is not None or detections is not None:
            raise ModsimError("give truth and detections, or run: not both")
        opened = opened_run(run)
        labelled, inputs, runs = labelled_run(opened)[0], read_of_run(opened.folder), (opened,)
        interval_s = opened.scene.detector.transition_interval_s
    else:
        pairs = _pairs(truth, detections, given.conditions)
        with inputs_noted() as inputs:  # also of files that are not named, such as data.yaml
            labelled = _read(pairs, given)
    rule = Rule(given.match or usual_method(labelled), given.least_iou, given.most_distance_px)
    least = labelled_sets.least_confidence(labelled, given.confidence)
    settings = LearnSettings(
        rule, least, given.replicates, given.seed, without=left_out(given.without, "learn_detector: without")
    )
    options = LearnOptions(*wanted, interval_s=interval_s)
    truths, results = tuple(pair[1] for pair in pairs), tuple(pair[2] for pair in pairs)
    call = f"modsim3d.learn_detector({'run=…' if runs else 'truth=…, detections=…'}).write(…) from Python"
    sources = Sources(truths, results, runs, tuple(inputs), settings, call)
    return LearnResult(labelled_sets.learn_detector(labelled, settings, options), tuple(inputs), sources)


def _choices(**given: Any) -> _Choices:
    try:
        return _Choices(**given)
    except ValidationError as error:
        raise InputError("learn_detector", describe(error, _Choices)) from None


def _pairs(truth: Paths | None, detections: Paths | None, conditions: Sequence[str]) -> list[tuple[str, Path, Path]]:
    """Condition, truth and detections of each pair."""
    true, found = _paths(truth, "truth"), _paths(detections, "detections")
    if not true and not found:
        raise ModsimError("nothing to learn from: give truth and detections, or run")
    if len(true) != len(found):
        raise ModsimError(f"truth names {len(true)} and detections {len(found)}: give one pair for each condition")
    if conditions and len(conditions) != len(true):
        raise ModsimError(f"conditions names {len(conditions)} for {len(true)} pairs of truth and detections")
    names = conditions or (["usual"] if len(true) == 1 else [f"condition_{k + 1}" for k in range(len(true))])
    return list(zip(names, true, found, strict=True))


def _paths(given: Paths | None, name: str) -> list[Path]:
    if given is None:
        return []
    each = [given] if isinstance(given, str | bytes | os.PathLike) or not isinstance(given, Iterable) else given
    return [as_path(path, name, "a path or a list of paths") for path in each]


def _read(pairs: Iterable[tuple[str, Path, Path]], given: _Choices) -> LabelledSet:
    scale = given.confidence_scale
    if scale and not scale[0] < scale[1]:
        raise InputError("learn_detector", [f"confidence_scale: must be two numbers that rise (got {shown(scale)})"])
    line = given.horizon
    options = ReadOptions(
        given.labels,
        given.image_size_px,
        frame_rate_hz=given.frame_rate_hz,
        confidence_scale=scale,
        horizon=(line,) if isinstance(line, float) else line,
    )
    return joined([read_pair(*pair, options) for pair in pairs])


def _states(given: object) -> tuple[tuple[str, ...], int | None]:
    """The states as `LearnOptions` has them: texts, or their number."""
    if given is None:
        return (), None
    if isinstance(given, int) and not isinstance(given, bool) and given > 0:
        return (), given
    if isinstance(given, Mapping):
        named = {name: [of] if isinstance(of, str) else of for name, of in given.items()}
        if all(isinstance(of, Sequence) and all(isinstance(each, str) for each in of) for of in named.values()):
            return tuple(f"{name}={','.join(of)}" for name, of in named.items()), None
    needed = "a number of states from 1, or a mapping from states to lists of conditions, is needed"
    raise InputError("learn_detector", [f"states: {needed} (got {shown(given)})"])
