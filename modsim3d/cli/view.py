"""The commands `modsim3d view`: films, pictures and maps of a run, from its directory alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from modsim3d.cli import shared
from modsim3d.cli.shared import argument, flag, option
from modsim3d.cli.terminal import open_console, say, tell_files, timed, warn
from modsim3d.core.errors import ModsimError
from modsim3d.io.overwrite_guard import check_not_read, claimed, locked_file
from modsim3d.runs.files.overwrite import read_of_run

if TYPE_CHECKING:
    from modsim3d.io.processes import WorkerCount
    from modsim3d.runs.selection import Selection
    from modsim3d.runs.stored_run import StoredRun
    from modsim3d.view.films.plan import FilmPlan
    from modsim3d.view.films.request import PictureRequest

MIN_WIDTH_PX, MAX_WIDTH_PX = 160, 8192
FRAME_FILES = "frame_*.png"
FilmKind = Literal["detections", "scene", "ids", "corners", "map", "all"]
FrameKind = Literal["detections", "scene", "ids", "corners", "all", "id_buffer"]
FilmFormat = Literal["mp4", "gif", "png"]
CamerasOption = Annotated[
    list[str] | None, option("NAME", "Camera to draw; repeatable.", "--camera", show_default="all cameras")
]
LayersOption = Annotated[
    str | None,
    option("NAME,...", "Layers to draw over the image (docs/pictures.md).", show_default="those of the kind"),
]
LookOption = Annotated[
    str | None,
    option(
        "LOOK,...",
        "How vessels and sea look: shaded or plain; night; fog:M, with the visibility in metres. It changes no "
        "detection.",
        "--look",
        show_default="shaded for scene, plain for detections",
    ),
]
CropOption = Annotated[
    str | None, option("X0,Y0,X1,Y1|vessels", "Part of the image to draw, in pixels, or vessels: where vessels are.")
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
    run: shared.RunArgument,
    kind: Annotated[
        FilmKind,
        option("KIND", "Kind of pictures: detections, scene, ids, corners, map, or all: three side by side.", "--kind"),
    ] = "detections",
    camera: CamerasOption = None,
    start: Annotated[float | None, option("TIME", "Time of the first step that is shown, in seconds.")] = None,
    end: Annotated[float | None, option("TIME", "Time of the last step that is shown, in seconds.")] = None,
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
    format_: Annotated[
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
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Draw a film of a run.

    Example: modsim3d view film runs/first --crop vessels
    """
    from modsim3d.runs.selection import select, select_cameras

    if not 0 < speed < float("inf"):
        raise ModsimError(f"--speed {speed:g}: give a positive number, such as 4 for four times as fast")
    request = _request(kind, layers, crop, width, look, tracks)
    file_format = _film_format(format_, out)
    opened = _opened(run, tracks)
    followed = shared.opened_tracks(tracks, opened, similarity, threshold)
    selection = select(
        opened,
        select_cameras(opened, camera or []),
        from_s=start,
        to_s=end,
        every=every,
        only_with_vessels=only_with_vessels,
    )
    _say_what_there_is(opened)
    _draw_film(selection, request.plan(selection, followed), request.kind, file_format, speed, workers, out, overwrite)
    if followed is not None:
        say(followed.sentence())


def _film_format(option: FilmFormat | None, out: Path | None) -> str:
    """The format that `--format` asks for, or the ending of the file's name. Raises ModsimError if the two differ, or
    no film has such an ending."""
    ending = "" if out is None or out.is_dir() else out.suffix.lower().removeprefix(".")
    if option is None:
        if ending and ending not in ("mp4", "gif"):
            raise ModsimError(
                f"{out}: films cannot be written as .{ending}; use .mp4, .gif, or --format png with a folder"
            )
        return ending or "mp4"
    if ending in get_args(FilmFormat) and ending != option:
        raise ModsimError(f"the ending of {out} contradicts --format {option}")
    return option


def _draw_film(
    selection: Selection,
    plan: FilmPlan,
    name: str,
    kind: str,
    speed: float,
    workers: WorkerCount,
    out: Path | None,
    overwrite: bool,
) -> None:
    from modsim3d.view.films.files import check_encoder
    from modsim3d.view.films.film import Showing, draw_film

    check_encoder(kind)
    folder = selection.run.folder
    path = out or folder / name if kind == "png" else shared.out_file(out, folder / f"{name}.{kind}")
    claim = (_claimed_folder if kind == "png" else _claimed_file)(path, selection.run, overwrite)
    showing = Showing.of(selection, kind, speed)
    pace = f"{len(showing.steps)} frames"
    if kind != "png":
        pace += f", {showing.timetable.duration_s:.1f} s at {float(showing.timetable.rate):g} pictures/s"
    with shared.interruptible("; no film was written"), shared.stoppable(), timed("film"), claim:
        shared.print_line(open_console(stderr=True), f"{path.name}: {pace}")
        with shared.progress("drawn", len(showing.steps)) as advance:
            drawn = draw_film(selection, plan, kind, path, speed=speed, workers=workers, progress=advance)
    say(f"film  {drawn.path}\n      {drawn.size[0]} × {drawn.size[1]} px, {pace}")


# ---- `modsim3d view frame`, `map` and `sheet` ----

StepArgument = argument("STEP|TIME", "Step to draw, such as 255, or time, such as 51.0 or 51s.")


def view_frame_command(
    run: shared.RunArgument,
    step: Annotated[str, StepArgument],
    kind: Annotated[
        FrameKind,
        option(
            "KIND",
            "Kind of picture: detections, scene, ids, corners, all: three side by side, or id_buffer: the ID at "
            "each pixel of a camera, as a PNG of 16 bits or, by --out, as .npy.",
            "--kind",
        ),
    ] = "detections",
    camera: CamerasOption = None,
    tracks: shared.TracksOption = None,
    similarity: shared.SimilarityOption = None,
    threshold: shared.ThresholdOption = None,
    layers: LayersOption = None,
    look: LookOption = None,
    crop: CropOption = None,
    width: WidthOption = None,
    out: OutOption = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Draw one time step of a run as a PNG.

    Example: modsim3d view frame runs/first 51s --crop vessels
    """
    from modsim3d.runs.selection import find_step, select, select_cameras, times_of

    request = _request(kind, layers, crop, width, look, tracks)
    opened = _opened(run, tracks)
    followed = shared.opened_tracks(tracks, opened, similarity, threshold)
    cameras = select_cameras(opened, camera or [])
    if kind == "id_buffer":
        _write_id_buffer(opened, cameras, step, out, overwrite)
        return
    time_s = float(times_of(opened)[find_step(opened, step)])
    selection = select(opened, cameras, from_s=time_s, to_s=time_s)
    _say_what_there_is(opened)
    _draw_picture(selection, request.plan(selection, followed), request.kind, out, overwrite)
    if followed is not None:
        say(followed.sentence())


def view_map_command(
    run: shared.RunArgument,
    step: Annotated[str | None, StepArgument] = None,
    camera: CamerasOption = None,
    width: WidthOption = None,
    out: OutOption = None,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Draw the scene of a run from above, as PNG, SVG or PDF, at its last step unless another is given.

    Example: modsim3d view map runs/first 51s --out map.svg
    """
    from modsim3d.runs.selection import find_step, select_cameras, times_of
    from modsim3d.view.films.plan import WIDTH_PX
    from modsim3d.view.map_marks import BirdsEye
    from modsim3d.view.map_picture import check_map, save_map

    opened = _opened(run, None)
    cameras = select_cameras(opened, camera or [])
    shown = len(times_of(opened)) - 1 if step is None else find_step(opened, step)
    path = shared.out_file(out, opened.folder / f"map_{shown:06d}.png")
    check_map(path)
    with _claimed_file(path, opened, overwrite), timed("map"):
        _say_what_there_is(opened)
        say(f"map  {save_map(BirdsEye(opened.scene, opened.steps, cameras), shown, path, width or WIDTH_PX)}")


def view_sheet_command(
    run: shared.RunArgument,
    overwrite: shared.OverwriteOption = False,
    quiet: shared.QuietOption = False,
    verbose: shared.VerboseOption = False,
) -> None:
    """Draw contact_sheet.png of a finished run again.

    Example: modsim3d view sheet runs/first --overwrite
    """
    from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet

    opened = _opened(run, None)
    if not opened.finished:
        raise ModsimError(
            f"{opened.folder} holds an interrupted run, and a contact sheet needs a finished one (go on with modsim3d "
            f"run --resume); modsim3d view film and view frame draw the {opened.steps} steps that are there"
        )
    with _claimed_file(opened.folder / SHEET_FILE, opened, overwrite), timed("contact sheet"):
        say(f"contact sheet  {draw_contact_sheet(opened)}")


def _write_id_buffer(run: StoredRun, cameras: tuple[int, ...], at: str, out: Path | None, overwrite: bool) -> None:
    from modsim3d.runs.selection import find_step
    from modsim3d.view.pictures.id_buffer import write_id_buffer

    names = [run.scene.cameras[index].name for index in cameras]
    if len(names) > 1:
        raise ModsimError(f"--kind id_buffer needs one camera: give --camera {' or --camera '.join(names)}")
    step = find_step(run, at)
    path = shared.out_file(out, run.folder / f"id_buffer_{names[0]}_{step:06d}.png")
    if path.suffix.lower() not in (".png", ".npy"):
        raise ModsimError(f"{path}: the name of an ID buffer must end in .png or .npy")
    image = run.frame(names[0], step).id_image()
    with _claimed_file(path, run, overwrite):
        write_id_buffer(image, path)
    height, width = image.ids.shape
    say(f"ID buffer  {path}\n           {width} × {height} px, 0 where nothing is")
    for number, pixels in image.counts():
        say(f"{number:>9}  {image.names[number]}: {pixels} px")


def _draw_picture(selection: Selection, plan: FilmPlan, name: str, out: Path | None, overwrite: bool) -> None:
    from modsim3d.view.films.film import draw_picture

    path = shared.out_file(out, selection.run.folder / f"{name}_{selection.steps[0]:06d}.png")
    if path.suffix.lower() != ".png":
        raise ModsimError(f"{path}: the name of a picture must end in .png")
    with _claimed_file(path, selection.run, overwrite), timed("picture"):
        say(f"picture  {draw_picture(selection, plan, path)}")


# ---- What they share ----


def _request(
    kind: str, layers: str | None, crop: str | None, width: int | None, look: str | None, tracks: Path | None
) -> PictureRequest:
    from modsim3d.view.films.request import Look, PictureRequest

    names = None if layers is None else tuple(name.strip() for name in layers.split(","))
    return PictureRequest(kind, names, crop, width, Look() if look is None else Look.parse(look), tracks is not None)


def _opened(run: Path, tracks: Path | None) -> StoredRun:
    from modsim3d.runs.stored_run import open_run

    opened = open_run(run)
    tell_files(read_of_run(run) + shared.read_of_tracks(tracks))
    return opened


def _say_what_there_is(run: StoredRun) -> None:
    """Tell which steps of an interrupted run are drawn."""
    if not run.finished:
        from modsim3d.runs.selection import span

        warn(span(run))


@contextmanager
def _claimed_file(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that a picture or a film of a run can be written to a file, and hold its lock. Raises ModsimError if its
    folder is missing, or it may not be written; see `claimed`."""
    _check_parent(path)
    with claimed([path], overwrite=overwrite, inputs=read_of_run(run.folder)):
        yield


@contextmanager
def _claimed_folder(path: Path, run: StoredRun, overwrite: bool) -> Iterator[None]:
    """Check that the PNG files of a film of a run can be written to a folder, and hold its lock. Raises ModsimError if
    it is a file, holds other files than a film's, or holds a film that is not to be overwritten."""
    _check_parent(path)
    check_not_read(path, read_of_run(run.folder))
    _check_free_folder(path, overwrite)
    with locked_file(path):
        _check_free_folder(path, overwrite)  # another process may have ended just now
        yield


def _check_free_folder(path: Path, overwrite: bool) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise ModsimError(f"{path} is a file: choose another name with --out")
    entries = list(path.iterdir())
    strange = [entry.name for entry in entries if not entry.match(FRAME_FILES)]
    if strange:
        raise ModsimError(f"{path} holds other files than frames of a film ({strange[0]}): choose another folder")
    if entries and not overwrite:
        raise ModsimError(f"{path} exists: use --overwrite, or another name with --out")


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
