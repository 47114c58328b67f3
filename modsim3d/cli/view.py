"""The command `modsim3d view`: pictures and films of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from modsim3d.cli import view_options as options
from modsim3d.cli.shared import (
    INTERRUPTED,
    OverwriteOption,
    QuietOption,
    RunArgument,
    ScaleOption,
    SimilarityOption,
    Stopped,
    ThresholdOption,
    TracksOption,
    VerboseOption,
    WorkersOption,
    opened_tracks,
    out_file,
    print_line,
    read_of_tracks,
    stoppable,
)
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn
from modsim3d.cli.view_options import Film, Style, claimed_file, claimed_folder, film_format
from modsim3d.core.errors import ModsimError, RendererError

if TYPE_CHECKING:
    from modsim3d.io.processes import WorkerCount
    from modsim3d.runs.selection import Selection
    from modsim3d.runs.stored_run import StoredRun
    from modsim3d.view.films.plan import FilmPlan
    from modsim3d.view.followed_tracks import FollowedTracks
    from modsim3d.view.sea_and_sky import RenderStyle


def view_command(
    run: RunArgument,
    film: options.FilmOption = None,
    frame: options.Frame = None,
    map_: options.Map = False,
    at: options.At = None,
    sheet: options.Sheet = False,
    ids: options.IdBuffer = False,
    camera: options.Cameras = None,
    from_: options.From = None,
    to: options.To = None,
    every: options.Every = 1,
    only_with_vessels: options.OnlyWithVessels = False,
    tracks: TracksOption = None,
    similarity: SimilarityOption = None,
    scale: ScaleOption = None,
    threshold: ThresholdOption = None,
    layers: options.LayerNames = None,
    look: options.Look = None,
    visibility: options.Visibility = None,
    night: options.Night = False,
    crop: options.Crop = None,
    width: options.Width = None,
    format_: options.FormatOption = None,
    speed: options.Speed = 1.0,
    workers: WorkersOption = 1,
    out: options.Out = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Draw a film or a picture of a run, from its directory alone.

    Example: modsim3d view runs/first --film detections --crop vessels
    """
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.selection import select_cameras
    from modsim3d.runs.stored_run import open_run

    _check_task(film, frame, map_, at, sheet, ids)
    _check_tracks(tracks, film, frame)
    style, boxes_on_scene = _style(film, look, visibility, night)
    opened = open_run(run)
    tell_files(read_of_run(run) + read_of_tracks(tracks))
    followed = opened_tracks(tracks, opened, similarity, scale, threshold)
    if sheet:
        _draw_sheet(opened, overwrite)
    cameras = select_cameras(opened, camera or [])
    if map_:
        _draw_map(opened, cameras, at, width, out, overwrite)
    if ids and frame is not None:
        _write_ids(opened, cameras, frame, out, overwrite)
        return
    if film is None and frame is None:
        return
    selection = _select(opened, cameras, frame, from_, to, every, only_with_vessels)
    _say_what_there_is(opened)
    kind = film or Film.detections
    plan = _plan(selection, kind, layers, crop, width, style, boxes_on_scene, followed)
    if frame is not None:
        _draw_picture(selection, plan, kind, out, overwrite)
    else:
        _draw_film(selection, plan, kind, film_format(format_, out), speed, workers, out, overwrite)
    if followed is not None:
        say(followed.sentence())


def _check_task(film: Film | None, frame: str | None, map_: bool, at: str | None, sheet: bool, ids: bool) -> None:
    """Check that the options ask for something, and for one thing only."""
    if film is None and frame is None and not sheet and not map_:
        raise ModsimError("nothing to draw: give --film detections, --frame 255, --map or --sheet")
    if ids and (frame is None or film is not None or map_):
        raise ModsimError("--ids writes one ID buffer: give --frame 255 too, and neither --film nor --map")
    if at is not None and not map_:
        raise ModsimError(f"--at works with --map only; for one picture of a camera's image use --frame {at}")
    if map_ and (film is not None or frame is not None):
        raise ModsimError("--map draws one picture, at the time of --at; for a film of maps use --film map")


def _check_tracks(tracks: Path | None, film: Film | None, frame: str | None) -> None:
    """Check that tracks are drawn: in pictures with detections."""
    if tracks is None:
        return
    if film is None and frame is None:
        raise ModsimError("--tracks works with --film detections and all, and with --frame")
    if film not in (None, Film.detections, Film.all):
        raise ModsimError(f"--tracks works with --film detections and all, not with {film.value}")


def _select(
    run: StoredRun,
    cameras: tuple[int, ...],
    frame: str | None,
    from_s: float | None,
    to_s: float | None,
    every: int,
    only_with_vessels: bool,
) -> Selection:
    """The step of `--frame`, or else those of the options of a film."""
    from modsim3d.runs.selection import find_step, select, times_of

    if frame is None:
        return select(run, cameras, from_s=from_s, to_s=to_s, every=every, only_with_vessels=only_with_vessels)
    time_s = float(times_of(run)[find_step(run, frame)])
    return select(run, cameras, from_s=time_s, to_s=time_s)


def _say_what_there_is(run: StoredRun) -> None:
    """Tell which steps of an interrupted run are drawn."""
    if not run.finished:
        from modsim3d.runs.selection import span

        warn(span(run))


def _style(film: Film | None, look: Style | None, visibility: float | None, night: bool) -> tuple[RenderStyle, bool]:
    """How scenes look, and whether boxes are drawn on such pictures too."""
    from modsim3d.render.context import open_context
    from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

    weather = visibility is not None or night
    if (weather or look is not None) and film not in (None, Film.scene, Film.detections, Film.all):
        raise ModsimError(
            f"--look, --visibility and --night work with --film scene, detections and all, not with {film.value}"
        )
    style = RenderStyle(look is not Style.plain, visibility, night)
    boxes_on_scene = look is Style.shaded or weather
    # Unless shaded pictures are asked for, boxes stay on the plain style, in which they are seen best.
    if not style.shaded or not (boxes_on_scene or film in (Film.scene, Film.all)):
        return PLAIN_STYLE, False
    try:
        with open_context():  # a library may have no driver
            pass
    except RendererError as error:
        if boxes_on_scene:
            raise RendererError(f"shaded pictures need OpenGL; use --look plain without it: {error}") from error
        return PLAIN_STYLE, False
    return style, boxes_on_scene


def _draw_map(
    run: StoredRun, cameras: tuple[int, ...], at: str | None, width: int | None, out: Path | None, overwrite: bool
) -> None:
    from modsim3d.runs.selection import find_step, times_of
    from modsim3d.view.films.plan import WIDTH_PX
    from modsim3d.view.map_marks import BirdsEye
    from modsim3d.view.map_picture import FORMATS, check_matplotlib, save_map

    step = len(times_of(run)) - 1 if at is None else find_step(run, at)
    path = out_file(out, run.folder / f"map_{step:06d}.png")
    if path.suffix.lower() not in FORMATS:
        raise ModsimError(f"{path}: the name of a map must end in {', '.join(FORMATS)}")
    check_matplotlib()
    with claimed_file(path, run, overwrite), timed("map"):
        _say_what_there_is(run)
        say(f"map  {save_map(BirdsEye(run.scene, run.steps, cameras), step, path, width or WIDTH_PX)}")


def _write_ids(run: StoredRun, cameras: tuple[int, ...], frame: str, out: Path | None, overwrite: bool) -> None:
    from modsim3d.runs.selection import find_step
    from modsim3d.view.pictures.id_buffer import write_id_buffer

    names = [run.scene.cameras[index].name for index in cameras]
    if len(names) > 1:
        raise ModsimError(f"--ids writes the buffer of one camera: give --camera {' or --camera '.join(names)}")
    step = find_step(run, frame)
    path = out_file(out, run.folder / f"id_buffer_{names[0]}_{step:06d}.png")
    if path.suffix.lower() not in (".png", ".npy"):
        raise ModsimError(f"{path}: the name of an ID buffer must end in .png or .npy")
    image = run.frame(names[0], step).id_image()
    with claimed_file(path, run, overwrite):
        write_id_buffer(image, path)
    height, width = image.ids.shape
    say(f"ID buffer  {path}\n           {width} × {height} px, 0 where nothing is")
    for number, pixels in image.counts():
        say(f"{number:>9}  {image.names[number]}: {pixels} px")


def _plan(
    selection: Selection,
    film: Film,
    layers: str | None,
    crop: str | None,
    width: int | None,
    style: RenderStyle,
    boxes_on_scene: bool,
    tracks: FollowedTracks | None,
) -> FilmPlan:
    from modsim3d.runs.counts import NOTHING_WRONG
    from modsim3d.view.films.plan import (
        ALL,
        SEVERAL_WIDTH_PX,
        WIDTH_PX,
        FilmPlan,
        crop_to_vessels,
        mistakes_in,
        parse_crop,
        vessels_in,
    )
    from modsim3d.view.pictures.layers import Layers

    kinds = ALL if film is Film.all else (film.value,)
    several = film is not Film.map and (len(kinds) > 1 or len(selection.cameras) > 1)
    wide = width or (SEVERAL_WIDTH_PX if several else WIDTH_PX)
    if wide % 2:
        raise ModsimError(f"--width {wide}: films need an even width, such as {wide - 1} or {wide + 1}")
    chosen = Layers.of(name.strip() for name in layers.split(",")) if layers is not None else None
    crops = crop_to_vessels(selection) if crop == "vessels" else parse_crop(selection, crop) if crop else ()
    if film is Film.map:
        from modsim3d.view.map_picture import check_matplotlib

        check_matplotlib()
    return FilmPlan(
        kinds,
        selection.cameras,
        wide,
        chosen,
        crops,
        style,
        boxes_on_scene,
        selection.run.steps,
        mistakes=mistakes_in(selection) if "detections" in kinds else NOTHING_WRONG,
        tracks=tracks,
        vessels=vessels_in(selection, crops) if set(kinds) & {"scene", "ids", "corners"} else (),
    )


def _draw_sheet(run: StoredRun, overwrite: bool) -> None:
    from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet

    if not run.finished:
        raise ModsimError(
            f"{run.folder} holds an interrupted run, and a contact sheet needs a finished one (go on with "
            f"modsim3d run --resume); --film and --frame draw the {run.steps} steps that are there"
        )
    with claimed_file(run.folder / SHEET_FILE, run, overwrite), timed("contact sheet"):
        say(f"contact sheet  {draw_contact_sheet(run)}")


def _draw_picture(selection: Selection, plan: FilmPlan, film: Film, out: Path | None, overwrite: bool) -> None:
    from modsim3d.view.films.film import draw_picture

    path = out_file(out, selection.run.folder / f"{film.value}_{selection.steps[0]:06d}.png")
    if path.suffix.lower() != ".png":
        raise ModsimError(f"{path}: the name of a picture must end in .png")
    with claimed_file(path, selection.run, overwrite), timed("picture"):
        say(f"picture  {draw_picture(selection, plan, path)}")


def _draw_film(
    selection: Selection,
    plan: FilmPlan,
    film: Film,
    kind: str,
    speed: float,
    workers: WorkerCount,
    out: Path | None,
    overwrite: bool,
) -> None:
    from modsim3d.cli.shared import progress
    from modsim3d.view.films.files import check_encoder
    from modsim3d.view.films.film import Showing, draw_film

    if not 0 < speed < float("inf"):
        raise ModsimError(f"--speed {speed:g}: give a positive number, such as 4 for four times as fast")
    check_encoder(kind)
    folder = selection.run.folder
    path = out or folder / film.value if kind == "png" else out_file(out, folder / f"{film.value}.{kind}")
    claim = (claimed_folder if kind == "png" else claimed_file)(path, selection.run, overwrite)
    showing = Showing.of(selection, kind, speed)
    pace = f"{len(showing.steps)} frames"
    if kind != "png":
        pace += f", {showing.timetable.duration_s:.1f} s at {float(showing.timetable.rate):g} pictures/s"
    try:
        with stoppable(), timed("film"), claim:
            print_line(open_console(stderr=True), f"{path.name}: {pace}")
            with progress("drawn", len(showing.steps)) as advance:
                drawn = draw_film(selection, plan, kind, path, speed=speed, workers=workers, progress=advance)
    except KeyboardInterrupt as stop:
        say("\nmodsim3d: interrupted; no film was written", err=True)
        raise typer.Exit(stop.status if isinstance(stop, Stopped) else INTERRUPTED) from None
    say(f"film  {drawn.path}\n      {drawn.size[0]} × {drawn.size[1]} px, {pace}")
