"""The command `modsim3d detect`: the detector alone, over a finished run or over somebody's labelled video."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from modsim3d.cli import shared
from modsim3d.cli.run import print_truth_summary, run_json, truth_json
from modsim3d.cli.run_summary import print_summary
from modsim3d.cli.shared import argument, flag, option, under
from modsim3d.cli.terminal import say_json, tell_files, timed
from modsim3d.core.errors import InputError, ModsimError

if TYPE_CHECKING:
    from modsim3d.io.processes import WorkerCount
    from modsim3d.runs.stored_run import StoredRun

# ---- Options of the commands that read labelled sets ----

TruthOption = Annotated[Path | None, option("FILE", "Ground truth of a labelled video, in place of RUN.")]
DetectionsOption = Annotated[
    Path | None, option("FILE", "Detections of a real detector in the video of --truth.", "--detections")
]

FILES = "Labelled files"
ImageSizeOption = Annotated[
    str | None, under(FILES, "W,H", "Size of the images in pixels, for YOLO, KITTI and MOT without seqinfo.ini.")
]
FrameRateOption = Annotated[
    float | None, under(FILES, "HZ", "Frames per second, for YOLO, and for others whose files do not say it.")
]
LabelsOption = Annotated[
    str | None, option("A,B,...", "Labels of the classes of --truth, in order; - for one that is no target.")
]
FirstFrameOption = Annotated[
    int | None, under(FILES, "N", "Number of the first frame, and of the first pixel, in MOT.", min=0, max=1)
]
ConfidenceScaleOption = Annotated[
    str | None, under(FILES, "LOW,HIGH", "Confidences in the files that stand for 0 and for 1, such as 0,100.")
]
HorizonOption = Annotated[
    str | None, under(FILES, "ROW", "Row of the horizon in images that do not say theirs, or X1,Y1,X2,Y2.")
]
SkipBadOption = Annotated[
    bool, flag("--skip-bad", "Leave out wrong entries of the files, and say how many.", rich_help_panel=FILES)
]


def parsed_names(text: str | None, option: str) -> tuple[str, ...]:
    """Names of a text such as `a,b`. Raises InputError if one is empty, so that others would take its place."""
    names = tuple(part.strip() for part in text.removesuffix(",").split(",")) if text else ()
    if "" in names:
        problem = f"the name {names.index('') + 1} is empty, so others would move (got '{text}')"
        raise InputError(option, [problem])
    return names


def parsed_horizon(text: str) -> tuple[float, ...] | float:
    """The row of a horizon, or the numbers of two of its points. Raises InputError if the text is something else."""
    from modsim3d.formats.labelled import parse_horizon

    numbers = parse_horizon(text)
    return numbers[0] if len(numbers) == 1 else numbers


def parsed_scale(text: str) -> tuple[float, float]:
    """Both ends of a text such as `0,100`."""
    return _pair(text, "--confidence-scale", "LOW,HIGH, two numbers that rise, as 0,100", lambda low, high: low < high)


def parsed_size(text: str) -> tuple[float, float]:
    """Width and height of a text such as `1920,1080`."""
    needed = "W,H in pixels, both sides above 0, as 1920,1080"
    return _pair(text.replace("x", ","), "--image-size", needed, lambda width, height: min(width, height) > 0)


def _pair(text: str, option: str, needed: str, holds: Callable[[float, float], bool]) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        first, second = math.nan, math.nan
    if not (math.isfinite(first + second) and holds(first, second)):
        raise InputError(option, [f"must be {needed} (got '{text}')"])
    return first, second


def detect_command(
    out: Annotated[Path, option("DIR", "Run directory, or folder with --truth, to write.")],
    run: Annotated[Path | None, argument("[RUN]", "Run directory of a finished run.")] = None,
    truth: Annotated[
        Path | None,
        option("FILE", "Ground truth of a labelled video, in place of RUN: MOT, COCO, KITTI or YOLO, with tracks."),
    ] = None,
    detections: Annotated[
        Path | None, option("FILE", "Detections of a real detector in the video, in place of a simulated one.")
    ] = None,
    detector: Annotated[Path | None, option("FILE", "Detector file, in place of the run's.")] = None,
    detector_seed: Annotated[
        int | None, option("N", "Seed of the detector, in place of the run's; 0 with --truth.", min=0)
    ] = None,
    labels: LabelsOption = None,
    image_size: ImageSizeOption = None,
    frame_rate: FrameRateOption = None,
    first_frame: FirstFrameOption = None,
    horizon: HorizonOption = None,
    confidence_scale: ConfidenceScaleOption = None,
    skip_bad: SkipBadOption = False,
    settings: shared.SetOption = None,
    state: shared.StateOption = None,
    state_from: shared.FromOption = None,
    overwrite: shared.OverwriteOption = False,
    workers: shared.WorkersOption = 1,
) -> None:
    """Run another detector, or the same one with another seed, over a finished run's truth without rendering again.

    With --truth, make a run of a labelled video from elsewhere (docs/labelled_video.md).

    Example: modsim3d detect runs/first --detector-seed 7 --out runs/second
    """
    from modsim3d.scene.settings import read_settings

    given = {
        "detector": detector,
        "settings": read_settings(settings or ()),
        "state": state,
        "state_from": state_from,
        "overwrite": overwrite,
    }
    of_truth: dict[str, object] = {
        "--detections": detections,
        "--confidence-scale": confidence_scale,
        "--labels": labels,
        "--image-size": image_size,
        "--frame-rate": frame_rate,
        "--first-frame": first_frame,
        "--horizon": horizon,
        "--skip-bad": skip_bad or None,
    }
    if run is not None and truth is None:
        for option, value in of_truth.items():
            if value is not None:
                raise ModsimError(f"{option} is for --truth: a run says it itself")
        _detect_run(run, out, detector_seed, workers, given)
    elif truth is not None and run is None:
        if workers != 1:
            raise ModsimError("--workers is for RUN: with --truth the detector works in one process")
        size_px = None if image_size is None else parsed_size(image_size)
        scale = None if confidence_scale is None else parsed_scale(confidence_scale)
        read = {"image_size_px": size_px, "frame_rate_hz": frame_rate, "first_frame": first_frame}
        read |= {"skip_bad": skip_bad, "confidence_scale": scale}
        names = None if labels is None else tuple(name.strip() for name in labels.split(","))
        _detect_truth(
            truth, out, detector_seed or 0, {**given, **read, "detections": detections, "labels": names}, horizon
        )
    else:
        raise ModsimError("give either RUN, a finished run, or --truth FILE, a labelled video")


def _detect_run(run: Path, out: Path, seed: int | None, workers: WorkerCount, given: Mapping[str, Any]) -> None:
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.run import detect_run
    from modsim3d.runs.stored_run import open_run

    with timed("opening the run"):
        stored = open_run(run)
    tell_files([*read_of_run(run), *([given["detector"]] if given["detector"] else [])])
    with timed("detections and files"), shared.progress(stored.scene.name, stored.scene.steps) as advance:
        result = detect_run(stored, out, seed=seed, workers=workers, progress=advance, **given)
    print_summary(stored.scene, result, sheet=False)
    say_json(run_json("detect", stored.scene, result, sheet=False))


def _detect_truth(truth: Path, out: Path, seed: int, given: Mapping[str, Any], horizon: str | None) -> None:
    from modsim3d.formats.detect_truth import detect_truth
    from modsim3d.formats.labelled import parse_horizon
    from modsim3d.io.input_files import inputs_noted

    line = None if horizon is None else parse_horizon(horizon)
    with inputs_noted() as read, timed("reading, detections and files"):
        result = detect_truth(truth, out, seed=seed, horizon=line, **given)
    tell_files(dict.fromkeys(read))
    print_truth_summary(result)
    say_json(truth_json(result))


@contextmanager
def opened(run: Path | None, truth: Path | None, detections: Path | None, **options: Any) -> Iterator[StoredRun]:
    """The run of a directory, or that of a labelled video and of what a real detector found in it, which is in a folder
    of its own as long as it is used; `options` are those of files. Raises ModsimError if neither or both are given."""
    from modsim3d.formats.detect_truth import labelled_video
    from modsim3d.io.input_files import inputs_noted
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run

    if (run is None) == (truth is None):
        raise ModsimError("give either RUN, a finished run, or --truth FILE, a labelled video")
    if truth is None:
        for name, value in {"detections": detections, **options}.items():
            if value is not None:
                raise ModsimError(f"--{name.replace('_', '-')} is for --truth: a run says it itself")
        with timed("opening the run"):
            stored = open_run(run or Path())
        tell_files(read_of_run(stored.folder))
        yield stored
        return
    size, rate_hz, labels = (options.pop(name) for name in ("image_size", "frame_rate", "labels"))
    options |= {"image_size_px": None if size is None else parsed_size(size), "frame_rate_hz": rate_hz}
    options |= {"labels": None if labels is None else parsed_names(labels, "--labels")}
    with ExitStack() as stack:
        with inputs_noted() as read, timed("reading the labels"):
            try:
                stored = stack.enter_context(labelled_video(truth, detections, **options))
            except InputError as error:
                of_detect = {r"(.*--(?:skip-bad|confidence-scale)\b.*)": r"\1 (an option of `modsim3d detect --truth`)"}
                raise error.reworded(of_detect) from None
        tell_files(dict.fromkeys(read))
        yield stored
