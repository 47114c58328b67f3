"""Arguments, options and output that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

INTERRUPTED = 130
"""Exit status after Ctrl-C."""

SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help="A scene file, or the name of a shipped scene.")]
FinishedRunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The run directory of a finished run.")]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace existing output; never what the command reads.")
]
WorkersOption = Annotated[
    int, typer.Option(min=1, help="Number of processes that share the work; the output stays the same.")
]
StepsOption = Annotated[int | None, typer.Option(min=1, help="Number of time steps, in place of the scene's.")]
EveryOption = Annotated[int, typer.Option(min=1, help="Take every K-th step only.")]


def print_rows(console: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows as a table without a header under a title; print nothing if there are no rows."""
    from rich.table import Table

    if not rows:
        return
    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    console.print()
    console.print(table)


def print_line(console: Console, text: str, style: str = "") -> None:
    """Print text as it is: no markup, no highlighting, no wrapping of paths."""
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
