"""Films, pictures and maps of a run, each drawn into a file by one call."""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from modsim3d.core.errors import ModsimError, RunDirectoryError
from modsim3d.core.paths import StrPath, as_path, out_file
from modsim3d.core.text import counted
from modsim3d.core.written_files import OutputFiles
from modsim3d.io.overwrite_guard import claimed, claimed_folders
from modsim3d.io.processes import WorkerCount
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.selection import Selection, find_step, select, select_cameras, times_of
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.tracks.world_reading import is_world, read_world_tracks
from modsim3d.view.films.files import FORMATS, check_encoder
from modsim3d.view.films.film import ShownSteps, draw_film, draw_picture
from modsim3d.view.films.plan import WIDTH_PX, FilmPlan
from modsim3d.view.films.renderer import bearings_of
from modsim3d.view.films.request import PictureRequest, parse_look
from modsim3d.view.followed_tracks import FollowedTracks, followed_tracks
from modsim3d.view.map_marks import BirdsEye
from modsim3d.view.map_picture import check_map, save_map
from modsim3d.view.pictures.contact_sheet import SHEET_FILE, draw_contact_sheet
from modsim3d.view.pictures.id_buffer import write_id_buffer

FRAME_FILES = "frame_*.png"
MIN_WIDTH_PX, MAX_WIDTH_PX = 160, 8192
KINDS = ("detections", "scene", "ids", "corners", "map", "all", "plan")
Names = str | Sequence[str]
Bar = Callable[[str, int, str], AbstractContextManager[Callable[[int], None]]]


def view_film(
    run: StoredRun | StrPath,
    out: StrPath | None = None,
    *,
    kind: str = "detections",
    cameras: Names | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    every: int = 1,
    only_with_vessels: bool = False,
    tracks: StrPath | None = None,
    similarity: str | None = None,
    threshold: float | None = None,
    layers: Names | None = None,
    look: str | None = None,
    crop: str | Sequence[float] | None = None,
    width: int | None = None,
    format: str | None = None,
    speed: float = 1.0,
    workers: WorkerCount = 1,
    overwrite: bool = False,
    bar: Bar = lambda name, frames, pace: nullcontext(lambda frames: None),
) -> OutputFiles:
    """Draw a film of a run.

        modsim3d.view_film("runs/first", "film.gif", kind="all", speed=4)

    Args:
        run, out: A run or its directory; file to write, or folder of PNG files, by kind in the run directory if None.
        kind: `detections`, `scene`, `ids`, `corners`, `map`, `all`: the first three, or `plan`: detections and map.
        cameras: Cameras to draw; all if None.
        start_s, end_s, every: Times of the first and last step that is shown, in seconds; take every K-th step only.
        only_with_vessels: Leave out steps with no vessel in an image.
        tracks, similarity, threshold: As those of `modsim3d.report`.
        layers: Names of layers to draw over the image or on the map (docs/pictures.md); those of the kind if None.
        look, width: How vessels and sea look, such as `night,fog:800` or `plain`; width of what is drawn, in pixels.
        crop: Part of the image, x_min, y_min, x_max, y_max in pixels, `vessels`: where vessels are, or `none`: all of
            it; that of the kind if None.
        format: `mp4`, `gif`, or `png`: a folder of pictures; by the name, else `mp4`, if None.
        speed, workers: Seconds of the run in a second of the film; number of processes, or `auto`, one for each CPU.
        overwrite: Replace a film that is there.
        bar: Called with name, number of frames and pace; a context of a function called with the number newly drawn.

    Raises:
        ModsimError: The run, its tracks or an argument is wrong, a library is missing, or the film cannot be written.
        TypeError: A path is neither text nor a path.
    """
    if not 0 < speed < math.inf:
        raise ModsimError(f"--speed {speed:g}: give a positive number, such as 4 for four times as fast")
    path = None if out is None else as_path(out, "out")
    request, file_format = _request(kind, layers, crop, width, look, tracks), _film_format(format, path)
    steps = {"from_s": start_s, "to_s": end_s, "every": every, "only_with_vessels": only_with_vessels}
    selection, plan, notes = _planned(request, run, cameras, tracks, similarity, threshold, steps)
    check_encoder(file_format)
    folder, pictures = selection.run.folder, file_format == "png"
    path = path or folder / kind if pictures else out_file(path, folder / f"{kind}.{file_format}")
    claim, showing = _claimed(path, selection.run, overwrite, pictures), ShownSteps.of(selection, file_format, speed)
    with claim, bar(path.name, len(showing.steps), showing.pace) as advance:
        size = draw_film(selection, plan, file_format, path, speed=speed, workers=workers, progress=advance)
    return OutputFiles((path,), ("{} × {} px, ".format(*size) + showing.pace, *notes))


def view_frame(
    run: StoredRun | StrPath,
    step: int | float | str,
    out: StrPath | None = None,
    *,
    kind: str = "detections",
    cameras: Names | None = None,
    tracks: StrPath | None = None,
    similarity: str | None = None,
    threshold: float | None = None,
    layers: Names | None = None,
    look: str | None = None,
    crop: str | Sequence[float] | None = None,
    width: int | None = None,
    overwrite: bool = False,
) -> OutputFiles:
    """Draw one time step of a run as a PNG.

        modsim3d.view_frame("runs/first", 51.0, "moment.png")

    Args:
        run, out: A run or its directory; file to write, by kind and step in the run directory if None.
        step: Step, such as 255, or time in seconds, such as 51.0 or `51s`.
        kind: As that of `modsim3d.view_film`, as are the other arguments, but no map; or `id_buffer`: the ID at each
            pixel of a camera, as a PNG of 16 bits or as `.npy`.
        overwrite: Replace a picture that is there.

    Raises:
        ModsimError: The run, its tracks or an argument is wrong, or the picture cannot be written.
        TypeError: A path is neither text nor a path.
    """
    request = _request("detections" if kind == "id_buffer" else kind, layers, crop, width, look, tracks)
    run = opened_run(run)
    shown = find_step(run, str(step))
    if kind == "id_buffer":
        return _id_buffer(run, select_cameras(run, cameras), shown, out, overwrite)
    time_s = float(times_of(run)[shown])
    steps = {"from_s": time_s, "to_s": time_s}
    selection, plan, notes = _planned(request, run, cameras, tracks, similarity, threshold, steps)
    path = out_file(out, run.folder / f"{kind}_{selection.steps[0]:06d}.png")
    if path.suffix.lower() != ".png":
        raise ModsimError(f"{path}: the name of a picture must end in .png")
    with _claimed(path, run, overwrite):
        return OutputFiles((draw_picture(selection, plan, path),), notes)


def view_map(
    run: StoredRun | StrPath,
    step: int | float | str | None = None,
    out: StrPath | None = None,
    *,
    cameras: Names | None = None,
    tracks: StrPath | None = None,
    similarity: str | None = None,
    threshold: float | None = None,
    layers: Names | None = None,
    width: int | None = None,
    overwrite: bool = False,
) -> OutputFiles:
    """Draw the scene of a run from above, as PNG, SVG or PDF.

        modsim3d.view_map("runs/first", 51.0, "map.svg", layers=["vectors", "cpa", "nm"])

    Args:
        run, out: A run or its directory; file to write, `map_STEP.png` in the run directory if None.
        step: Step or time, as that of `modsim3d.view_frame`; the last step if None.
        cameras, tracks, similarity, threshold, layers, width: As those of `modsim3d.view_film`.
        overwrite: Replace a map that is there.

    Raises:
        ModsimError: The run or an argument is wrong, matplotlib is missing, or the map cannot be written.
        TypeError: A path is neither text nor a path.
    """
    _check_width(width)
    request, run = _request("map", layers, None, None, None, tracks), opened_run(run)
    followed, in_world, notes = _tracks(request, run, tracks, similarity, threshold)
    chosen = select_cameras(run, cameras)
    shown = len(times_of(run)) - 1 if step is None else find_step(run, str(step))
    path = out_file(out, run.folder / f"map_{shown:06d}.png")
    check_map(path)
    names = [run.scene.cameras[index].name for index in chosen]
    with _claimed(path, run, overwrite):
        seen = (frame for frame in run.frames(shown, shown + 1) if frame.camera in names)
        birds_eye = BirdsEye(run.scene, run.steps, chosen, request.map_layers, in_world)
        bearings = bearings_of(run.scene, seen, followed)
        save_map(birds_eye, shown, path, width or WIDTH_PX, bearings)
    return OutputFiles((path,), notes)


def view_sheet(run: StoredRun | StrPath, *, overwrite: bool = False) -> OutputFiles:
    """Draw `contact_sheet.png` of a finished run again.

        modsim3d.view_sheet("runs/first", overwrite=True)

    Raises:
        ModsimError: The run was interrupted, or its contact sheet is there and is not to be replaced.
        TypeError: The run is neither text nor a path.
    """
    run = opened_run(run)
    if not run.finished:
        raise RunDirectoryError(
            f"{run.folder} holds an interrupted run, and a contact sheet needs a finished one (go on with modsim3d "
            f"run --resume); modsim3d view film and view frame draw the {run.steps} steps that are there"
        )
    with _claimed(run.folder / SHEET_FILE, run, overwrite):
        return OutputFiles((draw_contact_sheet(run),))


# ---- What they share ----


def _request(
    kind: str,
    layers: Names | None,
    crop: str | Sequence[float] | None,
    width: int | None,
    look: str | None,
    tracks: StrPath | None,
) -> PictureRequest:
    if kind not in KINDS:
        raise ModsimError(f"--kind {kind}: needs one of {', '.join((*KINDS, 'id_buffer'))}")
    _check_width(width)
    names = tuple(name.strip() for name in layers.split(",")) if isinstance(layers, str) else layers
    part = crop if crop is None or isinstance(crop, str) else ",".join(f"{number:g}" for number in crop)
    return PictureRequest(kind, names, part, width, None if look is None else parse_look(look), tracks is not None)


def _check_width(width: int | None) -> None:
    if width is not None and not MIN_WIDTH_PX <= width <= MAX_WIDTH_PX:
        raise ModsimError(f"--width {width}: needs pixels from {MIN_WIDTH_PX} to {MAX_WIDTH_PX}")


def _planned(
    request: PictureRequest,
    run: StoredRun | StrPath,
    cameras: Names | None,
    tracks: StrPath | None,
    similarity: str | None,
    threshold: float | None,
    steps: dict[str, Any],
) -> tuple[Selection, FilmPlan, tuple[str, ...]]:
    """Frames to draw and how, and a sentence on the tracks; `steps` are what `select` takes."""
    run = opened_run(run)
    followed, in_world, notes = _tracks(request, run, tracks, similarity, threshold)
    selection = select(run, select_cameras(run, cameras), **steps)
    return selection, request.plan(selection, followed, in_world), notes


def _tracks(
    request: PictureRequest, run: StoredRun, tracks: StrPath | None, similarity: str | None, threshold: float | None
) -> tuple[FollowedTracks | None, WorldTracks | None, tuple[str, ...]]:
    """The tracks in the images, or those in the world, and a sentence on them."""
    if tracks is None or not is_world(tracks):
        followed = followed_tracks(tracks, run, similarity, threshold)
        return followed, None, () if followed is None else (followed.sentence(),)
    if "map" not in request.kinds:
        raise ModsimError(f"{tracks} has tracks in the world, which maps show: --kind map or plan")
    if (similarity, threshold) != (None, None):
        raise ModsimError("--similarity and --threshold are for tracks in the images: leave them out")
    in_world = read_world_tracks(tracks, run)
    count = counted(len(in_world.track_names), "track")
    return None, in_world, (f"Tracks of {in_world.name}: {count} in the world.",)


def _film_format(asked: str | None, out: Path | None) -> str:
    """The format that is asked for, or the ending of the file's name. Raises ModsimError if the two differ, or no film
    has such an ending."""
    ending = "" if out is None or out.is_dir() else out.suffix.lower().removeprefix(".")
    if asked is None:
        if ending and ending not in ("mp4", "gif"):
            right = "use .mp4, .gif, or --format png with a folder"
            raise ModsimError(f"{out}: films cannot be written as .{ending}; {right}")
        return ending or "mp4"
    if asked not in FORMATS:
        raise ModsimError(f"--format {asked}: needs one of {', '.join(FORMATS)}")
    if ending in FORMATS and ending != asked:
        raise ModsimError(f"the ending of {out} contradicts --format {asked}")
    return asked


def _id_buffer(
    run: StoredRun, cameras: tuple[int, ...], step: int, out: StrPath | None, overwrite: bool
) -> OutputFiles:
    names = [run.scene.cameras[index].name for index in cameras]
    if len(names) > 1:
        raise ModsimError(f"--kind id_buffer needs one camera: give --camera {' or --camera '.join(names)}")
    path = out_file(out, run.folder / f"id_buffer_{names[0]}_{step:06d}.png")
    if path.suffix.lower() not in (".png", ".npy"):
        raise ModsimError(f"{path}: the name of an ID buffer must end in .png or .npy")
    image = run.frame(names[0], step).id_image()
    with _claimed(path, run, overwrite):
        write_id_buffer(image, path)
    height, width = image.ids.shape
    counts = [f"{number:>9}  {image.names[number]}: {pixels} px" for number, pixels in image.counts()]
    return OutputFiles((path,), (f"{width} × {height} px, 0 where nothing is", *counts))


def _claimed(path: Path, run: StoredRun, overwrite: bool, folder: bool = False) -> AbstractContextManager[None]:
    """Claim a file, or a folder of PNG files. Raises ModsimError if the folder above is missing; see `claimed`."""
    if not path.parent.is_dir():
        raise ModsimError(f"{path.parent} does not exist")
    inputs = read_of_run(run.folder)
    if folder:
        return claimed_folders({path: FRAME_FILES}, overwrite=overwrite, inputs=inputs)
    return claimed([path], overwrite=overwrite, inputs=inputs)
