"""The commands `modsim3d view`: films, pictures and maps of a run, from its directory alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn

if TYPE_CHECKING:
    from modsim3d.core.written_files import OutputFiles
    from modsim3d.runs.stored_run import StoredRun

MIN_WIDTH_PX, MAX_WIDTH_PX = 160, 8192
FilmKind = Literal["detections", "scene", "ids", "corners", "map", "all", "plan"]
FrameKind = Literal["detections", "scene", "ids", "corners", "all", "plan", "id_buffer"]
FilmFormat = Literal["mp4", "gif", "png"]
CamerasOption = Annotated[
    list[str] | None, option("NAME", "Camera to draw; repeatable.", "--camera", show_default="all cameras")
]
LayersOption = Annotated[
    str | None,
    option(
        "NAME,...", "Layers to draw over the image or on the map (docs/pictures.md).", show_default="those of the kind"
    ),
]
LookOption = Annotated[
    str | None,
    option(
        "LOOK,...",
        "How vessels and sea look: shaded or plain; clear, overcast, rain; dusk, night; fog:M, with the visibility in "
        "metres. It changes no detection.",
        "--look",
        show_default="shaded for scene, in the state's weather; plain for detections",
    ),
]
CropOption = Annotated[
    str | None,
    option(
        "X0,Y0,X1,Y1|vessels|none",
        "Part of the image to draw, in pixels, or vessels: where vessels are, or none: all of it.",
        show_default="vessels; none for scene and corners",
    ),
]
WidthOption = Annotated[
    int | None,
    option(
        "PX",
        "Width of what is drawn, in pixels.",
        min=MIN_WIDTH_PX,
        max=MAX_WIDTH_PX,
        show_default="1280; several side by side: 1920",
    ),
]
OutOption = Annotated[Path | None, option("FILE", "File to write.", show_default="in the run directory")]


# ---- `modsim3d view film` ----


def view_film_command(
    context: typer.Context,
    run: shared.RunArgument,
    kind: Annotated[
        FilmKind,
        option(
            "KIND",
            "Kind of pictures: detections, scene, ids, corners, map, all: the first three, plan: detections and map.",
            "--kind",
        ),
    ] = "detections",
    cameras: CamerasOption = None,
    start_s: Annotated[
        float | None, option("TIME", "Time of the first step that is shown, in seconds.", "--start")
    ] = None,
    end_s: Annotated[float | None, option("TIME", "Time of the last step that is shown, in seconds.", "--end")] = None,
    every: shared.EveryOption = 1,
    only_with_vessels: Annotated[
        bool, flag("--only-with-vessels", "Leave out steps with no vessel in an image.")
    ] = False,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    layers: LayersOption = None,
    look: LookOption = None,
    crop: CropOption = None,
    width: WidthOption = None,
    format: Annotated[
        FilmFormat | None,
        option(
            "FORMAT",
            "Format to write: mp4, gif, or png for a folder of pictures.",
            "--format",
            show_default="by the name in --out, or mp4",
        ),
    ] = None,
    speed: Annotated[float, option("X", "Seconds of the run that one second of a film shows.")] = 1.0,
    workers: shared.WorkersOption = 1,
    out: OutOption = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Draw a film of a run.

    Example: modsim3d view film runs/first --kind all
    """
    from modsim3d.view.drawings import view_film

    opened = _open(run, tracks)
    with shared.interruptible("; no film was written"), shared.stoppable(), timed("film"):
        film = view_film(**shared.arguments(context, view_film, run=opened), bar=_film_bar)
    _say("film", film, 1)


@contextmanager
def _film_bar(name: str, frames: int, pace: str) -> Iterator[Callable[[int], None]]:
    shared.print_line(open_console(stderr=True), f"{name}: {pace}")
    with shared.progress("drawn", frames) as advance:
        yield advance


# ---- `modsim3d view frame`, `map` and `sheet` ----

StepArgument = argument("STEP|TIME", "Step to draw, such as 255, or time, such as 51.0 or 51s.")


def view_frame_command(
    context: typer.Context,
    run: shared.RunArgument,
    step: Annotated[str, StepArgument],
    kind: Annotated[
        FrameKind,
        option(
            "KIND",
            "Kind of picture: detections, scene, ids, corners, all: the first three, plan: detections and map, or "
            "id_buffer: the ID at each pixel of a camera, as a PNG of 16 bits or, by --out, as .npy.",
            "--kind",
        ),
    ] = "detections",
    cameras: CamerasOption = None,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    layers: LayersOption = None,
    look: LookOption = None,
    crop: CropOption = None,
    width: WidthOption = None,
    out: OutOption = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Draw one time step of a run as a PNG.

    Example: modsim3d view frame runs/first 51s
    """
    from modsim3d.view.drawings import view_frame

    opened = _open(run, tracks)
    with timed("picture"):
        picture = view_frame(**shared.arguments(context, view_frame, run=opened))
    what, aligned = ("ID buffer", 1) if kind == "id_buffer" else ("picture", 0)
    _say(what, picture, aligned)


def view_map_command(
    context: typer.Context,
    run: shared.RunArgument,
    step: Annotated[str | None, StepArgument] = None,
    cameras: CamerasOption = None,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    layers: LayersOption = None,
    width: WidthOption = None,
    out: OutOption = None,
    overwrite: shared.OverwriteOption = False,
) -> None:
    """Draw the scene of a run from above, as PNG, SVG or PDF, at its last step unless another is given.

    Example: modsim3d view map runs/first 51s --layers vectors,cpa,detections,nm --out map.svg
    """
    from modsim3d.view.drawings import view_map

    opened = _open(run, tracks)
    with timed("map"):
        _say("map", view_map(**shared.arguments(context, view_map, run=opened)))


def view_sheet_command(run: shared.RunArgument, overwrite: shared.OverwriteOption = False) -> None:
    """Draw contact_sheet.png of a finished run again.

    Example: modsim3d view sheet runs/first --overwrite
    """
    from modsim3d.view.drawings import view_sheet

    opened = _open(run)
    with timed("contact sheet"):
        _say("contact sheet", view_sheet(opened, overwrite=overwrite))


# ---- What they share ----


def _open(run: Path, tracks: Path | None = None) -> StoredRun:
    """The run; which steps of an interrupted one are drawn is told."""
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.selection import span
    from modsim3d.runs.stored_run import open_run
    from modsim3d.view.followed_tracks import read_of_tracks

    opened = open_run(run)
    tell_files(read_of_run(run) + read_of_tracks(tracks))
    if not opened.finished and opened.steps:
        warn(span(opened))
    return opened


def _say(what: str, drawn: OutputFiles, aligned: int = 0) -> None:
    """Print where it is, and the notes, the first of them below the path."""
    say(f"{what}  {drawn.path}")
    for place, note in enumerate(drawn.notes):
        say(" " * len(f"{what}  ") * (place < aligned) + note)
