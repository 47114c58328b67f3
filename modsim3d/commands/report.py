"""The commands `modsim3d report` and `modsim3d rerun`: a run to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.progress import progress_bar
from modsim3d.commands.shared import OverwriteOption, QuietOption, RunArgument, VerboseOption, out_file
from modsim3d.commands.terminal import say, tell_files, timed, warn
from modsim3d.commands.tracks_option import (
    ScaleOption,
    SimilarityOption,
    ThresholdOption,
    TracksOption,
    opened_tracks,
    read_of_tracks,
)


def report_command(
    run: RunArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write.", show_default="RUN/report.html")
    ] = None,
    every: Annotated[
        int, typer.Option(min=1, metavar="K", help="Show every K-th step only; the tables count all steps.")
    ] = 1,
    tracks: TracksOption = None,
    similarity: SimilarityOption = None,
    scale: ScaleOption = None,
    threshold: ThresholdOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

    Example: modsim3d report runs/first
    """
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.report.report import REPORT_FILE, write_report

    with timed("opening the run"):
        opened = open_run(run)
    read = read_of_run(run) + read_of_tracks(tracks)
    tell_files(read)
    followed = opened_tracks(tracks, opened, similarity, scale, threshold)
    path = out_file(out, run / REPORT_FILE)
    with timed("page"), claimed([path], overwrite=overwrite, inputs=read), progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))

        def advance(steps: int) -> None:
            bar.update(task, advance=steps, refresh=True)

        write_report(opened, path, every, advance, followed)
    if followed is not None:
        say(followed.sentence())
    if not opened.finished:
        warn(f"an interrupted run: {opened.steps} of {opened.scene.steps} steps are there and shown")
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB)")


def rerun_command(
    run: RunArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Rerun recording to write.", show_default="RUN/run.rrd")
    ] = None,
    every: Annotated[int, typer.Option(min=1, metavar="K", help="Record every K-th step only.")] = 1,
    tracks: TracksOption = None,
    similarity: SimilarityOption = None,
    scale: ScaleOption = None,
    threshold: ThresholdOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Write a run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time.

    Example: modsim3d rerun runs/first --out first.rrd
    """
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.rerun.recording import write_recording

    with timed("opening the run"):
        opened = open_run(run)
    read = read_of_run(run) + read_of_tracks(tracks)
    tell_files(read)
    followed = opened_tracks(tracks, opened, similarity, scale, threshold)
    path = out_file(out, run / "run.rrd")
    with timed("recording"), claimed([path], overwrite=overwrite, inputs=read), progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))

        def advance(steps: int) -> None:
            bar.update(task, advance=steps, refresh=True)

        write_recording(opened, path, every, advance, followed)
    if followed is not None:
        say(followed.sentence())
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB); look at it with: rerun {path}")
