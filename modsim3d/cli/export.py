"""The command `modsim3d export`: a run in another program's format, or as a recording for the Rerun viewer."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import flag, option
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn
from modsim3d.formats.writing.export_formats import FORMATS, check_options

RERUN = "rerun"
ExportFormat = Enum("ExportFormat", {name: name for name in (*FORMATS, RERUN)}, type=str)  # type: ignore[misc]
_CONTENTS = "; ".join(
    [*(f"{name} ({format_.content})" for name, format_ in FORMATS.items()), f"{RERUN} (run.rrd for the Rerun viewer)"]
)
RERUN_OPTIONS = ("--every", "--tracks", "--similarity", "--threshold")


def export_command(
    context: typer.Context,
    run: shared.RunArgument,
    format: Annotated[ExportFormat, option("FORMAT", f"Format to write: {_CONTENTS}.", "--format")],
    out: Annotated[Path, option("DIR", "Folder for the files.")],
    cameras: Annotated[
        list[str] | None, option("NAME", "Camera to export; repeatable.", "--camera", show_default="all cameras")
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
) -> None:
    """Write a run's truth and detections in another program's format.

    --every, --tracks, --similarity and --threshold are for --format rerun, a recording of the run in space and time.

    Example: modsim3d export runs/first --format coco --out exported
    """
    from modsim3d.formats.writing.export_formats import export
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.followed_tracks import read_of_tracks
    from modsim3d.view.rerun_recording import export_rerun

    chosen = format.value
    given: dict[str, object] = {
        "--masks": masks,
        "--true-attitude": true_attitude,
        "--every": every != 1,
        "--tracks": tracks,
    }
    given |= {"--similarity": similarity, "--threshold": threshold, "--camera": cameras}
    check_options(chosen, given, {RERUN: RERUN_OPTIONS})
    with timed("opening the run"):
        opened = open_run(run)
    tell_files(read_of_run(run) + read_of_tracks(tracks))
    if chosen == RERUN:
        with timed("recording"), shared.progress(opened.scene.name, -(-opened.steps // every)) as advance:
            recording = export_rerun(**shared.arguments(context, export_rerun, run=opened), progress=advance)
        for note in recording.notes:
            say(note)
        size_mb = recording.path.stat().st_size / 1e6
        say(f"written  {recording.path}  ({size_mb:.1f} MB); look at it with: rerun {recording.path}")
        return
    with timed("files"):
        written = export(**shared.arguments(context, export, run=opened, format=chosen))
    shared.print_written(open_console(), written.paths)
    for note in written.notes:
        warn(note)
