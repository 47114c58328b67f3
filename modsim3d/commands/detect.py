"""The command `modsim3d detect`: the detector alone, over a finished truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.run_summary import summarise
from modsim3d.progress import progress_bar


def detect_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run directory of a finished run.")],
    out: Annotated[Path, typer.Option(help="The new run directory.")],
    detector: Annotated[Path | None, typer.Option(help="Detector file, in place of the run's.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the detector, in place of the run's.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a run that is there.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes that share the work; the files stay the same.")] = 1,
) -> None:
    """Run another detector, or another seed of it, over a finished run's truth, without rendering again.

    Example: modsim3d detect runs/first --detector my/detector.yaml --seed 7 --out runs/second
    """
    from modsim3d.detect_run import detect_run
    from modsim3d.stored_run import open_run

    stored = open_run(run)
    with progress_bar() as bar:
        task = bar.add_task(stored.scene.name, total=stored.scene.steps)
        result = detect_run(
            stored,
            out,
            detector=detector,
            seed=seed,
            overwrite=overwrite,
            workers=workers,
            progress=lambda steps: bar.update(task, advance=steps, refresh=True),
        )
    summarise(stored.scene, result, sheet=False)
