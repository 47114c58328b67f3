"""A film of the moment at which a run went wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from modsim3d.campaign.work.worst_moment import Mistakes, worst_frame
from modsim3d.campaign.worst.picture import best_style
from modsim3d.outputs.claims import claimed
from modsim3d.runs.files.replacing import read_of_run
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.selection import select
from modsim3d.runs.stored_run import open_run
from modsim3d.tracking.scores.rules import Rules
from modsim3d.tracking.scores.scored import Scored
from modsim3d.tracks.reading import read_tracks

AROUND_S = 5.0
"""What is shown before and after the moment."""
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
    progress: Callable[[int], None] = lambda frames: None,
) -> MomentFilm:
    """Film ten seconds of a run with its tracks, in the camera with most mistakes, into `detections.mp4` of the run.

    Args:
        folder: The run directory.
        tracks: Its tracks.
        rules: By which they were scored.
        moment_s: The moment in the middle, as the run's timestamps have it.
        overwrite: Replace a film that is there.
        progress: Called with the number of frames drawn since its last call.

    Raises:
        ModsimError: There is no ffmpeg, or the file cannot be written.
    """
    from modsim3d.view.films.film import draw_film
    from modsim3d.view.films.plan import FilmPlan, crop_to_vessels, mistakes_in
    from modsim3d.view.followed_tracks import FollowedTracks

    run = open_run(folder)
    rows = RunRows.of(run)
    track_set = read_tracks(tracks, run, rows)
    scored = Scored.of(rows, track_set.tracks, rules)
    camera = worst_frame(scored, Mistakes.of(scored), moment_s) % len(rows.scene.cameras)
    selection = select(run, (camera,), from_s=moment_s - AROUND_S, to_s=moment_s + AROUND_S)
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
