"""The commands `modsim3d report` and `modsim3d rerun`: a run to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.progress import progress_bar
from modsim3d.commands.shared import OverwriteOption
from modsim3d.commands.terminal import say


def report_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")],
    out: Annotated[Path | None, typer.Option(help="The file to write.", show_default="RUN/report.html")] = None,
    every: Annotated[int, typer.Option(min=1, help="Show every K-th step; the tables count all.")] = 1,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a page that plays a run: images, boxes, timeline and tables in one file of HTML.

    Example: modsim3d report runs/first
    """
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.report.report import REPORT_FILE, write_report

    opened = open_run(run)
    path = run / REPORT_FILE if out is None else out
    with claimed([path], overwrite=overwrite, inputs=read_of_run(run)), progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        write_report(opened, path, every, progress=lambda steps: bar.update(task, advance=steps, refresh=True))
    if not opened.finished:
        say(f"an interrupted run: {opened.steps} of {opened.scene.steps} steps are there and shown")
    say(f"written  {path}  ({path.stat().st_size / 1e6:.1f} MB)")


def rerun_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")],
    out: Annotated[Path | None, typer.Option(help="The file to write.", show_default="RUN/run.rrd")] = None,
    every: Annotated[int, typer.Option(min=1, help="Only every K-th step.")] = 1,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a run as a recording for the Rerun viewer: cameras, vessels and boxes in space and time.

    Example: modsim3d rerun runs/first --out first.rrd
    """
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.rerun_recording import write_recording

    opened = open_run(run)
    out = run / "run.rrd" if out is None else out
    with claimed([out], overwrite=overwrite, inputs=read_of_run(run)), progress_bar() as bar:
        task = bar.add_task(opened.scene.name, total=-(-opened.steps // every))
        write_recording(opened, out, every, progress=lambda steps: bar.update(task, advance=steps, refresh=True))
    say(f"written  {out}  ({out.stat().st_size / 1e6:.1f} MB); look at it with: rerun {out}")
