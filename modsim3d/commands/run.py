"""The command `modsim3d run`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.commands.progress import progress
from modsim3d.commands.run_json import run_json, tell_backend
from modsim3d.commands.run_summary import print_summary
from modsim3d.commands.shared import (
    INTERRUPTED,
    DetectorOption,
    DetectorSeedOption,
    FromOption,
    JsonOption,
    OverwriteOption,
    QuietOption,
    SceneArgument,
    SeedOption,
    SetOption,
    StateOption,
    StepsOption,
    VerboseOption,
    WorkersOption,
)
from modsim3d.commands.terminal import say, say_json, tell_files, timed
from modsim3d.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.scene.scene import Scene


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
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Run directory to write.", show_default="runs/SCENE")
    ] = None,
    overwrite: OverwriteOption = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an interrupted run in DIR.")] = False,
    seed: SeedOption = None,
    detector: DetectorOption = None,
    detector_seed: DetectorSeedOption = None,
    mode: Annotated[
        int | None,
        typer.Option(
            "--mode",
            min=0,
            max=2,
            metavar="MODE",
            help="Annotation mode, 0 to 2, in place of the scene's (README).",
        ),
    ] = None,
    source: Annotated[
        Source | None,
        typer.Option(
            "--source", metavar="SOURCE", help="Where the truth comes from: rendered, analytic or rectangles."
        ),
    ] = None,
    steps: StepsOption = None,
    render: Annotated[
        Render | None,
        typer.Option(metavar="PART", help="What is rendered: regions where vessels overlap, or full images."),
    ] = None,
    settings: SetOption = None,
    state: StateOption = None,
    state_from: FromOption = None,
    workers: WorkersOption = 1,
    no_json: Annotated[bool, typer.Option("--no-json", help="Write no annotations or detections as JSON.")] = False,
    no_sheet: Annotated[bool, typer.Option("--no-sheet", help="Draw no contact_sheet.png.")] = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
) -> None:
    """Run a scene: write truth, detections and a contact sheet into a run directory.

    Example: modsim3d run strait --out runs/first
    """
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings

    with timed("reading the scene"):
        loaded = load_scene(
            scene,
            seed=seed,
            detector=detector,
            detector_seed=detector_seed,
            steps=steps,
            mode=mode,
            source=source.value if source else None,
            render=render.value if render else None,
            settings=read_settings(settings or ()),
            state=state,
            state_from=state_from,
        )
    tell_files(loaded.copy.read)
    folder = out if out is not None else Path("runs") / loaded.name
    total = None if loaded.live else loaded.steps
    kept = f"in {folder / 'unfinished'}" if loaded.live else "go on with --resume"
    with (
        timed("truth, detections and files"),
        _with_picture(folder),
        _interruptible(kept),
        progress(loaded.name, total) as advance,
    ):
        result = run_scene(
            loaded,
            folder,
            overwrite=overwrite,
            resume=resume,
            thesis_json=not no_json,
            workers=workers,
            progress=advance,
        )
    tell_backend(folder)
    if not no_sheet:
        with timed("contact sheet"):
            _draw_sheet(folder, loaded)
    print_summary(loaded, result, sheet=not no_sheet)
    say_json(run_json("run", loaded, result, sheet=not no_sheet))


def _draw_sheet(folder: Path, scene: Scene) -> None:
    from modsim3d.outputs.claims import claimed
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet

    with claimed([folder / SHEET_FILE], overwrite=True, inputs=scene.copy.read):  # it is a part of the run
        draw_contact_sheet(open_run(folder))


@contextmanager
def _with_picture(folder: Path) -> Iterator[None]:
    """Draw what differs if the cross-check stops the run, beside the blocks that are kept, and name the picture."""
    from modsim3d.runs.files.replacing import UNFINISHED
    from modsim3d.runs.truth_check import TruthCheckError

    try:
        yield
    except TruthCheckError as error:
        from modsim3d.view.pictures.id_buffer import write_difference

        path = folder / UNFINISHED / "cross_check.png"
        if not error.masks[0].size:
            raise
        write_difference(error.masks, path)
        raise ModsimError(f"{error}\n  {path} shows the truth, what was drawn, and where they differ") from None


@contextmanager
def _interruptible(kept: str) -> Iterator[None]:
    """End the command after Ctrl-C, and say where the finished part is."""
    try:
        yield
    except KeyboardInterrupt:
        say(f"\nmodsim3d: interrupted; what was finished is kept: {kept}", err=True)
        raise typer.Exit(INTERRUPTED) from None
