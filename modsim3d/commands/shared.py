"""Arguments, options and output that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modsim3d.commands.completion import complete_scene
from modsim3d.commands.tables import print_table
from modsim3d.commands.terminal import ask_json, ask_quiet, ask_verbose

if TYPE_CHECKING:
    from rich.console import Console

    from modsim3d.processes import WorkerCount

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


def _workers(given: str | int) -> WorkerCount:
    from modsim3d.processes import parse_workers

    return parse_workers(str(given))  # the default comes here too, and is a number


SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="Scene file, or name of a shipped scene (modsim3d scenes).", autocompletion=complete_scene
    ),
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run directory, finished or interrupted.")]
FinishedRunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run directory of a finished run.")]
CampaignArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder of a campaign, finished or not, also while it is worked on.")
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist; never what is read.")]
WorkersOption = Annotated[
    Any,
    typer.Option(
        parser=_workers,
        metavar="N|auto",
        help="Number of processes that share the work; auto: one for each CPU. The output is the same.",
    ),
]
StepsOption = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Number of time steps, in place of the scene's.")
]
SeedOption = Annotated[
    int | None, typer.Option(min=0, metavar="N", help="Seed of all random numbers, in place of the scene's.")
]
DetectorOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Detector file, in place of the scene's.")]
DetectorSeedOption = Annotated[
    int | None, typer.Option(min=0, metavar="N", help="Seed of the detector; poses and waves keep the scene's.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the scene or, below detector., of its detector."),
]
StateOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Keep the detector in one of its performance states.")
]
FromOption = Annotated[
    str | None,
    typer.Option("--from", metavar="DIR", help="Take --state from the detectors of a folder; conditions: shipped."),
]
EveryOption = Annotated[int, typer.Option(min=1, metavar="K", help="Take every K-th time step only.")]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", callback=ask_quiet, help="Print nothing but warnings and errors.")
]
VerboseOption = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", callback=ask_verbose, help="Also print versions, files read, the OpenGL in use and times."
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", callback=ask_json, help="Print the result as one JSON object (docs/json.md).")
]


def out_file(out: Path | None, usual: Path) -> Path:
    """The file that `--out` names: in a folder that exists under its usual name, as `cp` does it.

    Args:
        out: What was given.
        usual: The file without `--out`.
    """
    if out is None:
        return usual
    return out / usual.name if out.is_dir() else out


def print_rows(console: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows as a table without a header under a title; print nothing if there are no rows."""
    print_table(console, title, rows)


def print_line(console: Console, text: str, style: str = "") -> None:
    """Print text as it is: no markup, no highlighting, no wrapping of paths."""
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def print_path(console: Console, name: str, path: Path) -> None:
    """Print a name and a path, on a line of its own where both would not fit on one."""
    from rich.cells import cell_len

    between = "  " if cell_len(f"{name}  {path}") <= console.width else "\n"
    print_line(console, f"{name}{between}{path}")


def print_written(console: Console, paths: Sequence[Path]) -> None:
    """Print which files were written, each on a line of its own; nothing if there are none."""
    if paths:
        print_line(console, "\nwritten")
    for path in paths:
        print_line(console, f"  {path}")
