"""The command `modsim3d export`: a run in another program's format, or as a recording for the Rerun viewer."""

from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated

from modsim3d.cli import shared
from modsim3d.cli.shared import flag, option
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn
from modsim3d.core.errors import ModsimError
from modsim3d.formats.writing.export_formats import FORMATS

RERUN = "rerun"
ExportFormat = Enum("ExportFormat", {name: name for name in (*FORMATS, RERUN)}, type=str)  # type: ignore[misc]
_CONTENTS = "; ".join(
    [*(f"{name} ({format_.content})" for name, format_ in FORMATS.items()), f"{RERUN} (run.rrd for the Rerun viewer)"]
)
RERUN_OPTIONS = ("--every", "--tracks", "--similarity", "--threshold")


def export_command(
    run: shared.RunArgument,
    format_: Annotated[ExportFormat, option("FORMAT", f"Format to write: {_CONTENTS}.", "--format")],
    out: Annotated[Path, option("DIR", "Folder for the files.")],
    camera: Annotated[
        list[str] | None, option("NAME", "Camera to export; repeatable.", show_default="all cameras")
    ] = None,
    masks: Annotated[
        bool, flag("--masks", "Write which pixels each vessel has, whole and visible (coco only).")
    ] = False,
    true_attitude: Annotated[
        bool, flag("--true-attitude", "Write the true attitude of cameras on board, not the measured one (csv only).")
    ] = False,
    every: shared.EveryOption = 1,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Write a run's truth and detections in another program's format.

    --every, --tracks, --similarity and --threshold are for --format rerun, a recording of the run in space and time.

    Example: modsim3d export runs/first --format coco --out exported
    """
    from modsim3d.formats.writing.export_formats import ExportRequest
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
    shared.print_written(open_console(), [*paths, *folders])
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
    read = read_of_run(run) + shared.read_of_tracks(tracks)
    tell_files(read)
    followed = shared.opened_tracks(tracks, opened, similarity, threshold)
    path = out / "run.rrd"
    with timed("recording"), claimed([path], overwrite=overwrite, inputs=read), shared.progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        write_recording(opened, path, every, lambda steps: bar.update(task, advance=steps, refresh=True), followed)
    if followed is not None:
        say(followed.sentence())
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB); look at it with: rerun {path}")


def _check_options(chosen: str, given: Mapping[str, object]) -> None:
    """Raise a `ModsimError` if an option is given that a format does not take."""
    takers = {other: (*format_.options, "--camera") for other, format_ in FORMATS.items()} | {RERUN: RERUN_OPTIONS}
    for name, value in given.items():
        if value and name not in takers[chosen]:
            others = " or ".join(other for other, options in takers.items() if name in options)
            raise ModsimError(f"{name} goes with --format {others}, not with {chosen}")
