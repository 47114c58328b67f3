"""The command `modsim3d report`: a page that plays a run."""

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import say, tell_files, timed, warn


def report_command(
    context: typer.Context,
    run: shared.RunArgument,
    other: Annotated[Path | None, argument("RUN_B", "Another run of the same truth, to show beside the first.")] = None,
    out: Annotated[
        Path | None,
        option("FILE", "HTML file to write.", show_default="RUN/report.html; RUN/side_by_side.html with RUN_B"),
    ] = None,
    every: Annotated[int, option("K", "Take every K-th time step only; the tables count all steps.", min=1)] = 1,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    pictures: Annotated[
        Path | None,
        option("DIR|FILM", "Pictures to show below the boxes: a folder with one for each frame, or a film."),
    ] = None,
    look: Annotated[
        str | None,
        option("LOOK,...", "How vessels and sea look in pictures of the mistakes: shaded, as in view film.", "--look"),
    ] = None,
    parts: Annotated[
        bool, flag("--parts", "Write the frames into a folder beside the page, for very long runs.")
    ] = False,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

    With RUN_B, it plays both side by side and marks where their detectors differ.

    Example: modsim3d report runs/first
    """
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.followed_tracks import read_of_tracks
    from modsim3d.view.report.run_report import report

    with timed("opening the run"):
        opened, second = open_run(run), None if other is None else open_run(other)
    tell_files(read_of_run(run) + read_of_tracks(tracks) + ([] if other is None else read_of_run(other)))
    total = -(-opened.steps // every) * (1 if second is None else 2)
    with timed("page"), shared.progress(opened.scene.name, total) as advance:
        given = shared.arguments(context, report, run=opened, other=second)
        written = report(**given, progress=advance, call=shared.typed_command(context))
    for note in written.notes:
        say(note)
    if not opened.finished:
        warn(f"an interrupted run: {opened.steps} of {opened.scene.steps} steps are there and shown")
    say(f"written  {written.path}  ({written.path.stat().st_size / 1e6:.1f} MB)")
    for folder in written.paths[1:]:
        size = sum(file.stat().st_size for file in folder.iterdir())
        say(f"written  {folder}  ({size / 1e6:.1f} MB): the page needs it beside it")
