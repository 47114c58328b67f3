"""The command `modsim3d learn`: from a detector's output to a detector file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from modsim3d.cli import detect, shared
from modsim3d.cli.shared import argument, flag, option, under
from modsim3d.cli.terminal import open_console, say_json, tell_files, timed, warn
from modsim3d.cli.terminal_tables import print_document, print_prose, print_table
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import out_file
from modsim3d.core.text import in_percent

if TYPE_CHECKING:
    from modsim3d.learn.bootstrap import Column, Interval
    from modsim3d.learn.figures import Figures
    from modsim3d.learn.learn_detector import LearnRequest
    from modsim3d.learn.learning import LearnResult
    from modsim3d.learn.report import LearnReport

# ---- Options that `modsim3d learn-voyage` has too ----

MODELS, NUMBERS, TIMES, GUESS = "Models", "Intervals and figures", "States in time", "A guess of another condition"


DetectorOutOption = Annotated[Path, option("FILE", "Detector file to write; its page is beside it, as .html.")]
StatesOption = Annotated[
    list[str] | None,
    option(
        "N|NAME=COND,...",
        "States of the detector: each with its conditions, repeatable, or how many to make of them by F1.",
        show_default="one for each condition",
    ),
]
MatchOption = Annotated[
    str | None,
    option(
        "HOW[:LIMIT]",
        "How boxes are matched: confidence or optimal, with a least IoU as in optimal:0.4; centre, with a "
        "distance in pixels as in centre:30; or provenance.",
        show_default="provenance for runs, confidence for files, centre for AIS, optimal without confidences",
    ),
]
ConfidenceOption = Annotated[
    float | None, option("P", "Least confidence of a detection that counts.", show_default="0.2")
]
SequenceOption = Annotated[
    Path | None, under(TIMES, "FILE", "Text file with a state on each line, in time order, for the transitions.")
]
TimeStepOption = Annotated[
    float | None, under(TIMES, "SECONDS", "Time between steps of the state: lines of --sequence, or transitions.")
]
FalsePositivesOption = Annotated[
    Literal["auto", "calibrated", "per_image"],
    under(MODELS, "MODEL", "Model of the number of false positives: auto, calibrated or per_image."),
]
WithoutOption = Annotated[
    str | None,
    under(
        MODELS,
        "MODEL,...",
        "Models to leave out, whatever the data carry: relative, mixed, student_t, effects, persistence, score, "
        "vessels, components, sizes, places, lasting, confidence, slopes, duplicates, merges, splits, on_vessels.",
    ),
]
LevelOption = Annotated[float, under(NUMBERS, "P", "Confidence level of the intervals.")]
ReplicatesOption = Annotated[int, under(NUMBERS, "N", "Number of bootstrap replicates, for the intervals.")]
BootstrapSeedOption = Annotated[
    int, option("N", "Seed of all random numbers: of the bootstrap.", "--seed", rich_help_panel=NUMBERS)
]
BetaOption = Annotated[float, under(NUMBERS, "B", "How many times more recall weighs than precision in F-beta.")]
LabelsOption = Annotated[
    str | None, under(detect.FILES, "A,B,...", "Labels of the classes of MOT and YOLO, in order; types of KITTI.")
]
CategoryOffsetOption = Annotated[int, under(detect.FILES, "N", "Number to add to the category IDs of COCO results.")]


# ---- The command ----


def learn_command(
    context: typer.Context,
    out: DetectorOutOption,
    runs: Annotated[
        list[Path] | None, argument("RUN", "Run directories, in place of --truth and --detections.")
    ] = None,
    truth: Annotated[
        list[Path] | None, option("FILE", "Ground truth: COCO JSON, MOT or KITTI text, or a folder; repeatable.")
    ] = None,
    detections: Annotated[
        list[Path] | None, option("FILE", "Detections of each --truth, in the same form; repeatable.")
    ] = None,
    from_figures: Annotated[
        Path | None, option("FILE", "Figures of a test report, as YAML, in place of --truth and --detections.")
    ] = None,
    condition: Annotated[
        list[str] | None, option("NAME", "Condition that a pair of --truth and --detections shows; repeatable.")
    ] = None,
    states: StatesOption = None,
    match: MatchOption = None,
    confidence: ConfidenceOption = None,
    overwrite: shared.OverwriteOption = False,
    confidence_scale: detect.ConfidenceScaleOption = None,
    labels: LabelsOption = None,
    image_size: detect.ImageSizeOption = None,
    frame_rate: detect.FrameRateOption = None,
    first_frame: detect.FirstFrameOption = None,
    horizon: detect.HorizonOption = None,
    category_offset: CategoryOffsetOption = 0,
    skip_bad: detect.SkipBadOption = False,
    false_positives: FalsePositivesOption = "auto",
    without: WithoutOption = None,
    sequence: SequenceOption = None,
    time_step: TimeStepOption = None,
    level: LevelOption = 0.95,
    replicates: ReplicatesOption = 300,
    seed: BootstrapSeedOption = 0,
    beta: BetaOption = 2.0,
    no_check: Annotated[
        bool,
        flag("--no-check", "Do not compare with the real results where it was not learned.", rich_help_panel=NUMBERS),
    ] = False,
    detector: Annotated[
        Path | None,
        under(GUESS, "FILE", "Detector file or shipped name that is changed from one condition to another."),
    ] = None,
    from_condition: Annotated[str | None, under(GUESS, "NAME", "Condition that --detector was measured in.")] = None,
    to_condition: Annotated[str | None, under(GUESS, "NAME", "Condition to guess --detector in.")] = None,
) -> None:
    """Learn a detector from its results on a labelled set, with intervals that say how well it is known.

    With --from-figures, make one of the figures of its test report, such as precision, recall and a confusion matrix.

    With --from-condition, guess how a detector performs in another condition: it changes as much as another detector
    did between the two. A condition is a detector file with one state and one label, or one that modsim3d scenes lists.

    Example: modsim3d learn --truth gt.json --detections dt.json --out detector.yaml
    """
    if from_figures:
        if runs or truth or detections or detector or from_condition or to_condition:
            raise ModsimError("--from-figures is in place of runs, files and --from-condition: give one of them")
        detector_from_figures(from_figures, out_file(out, Path("detector.yaml")), overwrite)
        return
    if detector or from_condition or to_condition:
        if runs or truth or detections or not (detector and from_condition and to_condition):
            needed = "--detector, --from-condition and --to-condition"
            raise ModsimError(f"a guess of another condition needs {needed} together, and neither runs nor files")
        show_guess(detector, from_condition, to_condition, out, overwrite)
        return
    from modsim3d.io.atomic_write import write_files
    from modsim3d.io.overwrite_guard import check_free, claimed
    from modsim3d.learn.learning import LearnInputs, detector_files, learned_files

    request = learn_request(
        context,
        image_size_px=None if image_size is None else detect.parsed_size(image_size),
        horizon=None if horizon is None else detect.parsed_horizon(horizon),
        first_frame=first_frame,
        check=not no_check,
    )
    out = out_file(out, Path("detector.yaml"))
    written = detector_files(out)
    for path in written:
        check_free(path, overwrite)  # again below, but reading may take minutes
    with timed("reading"):
        inputs = LearnInputs.of(request, truth or (), detections or (), runs or ())
    read = [*inputs.files, *([sequence] if sequence else [])]
    tell_files(read)
    with claimed(written, overwrite=overwrite, inputs=read):
        with timed("learning"):
            result = inputs.learn(request, shared.typed_command(context))
        with timed("files"):
            write_files(learned_files(result, out))
    show_result(result, out.name, written)
    say_json(learn_json(result.report, written))


def learn_request(context: typer.Context, **given: Any) -> LearnRequest:
    """Request of the options that `learn` and `learn-voyage` share, and of what else is given."""
    from modsim3d.io.input_files import read_text
    from modsim3d.learn.learn_detector import LearnRequest, parse_match, parse_states

    option = context.params
    scale, sequence = option["confidence_scale"], option["sequence"]
    same = ("confidence", "replicates", "seed", "level", "beta", "category_offset", "skip_bad")
    return LearnRequest.of(
        "modsim3d learn",
        **parse_match(option["match"]),
        **parse_states(list(option["states"] or ()) or None, "--states"),
        conditions=tuple(option["condition"] or ()),
        labels=detect.parsed_names(option["labels"], "--labels"),
        without=detect.parsed_names(option["without"], "--without"),
        sequence=None if sequence is None else read_text(Path(sequence), "sequence"),
        interval_s=option["time_step"],
        confidence_scale=None if scale is None else detect.parsed_scale(scale),
        frame_rate_hz=option["frame_rate"],
        false_positives=str(option["false_positives"]),
        **{name: option[name] for name in same},
        **given,
    )


def show_result(result: LearnResult, name: str, written: Sequence[Path]) -> None:
    """Print what was learned, which files were written, and what to be careful about."""
    from modsim3d.learn.report_page import document

    console = open_console()
    print_document(console, document(result.report, name, result.sources.names, result.sections))
    shared.print_written(console, written)
    if result.report.warning:
        warn(result.report.warning)


def detector_from_figures(report: Path, out: Path, overwrite: bool) -> None:
    """Write the detector of a test report, and print the figures that it gives back and what was assumed."""
    from modsim3d.io.overwrite_guard import check_free
    from modsim3d.learn.reported_figures import learn_from_figures

    check_free(out, overwrite, [report])
    with timed("learning"):
        made = learn_from_figures(report)
    made.write(out, overwrite=overwrite)
    tell_files([report])
    console = open_console()
    print_document(console, made.document(out.name))
    shared.print_written(console, [out])
    for contradiction in made.contradictions:
        warn(contradiction)
    figures = {name: {"report": asked, "simulated": simulated} for name, (asked, simulated) in made.figures.items()}
    facts = {"figures": figures, "assumed": made.assumed, "contradictions": made.contradictions}
    say_json({"format": 1, "command": "learn", **facts, "written": [out]})


# ---- What `modsim3d learn --json` says of what was learned ----


def learn_json(report: LearnReport, written: Sequence[Path], command: str = "learn") -> dict[str, Any]:
    """The figures of each condition and state, and the numbers of the detector file, with their intervals."""
    labelled, learned = report.labelled, report.learned
    groups = {"conditions": report.conditions, "states": report.states}
    return {
        "format": 1,
        "command": command,
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
        "numbers": [number for interval in learned.intervals(report.level) for number in _numbers(interval)],
        "lost_average_precision": report.shares
        and {share.kind.value: share.gain_points for share in report.shares.shares},
        "self_check": report.check and [asdict(comparison) for comparison in report.check.comparisons],
        "warning": report.warning,
        "remarks": list(report.remarks),
        "left_simple": list(learned.notes),
        "written": list(written),
    }


def _figures(figures: Figures, report: LearnReport) -> dict[str, Any]:
    """Figures of a condition or state whatever the label, and the mean average precision."""

    def content(column: Column) -> dict[str, float]:
        return column.content(report.level, figures.units)

    return {
        "name": figures.name,
        "images": figures.images,
        **{name: content(column) for name, column in figures.any_label._asdict().items()},
        "average_precision": figures.mean_average_precision and content(figures.mean_average_precision.all_points),
    }


def _numbers(interval: Interval) -> list[dict[str, Any]]:
    """Each number of an entry of the detector file, after the name of its key."""
    import numpy as np

    ends = {"value": interval.estimate, "low": interval.low, "high": interval.high}
    return [
        {"name": interval.key.at(place), **{name: float(np.asarray(array)[place]) for name, array in ends.items()}}
        for place in np.ndindex(*np.shape(interval.estimate))
    ]


# ---- Work of `modsim3d learn --from-condition`: a detector as it might be in another condition ----


def show_guess(detector: Path, from_condition: str, to_condition: str, out: Path, overwrite: bool) -> None:
    """Write a guess of a detector in another condition, and print what changes."""
    from modsim3d.io.input_files import inputs_noted
    from modsim3d.learn.guess import guess_detector

    with inputs_noted() as read:
        guess = guess_detector(
            detector, out, from_condition=from_condition, to_condition=to_condition, overwrite=overwrite
        )
    tell_files(read)
    console = open_console()
    print_prose(console, guess.notes[0])
    print_table(console, "In each state", list(_rows(guess.before, guess.after)))
    shared.print_written(console, guess.paths)
    for note in guess.notes[1:]:
        warn(note)


def _rows(before: dict[str, Any], after: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Numbers of each state before and after the change."""
    from modsim3d.detector.file.schema import with_covariance

    for name, was in before["states"].items():
        now, unit = after["states"][name], was["box_error"]["unit"]
        for label, old, new in zip(before["labels"], was["confusion"][-1], now["confusion"][-1], strict=True):
            yield name, f"{label} missed", f"{in_percent(old, 1)} → {in_percent(new, 1)}"
        if "false_discovery_rate" in was:
            of_all = (in_percent(state["false_discovery_rate"], 1) for state in (was, now))
            yield name, "false positives", " → ".join(of_all)
        else:
            key, rates = "false_positives_per_image", [file["false_positives"].get("rate") for file in (before, after)]
            old, new = (state.get(key, rate) for state, rate in zip((was, now), rates, strict=True))
            yield name, "false positives in an image", f"{old:.3g} → {new:.3g}"
        old, new = (with_covariance(state["box_error"])["covariance"][2][2] ** 0.5 for state in (was, now))
        yield name, "width error, standard deviation", f"{old:.3g} → {new:.3g} {'' if unit == 'relative' else 'px'}"
