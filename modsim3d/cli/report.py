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
    parts: Annotated[
        bool, flag("--parts", "Write the frames into a folder beside the page, for very long runs.")
    ] = False,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

    With RUN_B, it plays both side by side and marks where their detectors differ.

    Example: modsim3d report runs/first
    """
    from modsim3d.core.errors import ModsimError
    from modsim3d.io.overwrite_guard import claimed, claimed_folders
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.report.images import FILM_FILES, film_frames
    from modsim3d.view.report.report import PART_FILES, REPORT_FILE, parts_folder, write_report
    from modsim3d.view.report.side_by_side import SIDE_BY_SIDE_FILE, write_side_by_side

    for name, given in (("--tracks", tracks), ("--pictures", pictures)):
        if other is not None and given is not None:
            raise ModsimError(f"{name} is for one run: leave out RUN_B, or {name}")
    with timed("opening the run"):
        opened = open_run(run)
        second = None if other is None else open_run(other)
    read = read_of_run(run) + shared.read_of_tracks(tracks) + ([] if other is None else read_of_run(other))
    tell_files(read)
    followed = shared.opened_tracks(tracks, opened, similarity, threshold)
    path = shared.out_file(out, run / (REPORT_FILE if second is None else SIDE_BY_SIDE_FILE))
    folders = {parts_folder(path): PART_FILES} if parts else {}
    decoded = path.with_name(f"{path.stem}_images") if pictures is not None and pictures.is_file() else None
    if decoded is not None:
        folders[decoded] = FILM_FILES
    with (
        timed("page"),
        claimed([path], overwrite=overwrite, inputs=read),
        claimed_folders(folders, overwrite=overwrite, inputs=read),
        shared.progress_bar() as bar,
    ):
        runs = 1 if second is None else 2
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every) * runs)

        def advance(steps: int) -> None:
            bar.update(task, advance=steps, refresh=True)

        if pictures is not None and decoded is not None:
            pictures = film_frames(pictures, decoded, opened)
        if second is None:
            command = shared.typed_command(context)
            write_report(opened, path, every, advance, followed, command, tracks, in_files=parts, pictures=pictures)
        else:
            write_side_by_side(opened, second, path, every, advance, shared.typed_command(context), in_files=parts)
    if followed is not None:
        say(followed.sentence())
    if not opened.finished:
        warn(f"an interrupted run: {opened.steps} of {opened.scene.steps} steps are there and shown")
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB)")
    for folder in folders:
        size = sum(file.stat().st_size for file in folder.iterdir())
        say(f"written  {folder}  ({size / 1e6:.1f} MB): the page needs it beside it")
