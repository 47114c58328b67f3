"""The command `modsim3d detect`: the detector alone, over a finished truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.progress import progress
from modsim3d.commands.run_json import run_json
from modsim3d.commands.run_summary import print_summary
from modsim3d.commands.shared import (
    FinishedRunArgument,
    FromOption,
    JsonOption,
    OverwriteOption,
    QuietOption,
    SetOption,
    StateOption,
    VerboseOption,
    WorkersOption,
)
from modsim3d.commands.terminal import say_json, tell_files, timed


def detect_command(
    run: FinishedRunArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Run directory to write.")],
    detector: Annotated[Path | None, typer.Option(metavar="FILE", help="Detector file, in place of the run's.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Seed of the detector, in place of the run's.")
    ] = None,
    settings: SetOption = None,
    state: StateOption = None,
    state_from: FromOption = None,
    overwrite: OverwriteOption = False,
    workers: WorkersOption = 1,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Run another detector, or the same one with another seed, over a finished run's truth without rendering again.

    Example: modsim3d detect runs/first --seed 7 --out runs/second
    """
    from modsim3d.runs.detect_run import detect_run
    from modsim3d.runs.files.replacing import read_of_run
    from modsim3d.runs.stored_run import open_run
    from modsim3d.scene.settings import read_settings

    with timed("opening the run"):
        stored = open_run(run)
    tell_files([*read_of_run(run), *([detector] if detector else [])])
    with timed("detections and files"), progress(stored.scene.name, stored.scene.steps) as advance:
        result = detect_run(
            stored,
            out,
            detector=detector,
            seed=seed,
            settings=read_settings(settings or ()),
            state=state,
            state_from=state_from,
            overwrite=overwrite,
            workers=workers,
            progress=advance,
        )
    print_summary(stored.scene, result, sheet=False)
    say_json(run_json("detect", stored.scene, result, sheet=False))
