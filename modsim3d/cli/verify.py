"""The command `modsim3d verify`: does a run obey its detector file?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli.shared import (
    FinishedRunArgument,
    JsonOption,
    OverwriteOption,
    QuietOption,
    VerboseOption,
    print_written,
    typed_command,
)
from modsim3d.cli.terminal import open_console, print_document, say_json, tell_files, timed


def verify_command(
    context: typer.Context,
    run: FinishedRunArgument,
    detector: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Detector file to hold the run against.", show_default="the run's own"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for verify.json and verify.html.", show_default="RUN")
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Check that a run obeys its detector file: every parameter as given and as measured, with a verdict.

    Exit status 1 if a verdict is against the run.

    Example: modsim3d verify runs/first
    """
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.verify import verify_run as verify_report
    from modsim3d.verify.verify_run import verify_run

    with timed("opening the run"):
        opened = open_run(run)
    folder = run if out is None else out
    paths = [folder / name for name in verify_report.FILES]
    read = [*read_of_run(run), *([detector] if detector else [])]
    tell_files(read)
    with claimed(paths, overwrite=overwrite, inputs=read):
        with timed("checks"):
            verified = verify_run(opened, detector)
        with timed("files"):
            verify_report.write_report(verified, folder, typed_command(context))
    verification = verified.verification
    console = open_console()
    print_document(console, verify_report.document(verified))
    print_written(console, paths)
    said = {"conclusion": verify_report.conclusion(verification), "notes": verify_report.notes_of(verification)}
    say_json({"command": "verify", **verify_report.report_data(verified), **said, "written": paths})
    if not verification.obeys:
        raise typer.Exit(1)
