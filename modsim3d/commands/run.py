"""The command `modsim3d run`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from modsim3d.commands.progress import progress
from modsim3d.commands.run_summary import print_summary
from modsim3d.commands.shared import INTERRUPTED, OverwriteOption, SceneArgument, StepsOption, WorkersOption
from modsim3d.commands.terminal import say


class Source(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """Where the truth comes from."""

    rendered = "rendered"
    analytic = "analytic"
    rectangles = "rectangles"


class Render(str, Enum):  # noqa: UP042
    """How much of an image is rendered."""

    regions = "regions"
    full = "full"


def run_command(
    scene: SceneArgument,
    out: Annotated[Path | None, typer.Option(help="Run directory to write.", show_default="runs/SCENE")] = None,
    overwrite: OverwriteOption = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed, in place of the scene's.")] = None,
    detector: Annotated[Path | None, typer.Option(help="Detector file, in place of the scene's.")] = None,
    detector_seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the detector alone; poses and waves keep theirs.")
    ] = None,
    mode: Annotated[int | None, typer.Option(min=0, max=2, help="Annotation mode, in place of the scene's.")] = None,
    source: Annotated[Source | None, typer.Option(help="Source of the truth, in place of the scene's.")] = None,
    steps: StepsOption = None,
    render: Annotated[Render | None, typer.Option(help="Render only where vessels overlap, or whole images.")] = None,
    workers: WorkersOption = 1,
    sheet: Annotated[bool, typer.Option("--sheet/--no-sheet", help="Draw contact_sheet.png.")] = True,
) -> None:
    """Run a scene: write truth, detections and a contact sheet into a run directory.

    Example: modsim3d run simulation_1 --mode 2 --out runs/first
    """
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene

    loaded = load_scene(
        scene,
        seed=seed,
        detector=detector,
        detector_seed=detector_seed,
        steps=steps,
        mode=mode,
        source=source.value if source else None,
        render=render.value if render else None,
    )
    folder = out if out is not None else Path("runs") / loaded.name
    total = None if loaded.live else loaded.steps
    kept = f"in {folder / 'unfinished'}" if loaded.live else "go on with --resume"
    with _interruptible(kept), progress(loaded.name, total) as advance:
        result = run_scene(loaded, folder, overwrite=overwrite, resume=resume, workers=workers, progress=advance)
    if sheet:
        from modsim3d.outputs.claims import claimed
        from modsim3d.runs.stored_run import open_run
        from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet

        with claimed([folder / SHEET_FILE], overwrite=True, inputs=loaded.copy.read):  # it is a part of the run
            draw_contact_sheet(open_run(folder))
    print_summary(loaded, result, sheet)


@contextmanager
def _interruptible(kept: str) -> Iterator[None]:
    """End the command after Ctrl-C, and say where the finished part is."""
    try:
        yield
    except KeyboardInterrupt:
        say(f"\nmodsim3d: interrupted; what was finished is kept: {kept}", err=True)
        raise typer.Exit(INTERRUPTED) from None
