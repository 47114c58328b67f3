"""The command `modsim3d export`: a run in another program's format."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.shared import OverwriteOption, QuietOption, RunArgument, VerboseOption, print_written
from modsim3d.commands.terminal import open_console, tell_files, timed
from modsim3d.formats.writing.registry import FORMATS

ExportFormat = Enum("ExportFormat", {name: name for name in FORMATS}, type=str)  # type: ignore[misc]
Attitude = Enum("Attitude", {name: name for name in ("true", "measured")}, type=str)  # type: ignore[misc]
_CONTENTS = "; ".join(f"{name} ({format_.content})" for name, format_ in FORMATS.items())


def export_command(
    run: RunArgument,
    format_: Annotated[ExportFormat, typer.Option("--format", metavar="FORMAT", help=f"Format to write: {_CONTENTS}.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    camera: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this camera; may be given more than once.")
    ] = None,
    attitude: Annotated[
        Attitude | None,
        typer.Option(help="csv: attitude of cameras on board, as the inertial unit measures it (default) or true."),
    ] = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Write a run's truth and detections in another program's format.

    Example: modsim3d export runs/first --format coco --out exported
    """
    from modsim3d.formats.writing.request import ExportRequest
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.selection import select_cameras
    from modsim3d.runs.stored_run import open_run

    chosen, read = FORMATS[format_.value], read_of_run(run)
    if attitude is not None and "attitude" not in chosen.options:
        raise typer.BadParameter(f"goes with --format csv, not {format_.value}", param_hint="'--attitude'")
    with timed("opening the run"):
        opened = open_run(run)
        request = ExportRequest(
            opened, tuple(sorted(select_cameras(opened, camera or ()))), attitude.value if attitude else "measured"
        )
        paths = [out / name for name in chosen.files(request)]
    tell_files(read)
    with claimed(paths, overwrite=overwrite, inputs=read), timed("files"):
        chosen.write(request, out)
    print_written(open_console(), paths)
