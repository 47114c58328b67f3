"""A run of a campaign made again as a run directory, and compared with its row."""

import traceback
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.campaign import Campaign, check_files, present_state, rows_of
from modsim3d.campaign.folder import CampaignFolder, opened_campaign
from modsim3d.campaign.plan import PlannedRun
from modsim3d.campaign.ranking import score_of_run
from modsim3d.campaign.search_folder import trial_run
from modsim3d.campaign.work.layers import LayeredRun, RunLayers
from modsim3d.campaign.work.row import DONE, error_and_said, row_of, rules_of, search_versions
from modsim3d.campaign.work.scenes import Scenes, tracker_of, versions
from modsim3d.core.errors import ModsimError, OutputError, RunDirectoryError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io.overwrite_guard import check_free
from modsim3d.runs.run import run_scene, settings_of
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.scene.scene import Scene
from modsim3d.tracking.track_run import track_run
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracking.worst_film import MomentFilm, film_moment, film_path
from modsim3d.tracks.reading import TABLE, WORLD_TABLE, read_stored_tracks, stored_facts, track_paths
from modsim3d.tracks.tracks import Tracks, WorldTracks
from modsim3d.tracks.world_reading import read_world_tracks
from modsim3d.view.films.files import check_encoder

# ---- Whether a run of a campaign that is to be made again is there already ----


def run_there(folder: Path, scene: Scene) -> StoredRun | None:
    """Run of a scene with its seeds in a run directory; None if there is none, or another one, or a damaged one."""
    try:
        run = open_run(folder)
        run.finished_tables.check_checksums()
    except ModsimError:
        return None
    wanted = orjson.loads(orjson.dumps(settings_of(scene, run.settings["backend"])))
    return run if all(run.settings.get(key) == value for key, value in wanted.items()) else None


def tracks_there(folder: Path, run: StoredRun, named: NamedTracker) -> Tracks | WorldTracks | None:
    """Tracks of a tracker in a run; None if there are none, or those of another tracker, or damaged ones."""
    world = (folder / WORLD_TABLE).is_file()
    try:
        if stored_facts(folder, run, WORLD_TABLE if world else TABLE).origin != named.origin:
            return None
        return read_world_tracks(folder, run) if world else read_stored_tracks(folder, run, RunRows.of(run)).tracks
    except ModsimError:
        return None


# ---- A run of a campaign, made again from the campaign's folder ----


def planned_run(folder: CampaignFolder, number: int) -> PlannedRun:
    """Run as the plan has it, or as the search of a trial has it. Raises InputError if a file that it is made of is not
    as it was, and ModsimError if there is no such run."""
    check_files(folder)
    if folder.keys.search is not None:
        return trial_run(folder.path, number)
    if not 0 <= number < len(folder.plan):
        raise ModsimError(f"{folder.path} has runs 0 to {len(folder.plan) - 1} (got {number})")
    return folder.plan.run(number)


def row_of_run(folder: CampaignFolder, number: int) -> dict[str, Any] | None:
    """Row of a run; None if it is not done. Raises ModsimError for damaged results."""
    if not folder.results.is_dir():  # or a search
        table = rows_of(folder)
        matches = table.filter(pc.equal(table["run"], number)).to_pylist()
        return matches[0] if matches else None
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        if rows := pq.read_table(path, partitioning=None, filters=[("run", "==", number)]).to_pylist():
            return {"scene": path.parent.name.partition("=")[2], **rows[0]}
    return None


def remade(folder: CampaignFolder, number: int) -> LayeredRun:
    """Layers of a run, made again or read where they are kept; ModsimError if there is no such run, or it fails."""
    run, work = planned_run(folder, number), folder.work
    with closing(RunLayers(work.keys.model_copy(update={"keep": []}), Path(work.base), work.layers)) as layers:
        return layers.layers_of(run)


_NOT_COMPARED = ("run", "status", "error", "truth_key", "detections_key", "tracks_key")


@dataclass(frozen=True, eq=False, repr=False)
class ReproducedRun:
    """A run of a campaign that was made again."""

    run: PlannedRun
    folder: Path  # its run directory
    tracks: Path  # folder with its tracks
    before: dict[str, Any] | None  # its row in the campaign; None if it was not done there
    row: dict[str, Any] | None  # None if it failed
    error: str | None  # None if it did not fail
    raised_at: str  # file, line and function, and what a program said; empty without an error
    differing: tuple[str, ...]  # columns that are not as in the campaign, if both rows have scores
    reused: tuple[Path, ...]  # those of both folders that were there already; they are left as they were
    versions: dict[str, tuple[str | None, str | None]]  # then and now, by package, where they are not the same
    film: MomentFilm | None = None  # of the moment at which it went wrong, if that was asked for

    def __repr__(self) -> str:
        """The folder, and whether the row is the same."""
        return f"<ReproducedRun {self.folder}: {self.error or ('as' if self.same else 'not as') + ' in the campaign'}>"

    @property
    def same(self) -> bool:
        """Whether it came out as in the campaign: with the same row, or with an error; True if there is no row."""
        if self.before is None:
            return True
        return (self.before["status"] == DONE) == (self.error is None) and not self.differing


def reproduce_run(
    campaign: Campaign | StrPath,
    number: int,
    out: StrPath,
    *,
    film: bool = False,
    overwrite: bool = False,
    progress: Callable[..., None] = lambda *_: None,
) -> ReproducedRun:
    """Make a run of a campaign again, with its tracks, and compare its scores with those of the campaign.

        again = modsim3d.reproduce_run("runs/example", 12, "runs/example/runs/12", film=True)
        again.same, again.row["hota"]

    Args:
        campaign, number: A campaign or its folder; number of the run, as in its tables.
        out: Run directory to write, with its tracks beside it. A run that is there already stays if it is this one.
        film: Film ten seconds around the mistake that the pictures of worst runs show, if there is one.
        overwrite: Replace another run that is there.
        progress: Called with the number of steps done since its last call, first with 0 and their number in all; then
            so with frames of the film.

    Raises:
        ModsimError: There is no such run, a file has changed since, ffmpeg is missing, or the run cannot be written;
            what the run itself raises is in the result.
        TypeError: A path is neither text nor a path.
    """
    folder = opened_campaign(campaign.folder if isinstance(campaign, Campaign) else campaign)
    path = as_path(out, "out", "a run directory")
    if film:
        check_encoder("mp4")
        check_free(film_path(path), overwrite)
    run, before = planned_run(folder, number), row_of_run(folder, number)
    tracks = path.with_name(f"{path.name}_tracks")  # nothing but the run is written into its own folder
    then, now = folder.facts["versions"], {**versions(), **search_versions(folder.keys)}
    row, error, raised_at, reused, moment = None, None, "", list[Path](), None
    try:
        row = _row(folder, run, path, tracks, overwrite, progress, reused)
    except (OutputError, RunDirectoryError):
        raise
    except Exception as failure:
        where = traceback.extract_tb(failure.__traceback__)[-1]
        raised_at = f"{where.filename}, line {where.lineno}, in {where.name}"
        error, message = error_and_said(failure)
        raised_at += f"; standard error: {message}" if message else ""
    if film and row is not None and row.get("worst_s") is not None:
        score = score_of_run(folder, (state := present_state(folder)).table, state.verdicts, number)
        about = rules_of(folder.keys.score), row["worst_s"], score
        moment = film_moment(path, tracks, *about, overwrite=overwrite, progress=progress)
    changed = {name: (then.get(name), now.get(name)) for name in {**then, **now} if then.get(name) != now.get(name)}
    differing = _differing(before, row)
    return ReproducedRun(run, path, tracks, before, row, error, raised_at, differing, tuple(reused), changed, moment)


def _row(
    folder: CampaignFolder,
    run: PlannedRun,
    out: Path,
    tracks: Path,
    overwrite: bool,
    progress: Callable[..., None],
    reused: list[Path],
) -> dict[str, Any]:
    """Write a run and its tracks; its row. What is there already is added to `reused`."""
    work = folder.work
    scene = Scenes(work.keys.steps, Path(work.base), learned=work.keys.uncertainty == "learned").alone(
        run.condition, run.traffic_seed, run.detector_seed
    )
    progress(0, scene.steps)
    named = tracker_of(run.tracker, run.condition.of_tracker(), scene.name, Path(work.base))
    stored = None if overwrite else run_there(out, scene)
    track_data = None if stored is None else tracks_there(tracks, stored, named)
    if track_data is None:
        for path in track_paths(tracks):
            check_free(path, overwrite)
    if stored is None:
        run_scene(scene, out, overwrite=overwrite, resume=not overwrite, progress=progress)
        stored = open_run(out)
    else:
        reused.append(out)
        progress(stored.steps)
    if track_data is None:
        track_data = track_run(stored, tracks, tracker=named, overwrite=overwrite).tracks
    else:
        reused.append(tracks)
    made = LayeredRun(RunRows.of(stored), track_data, "", "", "")
    return row_of(run.number, made, work.keys.score, work.keys.lookout)


def _differing(before: Mapping[str, Any] | None, row: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Columns of a row that are not those of the same run's row in a campaign."""
    if before is None or row is None or before["status"] != DONE:
        return ()
    return tuple(
        name for name, value in row.items() if name not in _NOT_COMPARED and name in before and before[name] != value
    )
