"""The command `modsim3d verify`: does a run obey its detector file?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.commands.shared import FinishedRunArgument, OverwriteOption, print_line
from modsim3d.commands.terminal import open_console

if TYPE_CHECKING:
    from rich.console import Console

    from modsim3d.verify.parameters import Verdict

WIDE = 150
"""Columns of a table that is written to a file or a pipe."""


def verify_command(
    run: FinishedRunArgument,
    detector: Annotated[
        Path | None, typer.Option(help="Detector file to hold the run against.", show_default="the run's own")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for verify.json and verify.html.", show_default="RUN")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Check that a run obeys its detector file: every parameter as given and as measured, with a verdict.

    Exit status 1 if a verdict is against the run.

    Example: modsim3d verify runs/first
    """

    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.verify import report as verify_report
    from modsim3d.verify.verification import verify_run

    opened = open_run(run)
    folder = run if out is None else out
    paths = [folder / name for name in verify_report.FILES]
    read = [*read_of_run(run), *([detector] if detector else [])]
    with claimed(paths, overwrite=overwrite, inputs=read):
        verified = verify_run(opened, detector)
        verify_report.write_report(verified, folder)
    console = open_console()
    if not console.is_terminal:
        console = open_console(width=WIDE)
    for group, verdicts in verify_report.groups_of(verified.verification).items():
        _print_verdicts(console, group, verdicts)
    for note in verify_report.notes_of(verified.verification):
        console.print(note, style="dim", highlight=False, markup=False)
    obeys = verified.verification.obeys
    print_line(console, f"\n{verify_report.conclusion(verified.verification)}", "bold" if obeys else "bold red")
    print_line(console, f"\nwritten  {folder / 'verify.html'}, {folder / 'verify.json'}")
    if not obeys:
        raise typer.Exit(1)


def _print_verdicts(console: Console, title: str, verdicts: Sequence[Verdict]) -> None:
    """Print a table of verdicts, on a narrow terminal with fewer columns, because wrapped numbers cannot be read."""
    from rich.table import Table

    from modsim3d.verify.report import HEADER, row_of

    left_out = {name for name, least in (("interval", 120), ("noticed from", 100)) if console.width < least}
    shown = [i for i, name in enumerate(HEADER) if name not in left_out]
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim")
    for i in shown:
        table.add_column(HEADER[i], no_wrap=HEADER[i] == "parameter", overflow="fold")
    for verdict in verdicts:
        cells = row_of(verdict)
        table.add_row(*(cells[i] for i in shown), style="bold red" if verdict.fails else None)
    console.print()
    console.print(table)
