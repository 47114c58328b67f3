"""The command `modsim3d repeat`: does a run come out the same again?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import typer

from modsim3d.cli.shared import (
    FinishedRunArgument,
    JsonOption,
    QuietOption,
    VerboseOption,
    WorkersOption,
    print_line,
    print_rows,
    progress,
)
from modsim3d.cli.terminal import open_console, say_json, tell_files, timed

if TYPE_CHECKING:
    from modsim3d.runs.repeat_run import RepeatedFile, Repetition


def repeat_command(
    run: FinishedRunArgument,
    workers: WorkersOption = 1,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Repeat a run from the copy of its scene into a temporary folder, and compare every file, byte by byte.

    Also checks that the stored files are still what run.json lists. Exit status 1 if a byte differs.

    Example: modsim3d repeat runs/first
    """
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.repeat_run import repeat_run
    from modsim3d.runs.stored_run import read_finished

    with timed("opening the run"):
        stored = read_finished(run)  # damage to the tables is for the comparison to tell
    tell_files(read_of_run(run))
    bar = progress(stored.scene.name, stored.scene.steps)
    with timed("repetition"), TemporaryDirectory(prefix="modsim3d_repeat_") as folder, bar as advance:
        repetition = repeat_run(stored, Path(folder) / "again", workers=workers, progress=advance)
    _print_repetition(repetition)
    say_json({"format": 1, "command": "repeat", "folder": run, "same": repetition.same, **asdict(repetition)})
    if not repetition.same:
        raise typer.Exit(1)


def _print_repetition(repetition: Repetition) -> None:
    console = open_console()
    print_rows(console, "files", [(file.name, _said(file, repetition.listed)) for file in repetition.files])
    versions = [(item.name, f"then {item.then or 'none'}", f"now {item.now or 'none'}") for item in repetition.versions]
    print_rows(console, "made with other versions", versions)
    wrong = sum(not file.same for file in repetition.files)
    if not wrong:
        print_line(console, f"\nall {len(repetition.files)} files are the same", "bold")
        return
    print_line(console, f"\n{wrong} of {len(repetition.files)} files are not the same", "bold red")


def _said(file: RepeatedFile, listed: bool) -> str:
    """Outcome for one file."""
    same = "the bytes that were written" if file.stored else "the same bytes"
    made = "" if file.is_input else f"repeated: {file.repeated or same}"
    if file.name == "run.json" and not file.repeated:
        made = "repeated: the same, versions aside"
    stored = f"stored: {file.stored}" if file.stored else "as written" if file.is_input and listed else ""
    if file.is_input and not listed and not stored:
        stored = "not listed in run.json, which an older version wrote"
    return "; ".join(filter(None, [stored, made]))
