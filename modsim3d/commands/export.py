"""The command `modsim3d export`: a run in another program's format."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.commands.shared import OverwriteOption, QuietOption, RunArgument, VerboseOption, print_written
from modsim3d.commands.terminal import open_console, tell_files, timed

if TYPE_CHECKING:
    from modsim3d.formats.labelled import LabelledSet


class ExportFormat(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """Formats of other programs."""

    coco = "coco"


Writer = Callable[["LabelledSet", Path], tuple[Path, ...]]
"""Writes a labelled set into a folder, and returns the files."""


def _coco() -> tuple[tuple[str, ...], Writer]:
    from modsim3d.formats.coco import FILES, write_coco

    return FILES, write_coco


WRITERS: dict[ExportFormat, Callable[[], tuple[tuple[str, ...], Writer]]] = {ExportFormat.coco: _coco}
"""What gives the names of a format's files and their writer."""


def export_command(
    run: RunArgument,
    format_: Annotated[
        ExportFormat, typer.Option("--format", metavar="FORMAT", help="Format to write: coco (gt.json and dt.json).")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Write a run's truth and detections in another program's format.

    Example: modsim3d export runs/first --format coco --out exported
    """
    from modsim3d.formats.labelled_run import labelled_run
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run

    names, write = WRITERS[format_]()
    read = read_of_run(run)
    with claimed([out / name for name in names], overwrite=overwrite, inputs=read):
        with timed("reading the run"):
            labelled, _ = labelled_run(run)
        tell_files(read)
        with timed("files"):
            written = write(labelled, out)
    print_written(open_console(), written)
