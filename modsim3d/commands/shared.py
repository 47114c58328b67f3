"""What several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

INTERRUPTED = 130
"""Exit status after Ctrl-C."""
SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help="A scene file, or the name of a shipped scene.")]


def print_rows(console: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    """Print a table without a header under a title."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    console.print()
    console.print(table)
