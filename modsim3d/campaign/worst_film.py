"""A film of the moment at which a run went wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from modsim3d.campaign.work.layers import Made
from modsim3d.campaign.work.worst_moment import FALSE, LOST, SWITCHED, Mistakes, worst_frame
from modsim3d.core.errors import RendererError
from modsim3d.core.text import counted
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.blocks import frames_of
from modsim3d.runs.counts import NOTHING_WRONG
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.files.stored_tables import detections_of, truth_of
from modsim3d.runs.frames import Frame
from modsim3d.runs.pipeline import detected_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.selection import StepFrames, select
from modsim3d.runs.stored_run import open_run
from modsim3d.tracking.scores.scored import Rules, Scored
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.tracks import Tracks, TrackSet

if TYPE_CHECKING:
    from PIL.Image import Image

    from modsim3d.view.sea_and_sky import RenderStyle

MARGIN, LEAST = 0.5, 0.2  # beside the mistakes, as a share of what they fill, and at least, of the image
LAYERS = ("horizon", "silhouettes", "truth", "missed", "tracks", "labels")  # what is true, and what the tracker says
MAX_SWITCHES = 2  # so many identity switches are told in full


def moment_picture(made: Made, moment_s: float, width_px: int, rules: Rules | None = None) -> Image:
    """True boxes and tracks of a run, see `remade`, at a moment, see `WorstRun`, in the camera with most mistakes. The
    width is even; `rules` scored the tracks, the usual ones if None."""
    from modsim3d.view.films.plan import FilmPlan, part_around
    from modsim3d.view.films.renderer import open_film_renderer
    from modsim3d.view.followed_tracks import FollowedTracks
    from modsim3d.view.pictures.layers import Layers

    rows, rules = made.rows, rules or Rules()
    assert isinstance(made.tracks, Tracks)  # of tracks in the world no moment is known
    scored = Scored.of(rows, made.tracks, rules)
    mistakes = Mistakes.of(scored)
    number = worst_frame(scored, mistakes, moment_s)
    step, camera = divmod(number, len(rows.scene.cameras))
    here = mistakes.in_frame(number)
    boxes_px = here.boxes_px if len(here.kind) else rows.boxes_px("full")[rows.truth_frame == number]
    size_px = rows.scene.cameras[camera].intrinsics.image_size_px
    style, shaded = best_style()
    plan = FilmPlan(
        ("detections",),
        (camera,),
        width_px,
        Layers.of(LAYERS),
        (part_around(np.clip(boxes_px, 0, [*size_px, *size_px]), size_px, MARGIN, LEAST),),
        style,
        shaded,
        rows.steps,
        mistakes=NOTHING_WRONG,
        tracks=FollowedTracks.of(TrackSet("the tracker", made.tracks, None), rows, rules.similarity),
        note=in_words(here, rows.scene.vessel_names),
    )
    frame = _as_followed(frame_of(rows, number), here, rows)
    shown = StepFrames(step, rows.scene.timestamps(step, step + 1)[0], (frame,))
    with open_film_renderer(rows.scene, plan) as renderer:
        return renderer.draw(shown)


def in_words(mistakes: Mistakes, names: Sequence[str]) -> str:
    """Mistakes in a frame in words, with names of vessels; a switch, which no picture shows, is said in full."""
    lost, false = (int(np.count_nonzero(mistakes.kind == kind)) for kind in (LOST, FALSE))
    switches = np.flatnonzero(mistakes.kind == SWITCHED)
    vessel, before, after = mistakes.vessel, mistakes.before, mistakes.after
    found = (
        f"{counted(lost, 'vessel')} missed" if lost else "",
        f"{counted(false, 'track')} on nothing" if false else "",
        *(f"switch of {names[vessel[row]]} from #{before[row]} to #{after[row]}" for row in switches[:MAX_SWITCHES]),
        f"and {len(switches) - MAX_SWITCHES} more" if len(switches) > MAX_SWITCHES else "",
    )
    return ", ".join(part for part in found if part)


def _as_followed(frame: Frame, mistakes: Mistakes, rows: RunRows) -> Frame:
    """The frame with the tracker in place of the detector: missed is what no track follows."""
    lost = {rows.scene.vessel_names[vessel] for vessel in mistakes.vessel[mistakes.kind == LOST].tolist()}
    followed = np.array([name not in lost for name in frame.truth.vessels], dtype=bool)
    return replace(frame, truth=replace(frame.truth, detected=followed))


def best_style() -> tuple[RenderStyle, bool]:
    """Light and shade where there is OpenGL, and whether boxes are drawn on it."""
    from modsim3d.render.context import open_context
    from modsim3d.view.sea_and_sky import PLAIN_STYLE, RenderStyle

    try:
        with open_context():  # a library may have no driver
            pass
    except RendererError:
        return PLAIN_STYLE, False
    return RenderStyle(shaded=True, by_state=True), True


def frame_of(rows: RunRows, number: int) -> Frame:
    """A frame of a run in memory, by its number as in `RunRows`."""
    scene, (step, camera) = rows.scene, divmod(number, len(rows.scene.cameras))
    cameras, states = [each.name for each in scene.cameras], [state.name for state in scene.detector.states]
    at = rows.frames // len(cameras) == step
    frames = {
        "camera": [cameras[index] for index in (rows.frames[at] % len(cameras)).tolist()],
        "state": [states[index] for index in rows.frame_state[at].tolist()],
    }
    tables = {
        "frames": pa.table(frames, schema=pa.schema([("camera", pa.string()), ("state", pa.string())])),
        "truth": rows.truth.filter(pa.array(rows.truth_frame // len(cameras) == step)),
        "detections": rows.detections.filter(pa.array(rows.detection_frame // len(cameras) == step)),
    }
    read = partial(detections_of, tables, scene.detector)
    block = detected_block(scene, truth_of(tables["truth"], scene), step, step + 1, read)
    return next(frame for frame in frames_of(block, scene, range(step, step + 1)) if frame.camera == cameras[camera])


AROUND_S = 5.0  # what is shown before and after the moment
WIDTH_PX = 1280


@dataclass(frozen=True)
class MomentFilm:
    """A film of a moment: its file, the camera, and the times of the run at which it begins and ends."""

    path: Path
    camera: str
    from_s: float
    to_s: float


def film_path(folder: Path) -> Path:
    """The film of a run directory."""
    return folder / "detections.mp4"


def film_moment(
    folder: Path,
    tracks: Path,
    rules: Rules,
    moment_s: float,
    *,
    overwrite: bool = False,
    progress: Callable[..., None] = lambda *_: None,
) -> MomentFilm:
    """Film ten seconds of a run with its tracks, around a moment as its timestamps have it, in the camera with most
    mistakes, into `detections.mp4` of the run. `progress` is called with the number of frames drawn since its last
    call, first with 0 and their number in all. Raises ModsimError if there is no ffmpeg, or the file cannot be
    written."""
    from modsim3d.view.films.film import draw_film
    from modsim3d.view.films.plan import FilmPlan, crop_to_vessels, mistakes_in
    from modsim3d.view.followed_tracks import FollowedTracks

    run = open_run(folder)
    rows = RunRows.of(run)
    track_set = read_tracks(tracks, run, rows)
    scored = Scored.of(rows, track_set.tracks, rules)
    camera = worst_frame(scored, Mistakes.of(scored), moment_s) % len(rows.scene.cameras)
    selection = select(run, (camera,), from_s=moment_s - AROUND_S, to_s=moment_s + AROUND_S)
    progress(0, len(selection.steps))
    style, shaded = best_style()
    plan = FilmPlan(
        ("detections",),
        (camera,),
        WIDTH_PX,
        None,
        crop_to_vessels(selection),
        style,
        shaded,
        run.steps,
        mistakes=mistakes_in(selection),
        tracks=FollowedTracks.of(track_set, rows, rules.similarity),
    )
    path = film_path(folder)
    with claimed([path], overwrite=overwrite, inputs=[*read_of_run(folder), *tracks.iterdir()]):
        draw_film(selection, plan, "mp4", path, progress=progress)
    times = [float(rows.scene.timestamps(step, step + 1)[0]) for step in (selection.steps[0], selection.steps[-1])]
    return MomentFilm(path, rows.scene.cameras[camera].name, times[0], times[1])
