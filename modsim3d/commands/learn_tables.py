"""The tables that `modsim3d learn` prints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.commands.learn_voyage import show_voyage_tables
from modsim3d.commands.shared import print_line, print_written
from modsim3d.commands.tables import print_prose, print_table
from modsim3d.commands.terminal import open_console, warn

if TYPE_CHECKING:
    from rich.console import Console

    from modsim3d.learn.told.report import Report
    from modsim3d.voyage.told.voyage_report import VoyageReport


def show_report(report: Report, written: Sequence[Path], told: VoyageReport | None) -> None:
    """Print what was learned; of a voyage what AIS does not see before it."""
    from modsim3d.learn.told.report import lead
    from modsim3d.learn.told.tables import NEVER_LEARNED, tables

    console = open_console()
    print_prose(console, lead(report))
    for remark in report.remarks:
        print_prose(console, f"Remark: {remark}.")
    if told:
        show_voyage_tables(told)
    for table in tables(report):
        _print(console, table.title, table.header, table.rows)
    print_line(console, "\nLeft simple, and why", "bold")
    for note in report.learned.notes or ("nothing: there was enough of everything",):
        print_prose(console, note, indent=2)
    print_line(console, "")
    print_prose(console, NEVER_LEARNED)
    print_written(console, written)
    if report.warning:
        warn(report.warning)


_BREAKS: tuple[Callable[[str], str], ...] = (
    lambda cell: cell.replace(" [", "\n["),
    lambda cell: "\n".join(cell.split()) if " to " not in cell else cell,
)
"""Where cells are broken that are too wide: first before intervals, then before both their ends."""


def _print(console: Console, title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    left = {
        place
        for place in range(len(header))
        if place == 0 or not any(row[place][:1].isdigit() or row[place][:1] in ("", "-", "–") for row in rows)
    }
    print_table(console, title, rows, header=header, right=set(range(len(header))) - left, breaks=_BREAKS)
