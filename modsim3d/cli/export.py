"""The command `modsim3d export`: a run in another program's format, or as a recording for the Rerun viewer."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli.shared import (
    EveryOption,
    OverwriteOption,
    QuietOption,
    RunArgument,
    SimilarityOption,
    ThresholdOption,
    TracksOption,
    VerboseOption,
    opened_tracks,
    print_written,
    progress_bar,
    read_of_tracks,
)
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn
from modsim3d.core.errors import ModsimError
from modsim3d.formats.writing.registry import FORMATS

RERUN = "rerun"
ExportFormat = Enum("ExportFormat", {name: name for name in (*FORMATS, RERUN)}, type=str)  # type: ignore[misc]
_CONTENTS = "; ".join(
    [*(f"{name} ({format_.content})" for name, format_ in FORMATS.items()), f"{RERUN} (run.rrd for the Rerun viewer)"]
)
RERUN_OPTIONS = ("--every", "--tracks", "--similarity", "--threshold")


def export_command(
    run: RunArgument,
    format_: Annotated[ExportFormat, typer.Option("--format", metavar="FORMAT", help=f"Format to write: {_CONTENTS}.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    camera: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Camera to export; repeatable.", show_default="all cameras")
    ] = None,
    masks: Annotated[
        bool, typer.Option("--masks", help="Write which pixels each vessel has, whole and visible (coco only).")
    ] = False,
    true_attitude: Annotated[
        bool,
        typer.Option(
            "--true-attitude", help="Write the true attitude of cameras on board, not the measured one (csv only)."
        ),
    ] = False,
    every: EveryOption = 1,
    tracks: TracksOption = None,
    similarity: SimilarityOption = None,
    threshold: ThresholdOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Write a run's truth and detections in another program's format.

    --every, --tracks, --similarity and --threshold are for --format rerun, a recording of the run in space and time.

    Example: modsim3d export runs/first --format coco --out exported
    """
    from modsim3d.formats.writing.request import ExportRequest
    from modsim3d.io.overwrite_guard import claimed, claimed_folders
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.selection import select_cameras
    from modsim3d.runs.stored_run import open_run

    given = {"--masks": masks, "--true-attitude": true_attitude, "--every": every != 1, "--tracks": tracks}
    _check_options(format_.value, {**given, "--similarity": similarity, "--threshold": threshold, "--camera": camera})
    if format_.value == RERUN:
        _export_rerun(run, out, every, tracks, similarity, threshold, overwrite)
        return
    chosen, read = FORMATS[format_.value], read_of_run(run)
    with timed("opening the run"):
        opened = open_run(run)
        cameras = tuple(sorted(select_cameras(opened, camera or ())))
        request = ExportRequest(opened, cameras, masks, "true" if true_attitude else "measured")
        paths = [out / name for name in chosen.files(request)]
        folders = {out / name: pattern for name, pattern in chosen.folders().items()}
    tell_files(read)
    with (
        claimed(paths, overwrite=overwrite, inputs=read),
        claimed_folders(folders, overwrite=overwrite, inputs=read),
        timed("files"),
    ):
        chosen.write(request, out)
    print_written(open_console(), [*paths, *folders])
    for note in chosen.notes(request):
        warn(note)


def _export_rerun(
    run: Path,
    out: Path,
    every: int,
    tracks: Path | None,
    similarity: str | None,
    threshold: float | None,
    overwrite: bool,
) -> None:
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.rerun_recording import write_recording

    with timed("opening the run"):
        opened = open_run(run)
    read = read_of_run(run) + read_of_tracks(tracks)
    tell_files(read)
    followed = opened_tracks(tracks, opened, similarity, threshold)
    path = out / "run.rrd"
    with timed("recording"), claimed([path], overwrite=overwrite, inputs=read), progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        write_recording(opened, path, every, lambda steps: bar.update(task, advance=steps, refresh=True), followed)
    if followed is not None:
        say(followed.sentence())
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB); look at it with: rerun {path}")


def _check_options(name: str, given: Mapping[str, object]) -> None:
    """Refuse options that a format does not take.

    Raises:
        ModsimError: One is given.
    """
    takers = {other: (*format_.options, "--camera") for other, format_ in FORMATS.items()} | {RERUN: RERUN_OPTIONS}
    for option, value in given.items():
        if value and option not in takers[name]:
            others = " or ".join(other for other, options in takers.items() if option in options)
            raise ModsimError(f"{option} goes with --format {others}, not with {name}")
