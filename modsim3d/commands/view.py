"""The command `modsim3d view`: pictures and films of a run."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from modsim3d.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.film_plan import FilmPlan
    from modsim3d.selection import Selection
    from modsim3d.stored_run import StoredRun
    from modsim3d.view.render_style import RenderStyle

INTERRUPTED = 130
LEAST_WIDTH_PX, MOST_WIDTH_PX = 160, 8192


class Film(str, Enum):  # noqa: UP042 (typer shows the plain values)
    """What a film or a picture shows."""

    detections = "detections"
    scene = "scene"
    ids = "ids"
    corners = "corners"
    map = "map"
    all = "all"


class Style(str, Enum):  # noqa: UP042
    """How a scene looks."""

    shaded = "shaded"
    plain = "plain"


class Format(str, Enum):  # noqa: UP042
    """What a film is written as."""

    mp4 = "mp4"
    gif = "gif"
    png = "png"


def view_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory, finished or interrupted.")],
    film: Annotated[Film | None, typer.Option(help="What to show; all: three side by side.")] = None,
    frame: Annotated[
        str | None, typer.Option(metavar="STEP|TIME", help="One PNG in place of a film: 255, or 51.0 or 51s.")
    ] = None,
    map_: Annotated[bool, typer.Option("--map", help="The scene from above, as PNG, SVG or PDF.")] = False,
    at: Annotated[
        str | None, typer.Option(metavar="STEP|TIME", help="When, with --map.", show_default="the last step")
    ] = None,
    sheet: Annotated[bool, typer.Option("--sheet", help="Draw contact_sheet.png again.")] = False,
    camera: Annotated[list[str] | None, typer.Option(help="May be repeated.", show_default="all")] = None,
    from_: Annotated[float | None, typer.Option("--from", metavar="S", help="First time, in seconds.")] = None,
    to: Annotated[float | None, typer.Option("--to", metavar="S", help="Last time, in seconds.")] = None,
    every: Annotated[int, typer.Option(min=1, metavar="K", help="Every K-th step.")] = 1,
    only_with_vessels: Annotated[
        bool, typer.Option("--only-with-vessels", help="Leave out steps with no vessel in an image.")
    ] = False,
    layers: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Layers to draw.", show_default="those of the film")
    ] = None,
    look: Annotated[
        Style | None, typer.Option(help="Of scene and detections.", show_default="scene: shaded, detections: plain")
    ] = None,
    visibility: Annotated[
        float | None, typer.Option(metavar="M", help="Fog, in shaded pictures; for illustration only.")
    ] = None,
    night: Annotated[bool, typer.Option("--night", help="Dark, in shaded pictures; for illustration only.")] = False,
    crop: Annotated[
        str | None, typer.Option(metavar="X0,Y0,X1,Y1|vessels", help="A part of the image, or where vessels are.")
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(min=LEAST_WIDTH_PX, max=MOST_WIDTH_PX, help="Of the picture.", show_default="1280; several: 1920"),
    ] = None,
    format_: Annotated[Format | None, typer.Option("--format", show_default="by --out, or mp4")] = None,
    speed: Annotated[float, typer.Option(help="Seconds of the run in one of the film.")] = 1.0,
    workers: Annotated[int, typer.Option(min=1, help="Processes that draw; the film stays the same.")] = 1,
    out: Annotated[Path | None, typer.Option(help="The file.", show_default="in the run directory")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")] = False,
) -> None:
    """Draw a film or a picture of a run, from its directory alone.

    Example: modsim3d view runs/simulation_1 --film detections --crop vessels
    """
    from modsim3d.stored_run import open_run

    if film is None and frame is None and not sheet and not map_:
        raise ModsimError("what is to be drawn? --film detections, --frame 255, --map or --sheet")
    if at is not None and not map_:
        raise ModsimError(f"--at {at} is for --map; one picture of a camera's image is --frame {at}")
    if map_ and (film is not None or frame is not None):
        raise ModsimError("--map is a picture of its own, with --at TIME; a film of maps is --film map")
    looks = _look(film, look, visibility, night)
    opened = open_run(run)
    if sheet:
        _draw_sheet(opened, overwrite)
    if film is None and frame is None and not map_:
        return
    from modsim3d.selection import find_step, select, select_cameras

    cameras = select_cameras(opened, camera or [])
    if map_:
        _draw_map(opened, cameras, at, width, out, overwrite)
        return
    if frame is not None:
        from modsim3d.selection import times_of

        time = float(times_of(opened)[find_step(opened, frame)])
        selection = select(opened, cameras, from_s=time, to_s=time)
    else:
        selection = select(opened, cameras, from_s=from_, to_s=to, every=every, only_with_vessels=only_with_vessels)
    if not opened.finished:
        from modsim3d.selection import span

        typer.echo(f"modsim3d: {span(opened)}", err=True)
    kind = film or Film.detections
    plan = _plan(selection, kind, layers, crop, width, *looks)
    if frame is not None:
        _draw_picture(selection, plan, kind, out, overwrite)
    else:
        _draw_film(selection, plan, kind, format_, speed, workers, out, overwrite)


def _look(film: Film | None, style: Style | None, visibility: float | None, night: bool) -> tuple[RenderStyle, bool]:
    """How scenes look, and whether boxes are drawn on such pictures too."""
    from modsim3d.errors import RendererError
    from modsim3d.render.context import choose_backend
    from modsim3d.view.render_style import PLAIN_STYLE, RenderStyle

    weather = visibility is not None or night
    asked = style is Style.shaded or (weather and style is None)
    if (weather or style is not None) and film not in (None, Film.scene, Film.detections, Film.all):
        raise ModsimError(
            f"--film {film.value} has no look: --look, --visibility and --night are for scene, detections, all"
        )
    look = RenderStyle(style is not Style.plain, visibility, night)
    if look.shaded and (asked or film in (Film.scene, Film.all)):
        try:
            choose_backend()
        except RendererError as error:
            if asked:
                raise RendererError(f"shaded pictures need OpenGL, --look plain does not: {error}") from error
            return PLAIN_STYLE, False
    # Without being asked for, boxes stay on the plain style, in which they are seen best.
    return (look if asked or film in (Film.scene, Film.all) else PLAIN_STYLE), asked


def _draw_map(
    run: StoredRun, cameras: tuple[int, ...], at: str | None, width: int | None, out: Path | None, overwrite: bool
) -> None:
    from modsim3d.film_plan import WIDTH_PX
    from modsim3d.selection import find_step, span, times_of
    from modsim3d.view.birds_eye import BirdsEye
    from modsim3d.view.map_picture import FORMATS, check_matplotlib, save_map

    step = len(times_of(run)) - 1 if at is None else find_step(run, at)
    path = out or run.folder / f"map_{step:06d}.png"
    if path.suffix.lower() not in FORMATS:
        raise ModsimError(f"{path}: a map is written as {', '.join(FORMATS)}; its name must end so")
    check_matplotlib()
    _check_free(path, overwrite)
    if not run.finished:
        typer.echo(f"modsim3d: {span(run)}", err=True)
    typer.echo(f"map  {save_map(BirdsEye(run.scene, run.steps, cameras), step, path, width or WIDTH_PX)}")


def _plan(
    selection: Selection,
    film: Film,
    layers: str | None,
    crop: str | None,
    width: int | None,
    look: RenderStyle,
    boxes_on_scene: bool,
) -> FilmPlan:
    from modsim3d.film_plan import ALL, SEVERAL_WIDTH_PX, WIDTH_PX, FilmPlan, crop_to_vessels, parse_crop
    from modsim3d.view.layers import Layers

    kinds = ALL if film is Film.all else (film.value,)
    several = film is not Film.map and (len(kinds) > 1 or len(selection.cameras) > 1)
    wide = width or (SEVERAL_WIDTH_PX if several else WIDTH_PX)
    if wide % 2:
        raise ModsimError(f"--width {wide}: films have an even width: {wide - 1} or {wide + 1}")
    chosen = Layers.of(name.strip() for name in layers.split(",")) if layers is not None else None
    crops = crop_to_vessels(selection) if crop == "vessels" else parse_crop(selection, crop) if crop else ()
    if film is Film.map:
        from modsim3d.view.map_picture import check_matplotlib

        check_matplotlib()
    return FilmPlan(kinds, selection.cameras, wide, chosen, crops, look, boxes_on_scene, selection.run.steps)


def _draw_sheet(run: StoredRun, overwrite: bool) -> None:
    from modsim3d.draw_run import SHEET_FILE, draw_contact_sheet

    if not run.finished:
        raise ModsimError(
            f"{run.folder} holds an interrupted run: a contact sheet needs a finished one (go on with "
            f"modsim3d run --resume); --film and --frame draw the {run.steps} steps that are there"
        )
    _check_free(run.folder / SHEET_FILE, overwrite)
    typer.echo(f"contact sheet  {draw_contact_sheet(run.scene, run.folder)}")


def _draw_picture(selection: Selection, plan: FilmPlan, film: Film, out: Path | None, overwrite: bool) -> None:
    from modsim3d.draw_film import draw_picture

    path = out or selection.run.folder / f"{film.value}_{selection.steps[0]:06d}.png"
    if path.suffix.lower() != ".png":
        raise ModsimError(f"{path}: a picture is written as PNG; its name must end in .png")
    _check_free(path, overwrite)
    typer.echo(f"picture  {draw_picture(selection, plan, path)}")


def _draw_film(
    selection: Selection,
    plan: FilmPlan,
    film: Film,
    format_: Format | None,
    speed: float,
    workers: int,
    out: Path | None,
    overwrite: bool,
) -> None:
    from modsim3d.draw_film import draw_film
    from modsim3d.progress import progress_bar
    from modsim3d.view.film_files import check_encoder

    if not 0 < speed < float("inf"):
        raise ModsimError(f"--speed {speed:g}: a positive number is needed, such as 4 for four times as fast")
    kind = _format(format_, out)
    check_encoder(kind)
    path = out or selection.run.folder / (film.value if kind == "png" else f"{film.value}.{kind}")
    _check_free(path, overwrite, folder=kind == "png")
    try:
        with progress_bar() as bar:
            task = bar.add_task(path.name, total=len(selection.steps))
            drawn = draw_film(
                selection,
                plan,
                kind,
                path,
                speed=speed,
                workers=workers,
                progress=lambda frames: bar.update(task, advance=frames, refresh=True),
            )
            bar.update(task, total=drawn.frames, refresh=True)
    except KeyboardInterrupt:
        typer.echo("\nmodsim3d: interrupted; no film was written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    pace = ""
    if kind != "png":
        pace = f", {drawn.timetable.duration_s:.1f} s at {float(drawn.timetable.rate):g} pictures/s"
    typer.echo(f"film  {drawn.path}\n      {drawn.size[0]} × {drawn.size[1]} px, {drawn.frames} frames{pace}")


def _format(format_: Format | None, out: Path | None) -> str:
    """What is asked for, or what the file's name says."""
    ending = out.suffix.lower().removeprefix(".") if out is not None else ""
    kinds = [entry.value for entry in Format]
    if format_ is None:
        if ending and ending not in ("mp4", "gif"):
            raise ModsimError(f"{out}: no film ends in .{ending}; use .mp4, .gif, or --format png and a folder")
        return ending or "mp4"
    if ending in kinds and ending != format_.value:
        raise ModsimError(f"{out} and --format {format_.value} say different things")
    return format_.value


def _check_free(path: Path, overwrite: bool, *, folder: bool = False) -> None:
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
    if folder and path.is_dir():
        strange = [entry.name for entry in path.iterdir() if not entry.match("frame_*.png")]
        if strange:
            raise ModsimError(f"{path} holds other things than frames of a film ({strange[0]}): choose another folder")
        if not any(path.iterdir()):
            return
    elif path.is_dir() or (folder and path.exists()):
        raise ModsimError(f"{path} is {'a folder' if path.is_dir() else 'a file'}: choose another name with --out")
    if path.exists() and not overwrite:
        raise ModsimError(f"{path} exists: use --overwrite, or another name with --out")
