"""Pictures and a film of the moment at which a run went wrong: one vessel before and after it, with an arrow at it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.errors import RendererError
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.blocks import frames_of
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.files.stored_tables import detections_of, truth_of
from modsim3d.runs.frames import Frame
from modsim3d.runs.pipeline import detected_block
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.selection import StepFrames, select
from modsim3d.runs.stored_run import open_run
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracking.worst_moment import row_to_show, worst_mistake
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.tracks import TrackSet

if TYPE_CHECKING:
    from PIL.Image import Image

    from modsim3d.view.films.plan import CloseUp, FilmPlan
    from modsim3d.view.sea_and_sky import RenderStyle


@dataclass(frozen=True, eq=False)
class Story:
    """Story of what a tracker lost: a vessel in one camera, or a track on nothing, in n frames in order of time."""

    scored: ScoredRun
    vessel: int  # index, `NOBODY` if it is about a track
    track: int  # number, `NOBODY` if it is about a vessel
    lost: int  # number of the frame in which it went wrong
    frame: Indices  # shape (n,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, shape (n, 4)
    partner: Indices  # number of the track that follows the vessel, or index of the vessel, `NOBODY` for none, (n,)
    seen: Mask  # whether other things do not hide all of the vessel, shape (n,)

    @classmethod
    def of(cls, scored: ScoredRun, moment_s: float, row: int = NOBODY) -> Story:
        """The worst mistake at a moment, or the one in a row of `row_to_show`, with what comes before and after."""
        worst, following = worst_mistake(scored, moment_s), scored.following
        truth, tracks = following.truth, following.tracks
        lost, vessel, track = int(worst.frame[0]), int(worst.vessel[0]), int(worst.track[0])
        if row != NOBODY:
            lost, vessel, track = int(truth.frame[row]), int(truth.vessel[row]), NOBODY
        mine, number, is_mine, paired, partners = (
            (truth, vessel, truth.vessel, following.track_row, tracks.track)
            if track == NOBODY
            else (tracks, track, tracks.track, following.truth_row, truth.vessel)
        )
        rows = np.flatnonzero((is_mine == number) & (mine.frame % scored.by_step == lost % scored.by_step))
        rows = rows[np.argsort(mine.frame[rows], kind="stable")]
        partner = np.append(partners, NOBODY)[paired[rows]]
        seen = ~truth.hidden[rows] if track == NOBODY else np.ones(len(rows), dtype=bool)
        return cls(scored, vessel, track, lost, mine.frame[rows], mine.boxes_px[rows], partner, seen)

    @property
    def before(self) -> int:
        """The last frame in which it is seen with another partner before it went wrong, or the first in which it is."""
        others = (self.partner != NOBODY) & (self.partner != self.partner[self.frame == self.lost])
        paired = np.flatnonzero(self.seen & (self.frame < self.lost) & others)
        return int(self.frame[paired[-1] if len(paired) else np.flatnonzero(self.seen)[0]])

    def caption(self, frame: int) -> str:
        """Words for a frame."""
        names, place = self.scored.rows.scene.vessel_names, np.flatnonzero(self.frame == frame)
        partner = int(self.partner[place[0]]) if len(place) else NOBODY
        if self.track != NOBODY:
            return f"track #{self.track} on {'nothing' if partner == NOBODY else names[partner]}" if len(place) else ""
        followed = "no track" if partner == NOBODY else f"track #{partner}"
        return f"{names[self.vessel]}: {followed if len(place) else 'outside the image'}"

    def close_up(self, frames: Sequence[int]) -> CloseUp:
        """Content of the pictures of some frames of the camera."""
        from modsim3d.view.films.plan import CloseUp

        nearest = np.abs(np.subtract.outer(frames, self.frame)).argmin(axis=1)
        boxes_px, steps = self.boxes_px[nearest], [frame // self.scored.by_step for frame in frames]
        middle, half = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2, (boxes_px[:, 2:] - boxes_px[:, :2]).max(axis=0) / 2
        around = map(tuple, np.concatenate([middle - half, middle + half], axis=1).tolist())
        followers = {*self.partner[nearest].tolist()} - {NOBODY}
        return CloseUp(
            dict(zip(steps, around, strict=True)),
            dict(zip(steps, map(self.caption, frames), strict=True)),
            self.scored.rows.scene.vessel_names[self.vessel] if self.track == NOBODY else None,
            frozenset(followers if self.track == NOBODY else {self.track}),
        )


WIDTH_PX, ENLARGED = 720, 2.6  # of a picture, and of its text and lines, as a page shows it small
LAYERS = ("horizon", "silhouettes", "truth", "missed", "tracks", "labels")  # what is true, and what the tracker says
ABOUT = "White: the true box. With a number: the track, dashed in orange on nothing. Orange corners: no track."


def moment_pictures(story: Story) -> list[Image]:
    """Pictures of what a tracker lost, before and after, `WIDTH_PX` wide; one where nothing was before."""
    from modsim3d.view.films.renderer import open_film_renderer

    frames = list(dict.fromkeys((story.before, story.lost)))
    plan = _plan(story, frames, TrackSet("the tracker", story.scored.following.tracks, None))
    plan = replace(plan, width=WIDTH_PX, enlarged=ENLARGED, style=replace(plan.style, enlarged=ENLARGED), key=False)
    with open_film_renderer(story.scored.rows.scene, plan) as renderer:
        return [renderer.draw(_tracker_frame(story, number)) for number in frames]


def _plan(story: Story, frames: Sequence[int], track_set: TrackSet) -> FilmPlan:
    from modsim3d.view.films.plan import FilmPlan
    from modsim3d.view.followed_tracks import FollowedTracks
    from modsim3d.view.pictures.layers import Layers

    (style, shaded), scored = best_style(), story.scored
    return FilmPlan(
        ("detections",),
        (frames[0] % scored.by_step,),
        FILM_WIDTH_PX,
        Layers.of(LAYERS),
        style=style,
        boxes_on_scene=shaded,
        steps=scored.rows.steps,
        tracks=FollowedTracks.of(track_set, scored.rows, scored.rules.similarity),
        close_up=story.close_up(frames),
    )


def _tracker_frame(story: Story, number: int) -> StepFrames:
    """A frame with the tracker in place of the detector: missed is the vessel where no track follows it."""
    rows, step = story.scored.rows, number // story.scored.by_step
    frame = frame_of(rows, number)
    missed = story.partner[story.frame == number].tolist() == [NOBODY] and story.track == NOBODY
    lost = rows.scene.vessel_names[story.vessel] if missed else None
    followed = np.array([name != lost for name in frame.truth.vessels], dtype=bool)
    frame = replace(frame, truth=replace(frame.truth, detected=followed))
    return StepFrames(step, rows.scene.timestamps(step, step + 1)[0], (frame,))


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
    cameras, states = [sensor.name for sensor in scene.cameras], [state.name for state in scene.detector.states]
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
FILM_WIDTH_PX = 1280


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
    score: str,
    *,
    overwrite: bool = False,
    progress: Callable[..., None] = lambda *_: None,
) -> MomentFilm:
    """Film ten seconds of a run with its tracks around what made a score low (`row_to_show`), or the worst mistake at a
    moment as its timestamps have it, into `detections.mp4` of the run. `progress` is called with the number of frames
    drawn since its last call, first with 0 and their number in all. Raises ModsimError if there is no ffmpeg, or the
    file cannot be written."""
    from modsim3d.view.films.film import draw_film
    from modsim3d.view.pictures.layers import Layers

    run = open_run(folder)
    rows = RunRows.of(run)
    track_set = read_tracks(tracks, run, rows)
    scored = ScoredRun.of(rows, track_set.tracks, rules)
    story = Story.of(scored, moment_s, row_to_show(scored, score))
    step, camera = divmod(story.lost, by_step := scored.by_step)
    lost_s = float(rows.scene.timestamps(step, step + 1)[0])
    selection = select(run, (camera,), from_s=lost_s - AROUND_S, to_s=lost_s + AROUND_S)
    progress(0, len(selection.steps))
    plan = _plan(story, [step * by_step + camera for step in selection.steps], track_set)
    plan = replace(plan, layers=Layers.of((*LAYERS, "detections")).without("missed"))
    path = film_path(folder)
    with claimed([path], overwrite=overwrite, inputs=[*read_of_run(folder), *tracks.iterdir()]):
        draw_film(selection, plan, "mp4", path, progress=progress)
    times = [float(rows.scene.timestamps(step, step + 1)[0]) for step in (selection.steps[0], selection.steps[-1])]
    return MomentFilm(path, rows.scene.cameras[camera].name, times[0], times[1])
