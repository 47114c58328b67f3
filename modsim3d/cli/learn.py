"""The command `modsim3d learn`: from a detector's output to a detector file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.cli.detect import (
    ConfidenceScaleOption,
    FrameRateOption,
    HorizonOption,
    ImageSizeOption,
    SkipBadOption,
    read_options,
)
from modsim3d.cli.learn_voyage import (
    AttitudeOption,
    CameraOption,
    EmptyOption,
    FixedOption,
    ImagesOption,
    KnownOption,
    PositionNoiseOption,
    SceneOption,
    StaleOption,
    StartOption,
    WriteSceneOption,
    asked_voyage,
)
from modsim3d.cli.shared import (
    JsonOption,
    OverwriteOption,
    QuietOption,
    VerboseOption,
    out_file,
    print_written,
    typed_command,
)
from modsim3d.cli.terminal import open_console, print_document, say_json, tell_files, timed, warn
from modsim3d.core.errors import InputError, ModsimError

if TYPE_CHECKING:
    from modsim3d.formats.labelled import LabelledSet
    from modsim3d.formats.matching import Rule
    from modsim3d.formats.reading.builder import ReadOptions
    from modsim3d.learn.bootstrap import Column, Interval
    from modsim3d.learn.figures import Figures
    from modsim3d.learn.report import LearnReport
    from modsim3d.learn.voyage.report import VoyageReport
    from modsim3d.runs.stored_run import StoredRun

# ---- What `modsim3d learn --json` says of what was learned ----


def learn_json(report: LearnReport, written: Sequence[Path]) -> dict[str, Any]:
    """The figures of each condition and state, and the numbers of the detector file, with their intervals."""
    labelled, learned = report.labelled, report.learned
    groups = {"conditions": report.conditions, "states": report.states}
    return {
        "format": 1,
        "command": "learn",
        "images": len(labelled.images),
        "annotations": len(labelled.annotations),
        "detections": len(labelled.results),
        "labels": list(labelled.labels),
        "matched_by": report.matched_by,
        "confidence_threshold": learned.observed.threshold,
        "level": report.level,
        "beta": report.beta,
        **{name: [_figures(figures, report) for figures in group] for name, group in groups.items()},
        "state_conditions": dict(report.state_map.states),
        "numbers": [number for each in learned.intervals(report.level) for number in _numbers(each)],
        "lost_average_precision": report.shares
        and {share.kind.value: share.gain_points for share in report.shares.shares},
        "warning": report.warning,
        "remarks": list(report.remarks),
        "left_simple": list(learned.notes),
        "written": list(written),
    }


def _figures(figures: Figures, report: LearnReport) -> dict[str, Any]:
    """Figures of a condition or state whatever the label, and the mean average precision."""

    def found(column: Column) -> dict[str, float]:
        return column.content(report.level, figures.units)

    return {
        "name": figures.name,
        "images": figures.images,
        **{name: found(column) for name, column in figures.any_label._asdict().items()},
        "average_precision": figures.mean_average_precision and found(figures.mean_average_precision.all_points),
    }


def _numbers(interval: Interval) -> list[dict[str, Any]]:
    """Each number of an entry of the detector file, after the name of its key."""
    import numpy as np

    ends = {"value": interval.estimate, "low": interval.low, "high": interval.high}
    return [
        {"name": interval.key.at(place), **{name: float(np.asarray(array)[place]) for name, array in ends.items()}}
        for place in np.ndindex(*np.shape(interval.estimate))
    ]


class Match(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """How boxes are matched."""

    confidence = "confidence"
    optimal = "optimal"
    centre = "centre"
    provenance = "provenance"


class FalsePositiveChoice(str, Enum):  # noqa: UP042
    """Model of the number of false positives."""

    auto = "auto"
    calibrated = "calibrated"
    per_image = "per_image"


def learn_command(
    context: typer.Context,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Detector file to write.")],
    truth: Annotated[
        list[Path] | None,
        typer.Option(metavar="PATH", help="Ground truth: COCO JSON, MOT gt.txt or YOLO folder; repeatable."),
    ] = None,
    detections: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="PATH",
            help="Detections of each --truth: COCO results, MOT det.txt or YOLO folder; logs of --scene; repeatable.",
        ),
    ] = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Condition that a pair of --truth and --detections shows; repeatable."),
    ] = None,
    run: Annotated[
        list[Path] | None,
        typer.Option("--run", metavar="RUN", help="Run directory, in place of --truth and --detections; repeatable."),
    ] = None,
    scene: SceneOption = None,
    camera: CameraOption = None,
    start: StartOption = None,
    images: ImagesOption = None,
    attitude: AttitudeOption = None,
    fixed: FixedOption = None,
    known: KnownOption = None,
    empty: EmptyOption = None,
    stale: StaleOption = None,
    position_noise: PositionNoiseOption = None,
    write_scene: WriteSceneOption = None,
    state: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=COND,...", help="Performance state, and the conditions it is made of; repeatable."),
    ] = None,
    states: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of states to make of the conditions, by their F1.")
    ] = None,
    sequence: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Text file with a state on each line, in time order, for the transitions."),
    ] = None,
    interval: Annotated[
        float | None, typer.Option(metavar="S", help="Seconds between two lines of --sequence.")
    ] = None,
    match: Annotated[
        Match | None,
        typer.Option(
            metavar="HOW",
            help="How boxes are matched: confidence, optimal, centre or provenance.",
            show_default="provenance for --run, confidence for files, centre for AIS, optimal without confidences",
        ),
    ] = None,
    iou: Annotated[
        float | None,
        typer.Option(
            min=0.01, max=1, metavar="R", help="Least IoU, for --match confidence and optimal.", show_default="0.5"
        ),
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option(min=0, metavar="PX", help="Largest distance, for --match centre.", show_default="50"),
    ] = None,
    confidence: Annotated[
        float | None,
        typer.Option(
            min=0, max=1, metavar="P", help="Least confidence of a detection that counts.", show_default="0.2"
        ),
    ] = None,
    confidence_scale: ConfidenceScaleOption = None,
    clutter: Annotated[
        FalsePositiveChoice,
        typer.Option(metavar="MODEL", help="Model of the number of false positives: auto, calibrated or per_image."),
    ] = FalsePositiveChoice.auto,
    without: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL,...",
            help="Models to leave out, whatever the data carry: relative, mixed, student_t, effects, persistence, "
            "vessels, sizes, places, lasting, confidence, slopes, duplicates, merges, splits.",
        ),
    ] = None,
    level: Annotated[
        float, typer.Option(min=0.5, max=0.9999, metavar="P", help="Confidence level of the intervals.")
    ] = 0.95,
    replicates: Annotated[
        int, typer.Option(min=20, metavar="N", help="Number of bootstrap replicates, for the intervals.")
    ] = 300,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the bootstrap.")] = 0,
    beta: Annotated[
        float, typer.Option(min=0.01, metavar="B", help="How many times more recall weighs than precision in F-beta.")
    ] = 2.0,
    bias: Annotated[
        bool, typer.Option("--bias", help="Simulate what was learned, to find how much matching shifts the numbers.")
    ] = False,
    correct: Annotated[
        bool, typer.Option("--correct", help="Find that shift as --bias does, and take it off the numbers once.")
    ] = False,
    labels: Annotated[
        str | None, typer.Option(metavar="A,B,...", help="Names of the classes, for MOT and YOLO, in order.")
    ] = None,
    image_size: ImageSizeOption = None,
    frame_rate: FrameRateOption = None,
    horizon: HorizonOption = None,
    category_offset: Annotated[
        int, typer.Option(metavar="N", help="Number to add to the category IDs of COCO results.")
    ] = 0,
    skip_bad: SkipBadOption = False,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="HTML page to write.", show_default="the detector file's name with .html"),
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Learn a detector from its results on a labelled set, with intervals that say how well it is known.

    Example: modsim3d learn --truth gt.json --detections dt.json --out detector.yaml
    """
    from modsim3d.io.atomic_write import write_files
    from modsim3d.io.input_files import inputs_noted, read_text
    from modsim3d.io.overwrite_guard import check_free, claimed
    from modsim3d.learn.learn_detector import LearnOptions, learn_detector, least_confidence
    from modsim3d.learn.learned import LearnSettings, uncertainty_file
    from modsim3d.learn.learning import learned_files
    from modsim3d.learn.model_selection import left_out
    from modsim3d.learn.report_page import Sources, document
    from modsim3d.learn.voyage.report import voyage_json, voyage_sections
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.scene.parts import SCENE_FILE

    out = out_file(out, Path("detector.yaml"))
    page = out_file(page, out.with_suffix(".html"))
    if os.path.realpath(page) == os.path.realpath(out):
        raise InputError("--out", [f"the page would be written over the detector file: name it .yaml (got {out})"])
    plain = left_out((name.strip() for name in without.split(",")) if without else (), "--without")
    options = read_options(labels, image_size, skip_bad, frame_rate, category_offset, confidence_scale, horizon)
    if match is None and truth and run:
        raise ModsimError(
            "--run and --truth are matched differently unless --match is given: give --match confidence, optimal or "
            "centre for both, or learn from each alone"
        )
    shift = bias or correct
    voyage = asked_voyage(
        *(scene, truth, run, camera, start, images, attitude, fixed, known, empty, stale, position_noise),
        *(write_scene, shift),
    )
    scene_file = [voyage.write_scene / SCENE_FILE] if voyage and voyage.write_scene else []
    for path in (out, page, uncertainty_file(out), *scene_file):
        check_free(path, overwrite)  # again below, but reading may take minutes
    with timed("reading"), inputs_noted() as read:  # also of files that no option names, such as data.yaml
        runs: tuple[StoredRun, ...] = ()
        if voyage:
            sighted = voyage.labelled(detections or [], condition or [], options, confidence)
            labelled = sighted.labelled
        else:
            labelled, runs = _labelled_set(truth or [], detections or [], condition or [], run or [], options)
        order = read_text(sequence, "sequence") if sequence else None
    if interval is None and runs:
        interval = runs[-1].scene.detector.transition_interval_s
    least = least_confidence(labelled, confidence)
    rule = _rule(labelled, match, iou, distance, voyage.position_m if voyage else 0.0)
    settings = LearnSettings(rule, least, replicates, seed, clutter.value, plain)
    wanted = LearnOptions(tuple(state or ()), states, order, interval, level, beta, shift)
    noted = list(read)
    read += [path for folder in run or () for path in read_of_run(folder)]
    read += voyage.besides(detections or []) if voyage else []
    tell_files(read)
    scene_files = voyage.scene_files(sighted) if voyage else {}
    written = [out, page, uncertainty_file(out), *scene_files]
    _check_apart(written[:3], list(scene_files))
    told: VoyageReport | None = None
    with claimed(written, overwrite=overwrite, inputs=read):
        with timed("learning"):
            if voyage:
                report, told = voyage.learn(sighted, settings, wanted)
            else:
                report = learn_detector(labelled, settings, wanted)
        with timed("files"):
            given = voyage.truth(detections or []) if voyage else tuple(truth or ()), tuple(detections or ())
            sources = Sources(*given, runs, tuple(noted), settings, typed_command(context))
            sections = voyage_sections(told) if told else ()
            write_files(learned_files(report, out, page, sources, correct, sections) | scene_files)
    console = open_console()
    print_document(console, document(report, out.name, sources.names, sections))
    print_written(console, written)
    if report.warning:
        warn(report.warning)
    say_json(learn_json(report, written) | {"voyage": voyage_json(told) if told else None})


def _check_apart(written: Sequence[Path], scene_files: Sequence[Path]) -> None:
    """Raise an `InputError` where the detector file or what lies beside it would be a file of the written scene."""
    places = {path.resolve() for path in scene_files}
    for path in written:
        if path.resolve() in places:
            raise InputError("--write-scene", [f"{path} is a file of the scene: give --out another folder or name"])


def _rule(
    labelled: LabelledSet, match: Match | None, iou: float | None, distance: float | None, position_m: float
) -> Rule:
    """The matching rule: the asked method or the usual one, and limits that it knows."""
    from modsim3d.formats.matching import Rule, usual_method

    method = usual_method(labelled, position_m) if match is None else match.value
    usual = "" if match else f", which {'AIS' if position_m else 'a run'} is matched by unless --match says otherwise"
    if iou is not None and method not in ("confidence", "optimal"):
        raise ModsimError(f"--iou is for --match confidence or optimal, not for {method}{usual}")
    if distance is not None and method != "centre":
        raise ModsimError(f"--distance is for --match centre, not for {method}")
    return Rule(method, 0.5 if iou is None else iou, 50.0 if distance is None else distance)


def _labelled_set(
    truth: Sequence[Path],
    detections: Sequence[Path],
    conditions: Sequence[str],
    runs: Sequence[Path],
    options: ReadOptions,
) -> tuple[LabelledSet, tuple[StoredRun, ...]]:
    """All files and runs as one set, and the runs, opened."""
    from modsim3d.formats.labelled import joined
    from modsim3d.formats.reading.pair import read_pair

    if len(truth) != len(detections):
        raise ModsimError(
            f"--truth is given {len(truth)} and --detections {len(detections)} times: give one pair for each condition"
        )
    if conditions and len(conditions) != len(truth):
        raise ModsimError(
            f"--condition is given {len(conditions)} times, with {len(truth)} pairs of --truth and --detections: "
            "name each pair, in their order"
        )
    if not truth and not runs:
        raise ModsimError("nothing to learn from: give --truth and --detections, --run, or --scene and --detections")
    names = conditions or (["usual"] if len(truth) == 1 else [f"condition_{k + 1}" for k in range(len(truth))])
    parts = [read_pair(*pair, options) for pair in zip(names, truth, detections, strict=True)]
    opened_runs = []
    for folder in runs:
        from modsim3d.formats.labelled_run import labelled_run

        labelled, opened = labelled_run(folder)
        parts.append(labelled)
        opened_runs.append(opened)
    return joined(parts), tuple(opened_runs)
