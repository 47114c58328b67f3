"""The commands `modsim3d run` and `modsim3d scenes`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from modsim3d.cli import run_summary, shared
from modsim3d.cli.shared import flag, option
from modsim3d.cli.terminal import open_console, say_json, tell, tell_files, timed, warn
from modsim3d.cli.terminal_tables import print_prose, print_table
from modsim3d.core.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.formats.detect_truth import TruthResult
    from modsim3d.runs.run import RunResult
    from modsim3d.scene.scene import Scene

# ---- What `modsim3d detect --truth` prints ----

MAX_SEQUENCES = 50  # more are in `detect.json` alone


def print_truth_summary(result: TruthResult) -> None:
    """Print what happened, what was left out, and where the files are."""
    console = open_console()
    print_table(console, "", _rows(result), right=(1,), styles=("bold", "", "dim"))
    if 1 < len(result.sequence_counts) <= MAX_SEQUENCES:
        rows = [run_summary.camera_row(name, counts) for name, counts in result.sequence_counts.items()]
        header = ("sequence", *run_summary.CAMERA_HEADER[1:])
        console.print()
        print_table(console, "", rows, header=header, right=range(1, len(header)))
    shared.print_line(console, "")
    for note in result.notes:
        print_prose(console, f"Note: {note}.")
    if result.notes:
        shared.print_line(console, "")
    shared.print_path(console, "folder", result.folder)
    for warning in truth_warnings(result):
        warn(warning)


def _rows(result: TruthResult) -> list[run_summary.Row]:
    counts, sequences = result.counts, len(result.sequence_counts)
    many = f"{sequences} sequence{'s' if sequences > 1 else ''}, from {result.kind}"
    return [
        ("frames", str(counts.frames), many),
        *run_summary.vessel_rows(counts),
        *run_summary.detection_rows(counts),
        *run_summary.gate_rows(counts),
    ]


def truth_warnings(result: TruthResult) -> list[str]:
    """Warnings to read before using the files, each a sentence."""
    nothing = "no box of the truth is to be detected: there are only false positives"
    return [nothing] * (not result.counts.annotated) + run_summary.iou_warnings(result.counts)


# ---- What `modsim3d run --json` and `modsim3d detect --json` say of a finished run ----

FORMAT = 1


def run_json(command: str, scene: Scene, result: RunResult, sheet: bool) -> dict[str, Any]:
    """The result of a run; whatever `RunResult` and `Counts` have is in it."""
    return {
        "format": FORMAT,
        "command": command,
        "scene": scene.name,
        "cameras": [camera.name for camera in scene.cameras],
        "mode": scene.annotation.mode,
        "traffic_seed": scene.traffic_seed,
        "counts": asdict(result.counts),
        **asdict(result),
        "iou": result.iou._asdict(),
        "contact_sheet": result.folder / "contact_sheet.png" if sheet else None,
        "warnings": run_summary.run_warnings(scene, result),
    }


def truth_json(result: TruthResult) -> dict[str, Any]:
    """The result of `detect --truth`."""
    return {
        "format": FORMAT,
        "command": "detect",
        "folder": result.folder,
        "kind": result.kind,
        "counts": asdict(result.counts),
        "sequence_counts": {name: asdict(counts) for name, counts in result.sequence_counts.items()},
        "occlusion": result.occlusion,
        "notes": result.notes,
        "warnings": truth_warnings(result),
        "seconds": result.seconds,
        "written": result.files,
    }


def run_command(
    context: typer.Context,
    scene: shared.SceneArgument,
    out: Annotated[Path | None, option("DIR", "Run directory to write.", show_default="runs/SCENE")] = None,
    overwrite: shared.OverwriteOption = False,
    resume: Annotated[bool, flag("--resume", "Go on with an interrupted run in DIR.")] = False,
    seed: shared.SeedOption = None,
    detector: shared.DetectorOption = None,
    detector_seed: shared.DetectorSeedOption = None,
    mode: Annotated[
        int | None, option("MODE", "Annotation mode, 0 to 2, in place of the scene's (README).", "--mode", min=0, max=2)
    ] = None,
    source: Annotated[
        Literal["rendered", "analytic", "rectangles"] | None,
        option("SOURCE", "Where the truth comes from: rendered, analytic or rectangles.", "--source"),
    ] = None,
    steps: shared.StepsOption = None,
    settings: shared.SetOption = None,
    state: shared.StateOption = None,
    state_from: shared.FromOption = None,
    workers: shared.WorkersOption = 1,
    no_json: Annotated[bool, flag("--no-json", "Write no annotations or detections as JSON.")] = False,
    no_sheet: Annotated[bool, flag("--no-sheet", "Draw no contact_sheet.png.")] = False,
) -> None:
    """Run a scene: write truth, detections and a contact sheet into a run directory.

    Example: modsim3d run strait --out runs/first
    """
    from modsim3d.runs.files.overwrite import RUN_FILE, read_json
    from modsim3d.runs.run import run_scene
    from modsim3d.scene.reading import load_scene
    from modsim3d.scene.settings import read_settings

    with timed("reading the scene"):
        loaded = load_scene(**shared.arguments(context, load_scene, settings=read_settings(settings or ())))
    tell_files(loaded.copy.read)
    folder = out if out is not None else Path("runs") / loaded.name
    total = None if loaded.live else loaded.steps
    kept = f"in {folder / 'unfinished'}" if loaded.live else "go on with --resume"
    with (
        timed("truth, detections and files"),
        _with_picture(folder),
        shared.interruptible(f"; what was finished is kept: {kept}"),
        shared.progress(loaded.name, total) as advance,
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
    tell("OpenGL", str(read_json(folder / RUN_FILE)["backend"]))
    if not no_sheet:
        with timed("contact sheet"):
            _draw_sheet(folder, loaded)
    run_summary.print_summary(loaded, result, sheet=not no_sheet)
    say_json(run_json("run", loaded, result, sheet=not no_sheet))


def _draw_sheet(folder: Path, scene: Scene) -> None:
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet

    with claimed([folder / SHEET_FILE], overwrite=True, inputs=scene.copy.read):  # it is a part of the run
        draw_contact_sheet(open_run(folder))


@contextmanager
def _with_picture(folder: Path) -> Iterator[None]:
    """Draw what differs if the cross-check stops the run, beside the blocks that are kept, and name the picture."""
    from modsim3d.runs.files.overwrite import UNFINISHED
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


# ---- Scenes that can be run ----


def scenes_command() -> None:
    """List the shipped scenes, and the detection conditions for --state NAME --from conditions.

    Example: modsim3d scenes
    """
    from modsim3d.io.validation import CONDITIONS, conditions_in
    from modsim3d.scene.reading import draws_traffic, shipped_scenes

    console, entries = open_console(), []
    for name, path in shipped_scenes().items():
        with path.open(encoding="utf-8") as file:
            title = file.readline().strip("# \n")
        drawn = draws_traffic(path)
        entries.append({"name": name, "title": title, "path": path, "traffic_drawn": drawn})
        shared.print_line(console, name, "bold")
        print_prose(console, title, indent=4)
        shared.print_line(console, f"    traffic: {'drawn from the seed' if drawn else 'this traffic only'}")
        shared.print_line(console, f"    {path}", "dim")
    shared.print_line(console, f"--from {CONDITIONS}", "bold")
    print_prose(console, ", ".join(conditions_in()), indent=4)
    say_json({"format": 1, "command": "scenes", "scenes": entries, "conditions": list(conditions_in())})
