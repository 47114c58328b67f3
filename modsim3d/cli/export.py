"""The command `modsim3d export`: a run in another program's format."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.cli.shared import OverwriteOption, QuietOption, RunArgument, VerboseOption, print_written
from modsim3d.cli.terminal import open_console, tell_files, timed, warn
from modsim3d.core.errors import ModsimError
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
    masks: Annotated[
        bool, typer.Option("--masks", help="Write which pixels each vessel has, whole and visible (coco only).")
    ] = False,
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
    from modsim3d.io.overwrite_guard import claimed, claimed_folders
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.selection import select_cameras
    from modsim3d.runs.stored_run import open_run

    chosen, read = FORMATS[format_.value], read_of_run(run)
    _check_options(format_.value, {"--masks": masks, "--attitude": attitude})
    with timed("opening the run"):
        opened = open_run(run)
        cameras = tuple(sorted(select_cameras(opened, camera or ())))
        request = ExportRequest(opened, cameras, masks, attitude.value if attitude else "measured")
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


def _check_options(name: str, given: Mapping[str, object]) -> None:
    """Refuse options that a format does not take.

    Raises:
        ModsimError: One is given.
    """
    for option, value in given.items():
        if value and option not in FORMATS[name].options:
            takers = " or ".join(other for other, format_ in FORMATS.items() if option in format_.options)
            raise ModsimError(f"{option} goes with --format {takers}, not with {name}")
