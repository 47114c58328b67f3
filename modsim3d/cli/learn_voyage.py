"""The command `modsim3d learn-voyage`: from what a detector wrote during a voyage to a detector file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.cli import detect, learn, shared
from modsim3d.cli.shared import option, under
from modsim3d.cli.terminal import say_json, tell_files, timed
from modsim3d.core.errors import InputError
from modsim3d.core.paths import out_file

if TYPE_CHECKING:
    from modsim3d.learn.voyage.logs.log import Start

LOGS, REGISTRATION = "The logs", "Registration and truth"


def learn_voyage_command(
    context: typer.Context,
    scene: shared.SceneArgument,
    out: learn.DetectorOutOption,
    detections: Annotated[
        list[Path] | None,
        option("FILE", "Detections of the voyage: the log of a camera's detector, or a run; repeatable."),
    ] = None,
    camera: Annotated[
        list[str] | None, option("NAME", "Camera of the logs: once for all, or for each in their order; repeatable.")
    ] = None,
    condition: Annotated[list[str] | None, option("NAME", "Condition that a log shows; repeatable.")] = None,
    states: learn.StatesOption = None,
    match: learn.MatchOption = None,
    confidence: learn.ConfidenceOption = None,
    write_scene: Annotated[Path | None, option("DIR", "Scene folder to write, with the registered cameras.")] = None,
    overwrite: shared.OverwriteOption = False,
    log_start: Annotated[
        str | None, under(LOGS, "TIME", "Time of the logs' zero: UTC, or seconds since the scene's first step.")
    ] = None,
    images: Annotated[
        Path | None, under(LOGS, "FILE", "COCO file with the times of the images that COCO results name.")
    ] = None,
    empty: Annotated[
        str | None,
        under(
            LOGS,
            "FROM-TO,...",
            "Stretches in which nothing floats but the scene's vessels, by the log's clock, in seconds or UTC.",
        ),
    ] = None,
    confidence_scale: detect.ConfidenceScaleOption = None,
    labels: learn.LabelsOption = None,
    frame_rate: detect.FrameRateOption = None,
    category_offset: learn.CategoryOffsetOption = 0,
    skip_bad: detect.SkipBadOption = False,
    fixed: Annotated[
        str | None,
        under(
            REGISTRATION,
            "NAME,...",
            "Parameters that are not registered: clock, roll, pitch, yaw, height, focal, k1, mean_width, "
            "mean_height; or all.",
        ),
    ] = None,
    known: Annotated[
        str | None,
        under(
            REGISTRATION,
            "NAME=VALUE,...",
            "Means that are known, for registration: of box errors, mean_x and mean_y in pixels, mean_width and "
            "mean_height as shares; of position reports, delay in seconds.",
            show_default="zero",
        ),
    ] = None,
    attitude: Annotated[
        Path | None, under(REGISTRATION, "FILE", "Table of own ship's roll, pitch and heading by time.")
    ] = None,
    position_noise: Annotated[
        float | None,
        under(
            REGISTRATION,
            "M",
            "Standard deviation of each coordinate of positions in the scene.",
            show_default="10 with AIS, else 0",
        ),
    ] = None,
    stale: Annotated[
        float | None,
        under(
            REGISTRATION,
            "SECONDS",
            "Least time without an AIS report after which a vessel under way is left out.",
            show_default="60",
        ),
    ] = None,
    false_positives: learn.FalsePositivesOption = "auto",
    without: learn.WithoutOption = None,
    sequence: learn.SequenceOption = None,
    time_step: learn.TimeStepOption = None,
    level: learn.LevelOption = 0.95,
    replicates: learn.ReplicatesOption = 300,
    seed: learn.BootstrapSeedOption = 0,
    beta: learn.BetaOption = 2.0,
) -> None:
    """Learn a detector from what it wrote during a voyage whose vessels' tracks are known from AIS or a scene.

    Example: modsim3d learn-voyage scenes/sound --detections night.csv --out detector.yaml
    """
    from modsim3d.io.atomic_write import write_files
    from modsim3d.io.input_files import inputs_noted
    from modsim3d.io.overwrite_guard import check_free, claimed
    from modsim3d.learn.learning import detector_files, learned_files
    from modsim3d.learn.voyage.labelled_voyage import scene_files
    from modsim3d.learn.voyage.learn_voyage import VoyageRequest
    from modsim3d.learn.voyage.logs.log import LogOptions
    from modsim3d.learn.voyage.report import voyage_json
    from modsim3d.scene.parts import SCENE_FILE
    from modsim3d.scene.reading import load_scene

    request = learn.learn_request(context)
    start = None if log_start is None else _start(log_start)
    voyage = VoyageRequest(
        request,
        load_scene(scene),
        tuple(detections or ()),
        tuple(camera or (None,)),
        None,
        () if fixed is None else fixed,
        known,
        empty,
        position_noise,
        stale,
        attitude,
        LogOptions(frame_rate, start, images, request.labels, request.confidence_scale, category_offset, skip_bad),
    )
    out = out_file(out, Path("detector.yaml"))
    written = detector_files(out)
    for path in [*written, *([write_scene / SCENE_FILE] if write_scene else [])]:
        check_free(path, overwrite)  # again below, but reading may take minutes
    with timed("reading"), inputs_noted() as read:
        labelled = voyage.labelled()
    files = scene_files(voyage.scene, labelled.registered, write_scene) if write_scene else {}
    _check_apart(written, list(files))
    read = [*read, *voyage.files, *([sequence] if sequence else [])]
    tell_files(dict.fromkeys(read))
    with claimed([*written, *files], overwrite=overwrite, inputs=read):
        with timed("learning"):
            result = voyage.learn(labelled, read, shared.typed_command(context))
        with timed("files"):
            write_files(learned_files(result, out) | files)
    learn.show_result(result, out.name, [*written, *files])
    content = learn.learn_json(result.report, [*written, *files], "learn-voyage")
    say_json(content | {"voyage": voyage_json(result.voyage_report)})


def _check_apart(written: Sequence[Path], scene_files: Sequence[Path]) -> None:
    """Raise an `InputError` where the detector file or what lies beside it would be a file of the written scene."""
    places = {path.resolve() for path in scene_files}
    for path in written:
        if path.resolve() in places:
            raise InputError("--write-scene", [f"{path} is a file of the scene: give --out another folder or name"])


def _start(text: str) -> Start:
    """The time of a log's zero."""
    import math

    from modsim3d.io.validation import shown
    from modsim3d.learn.voyage.logs.log import Clock, Start, time_of

    time_s, utc = time_of(text)
    if math.isnan(time_s):
        wanted = "a time such as 2024-01-04T10:00:00.250Z, or seconds since the scene's first step, is needed"
        raise InputError("--log-start", [f"{wanted} (got {shown(text)})"])
    return Start(time_s, Clock.UTC if utc else Clock.STEP)
