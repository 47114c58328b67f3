"""Runs a tracker over the detections of a finished run, and writes its tracks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modsim3d.core.document import Result
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.camera_sequences import CameraSequence, sequences_of
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.tracking.trackers.command import DEFAULT_TIMEOUT_S
from modsim3d.tracking.trackers.registry import Model, NamedTracker, command_tracker, named_tracker
from modsim3d.tracking.trackers.running import run_tracker
from modsim3d.tracks.reading import FACTS, TABLE, WORLD_TABLE, track_paths, write_claimed_tracks
from modsim3d.tracks.tracks import Origin, Tracks, TrackSet, WorldTracks
from modsim3d.tracks.world_reading import write_claimed_world_tracks


@dataclass(frozen=True)
class TrackCounts:
    """Counts of a tracker's output for a camera, or for all."""

    frames: int
    detections: int  # that the tracker was given
    tracks: int  # that it reported
    boxes: int  # that it reported, one for each track and frame; in the world, estimates, one for each track and step
    median_track_s: float | None  # median time from a track's first box to its last; None without tracks


@dataclass(frozen=True, eq=False, repr=False)
class TrackResult(Result):
    """Tracks in a run, from `track_run`.

    Attributes:
        folder: The folder that was written.
        name: What tables call the tracks: the tracker, and the settings that were given.
        tracks: The tracks, in the images or in the world.
        origin: The tracker, all its settings and where they come from.
        camera_counts: What the tracker made of each camera, by its name; none of one that works in the world.
        counts: The same for all cameras.
        seconds: Working time of the tracker alone.
        frame_ms: `median`, 99th percentile `p99` and `max` of its working times for a frame, or for a step of all
            cameras, in ms; empty without frames.
        written: The files that were written.
    """

    folder: Path
    name: str
    tracks: Tracks | WorldTracks
    origin: Origin
    camera_counts: dict[str, TrackCounts]
    counts: TrackCounts
    seconds: float
    frame_ms: dict[str, float]
    written: tuple[Path, ...]

    def _rows(self) -> dict[str, str]:
        counts = self.counts
        median = "" if counts.median_track_s is None else f"{counts.median_track_s:.1f} s"
        return {
            "tracker": self.name,
            "frames": f"{counts.frames:,}",
            "detections": f"{counts.detections:,}",
            "tracks": f"{counts.tracks:,}",
            "boxes": f"{counts.boxes:,}",
            **({"median track": median} if median else {}),
            "time": f"{self.seconds:.1f} s",
        }


def track_run(
    run: StoredRun | StrPath,
    folder: StrPath,
    *,
    tracker: str | Model | NamedTracker = "reference",
    command: Sequence[str] | None = None,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    settings: Mapping[str, object] | None = None,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
) -> TrackResult:
    """Run a tracker over the detections of a run, and write `tracks.parquet`, or `world_tracks.csv` of a tracker in the
    world, and `tracks.json`.

        result = modsim3d.track_run("runs/first", "tracks/reference")
        result = modsim3d.track_run("runs/first", "tracks/patient", settings={"lost_s": 8})
        result = modsim3d.track_run("runs/first", "tracks/mine", command=["./my_tracker", "--fast"])

    Args:
        run: A finished run, or its directory.
        folder: The folder for the tracks.
        tracker: Name of a tracker, or of a plug-in; or a class made from `modsim3d.Tracker` (docs/plugins.md); or one
            that `named_tracker` gave, with its settings.
        command: Name and arguments of a program that is the tracker in its place (docs/tracker_command.md).
        timeout_s: Time that the program has for each answer.
        settings: Settings of the tracker, in place of those that were chosen for the scene.
        overwrite: Replace tracks that are there.
        progress: Called with the number of frames done since its last call.

    Raises:
        ModsimError: The run was interrupted, there is no such tracker or setting, the tracker fails, or the folder
            cannot be used.
        TypeError: The run or the folder is neither text nor a path, settings are no mapping, or the command is text.
    """
    run, folder = opened_run(run), as_path(folder, "folder", "a folder for tracks")
    run.finished_tables.check_checksums()
    with claimed(track_paths(folder), overwrite=overwrite, inputs=[*read_of_run(run.folder), run.folder]):
        given = {} if settings is None else settings
        if isinstance(tracker, NamedTracker):
            named = tracker
        elif command is None:
            named = named_tracker(tracker, given, run.scene.name)
        else:
            named = command_tracker(command, given, timeout_s=timeout_s)
        origin, rows = named.origin, RunRows.of(run)
        output = run_tracker(named, rows, progress)
        changed = ", ".join(f"{key}={value}" for key, value in given.items())  # tells it from the same with others
        name = f"{named.name} ({changed})" if changed else named.name
        table = TABLE if isinstance(output.tracks, Tracks) else WORLD_TABLE
        for other in {TABLE, WORLD_TABLE} - {table}:
            (folder / other).unlink(missing_ok=True)  # of tracks that were there before
        if isinstance(output.tracks, Tracks):
            write_claimed_tracks(folder, run, TrackSet(name, output.tracks, origin))
        else:
            write_claimed_world_tracks(folder, run, replace(output.tracks, name=name), origin)
    by_camera, counts = _counts_of(run, rows, output.tracks)
    written = folder / table, folder / FACTS
    seconds = float(output.seconds.sum())
    return TrackResult(folder, name, output.tracks, origin, by_camera, counts, seconds, output.frame_ms, written)


def _counts_of(
    run: StoredRun, rows: RunRows, tracks: Tracks | WorldTracks
) -> tuple[dict[str, TrackCounts], TrackCounts]:
    """Counts by camera, none of tracks in the world, and of all cameras."""
    sequences = sequences_of(rows, tuple(range(len(run.scene.cameras))))
    if isinstance(tracks, Tracks):
        by_camera = {
            sequence.camera.name: _counts([sequence], tracks.take(tracks.camera == camera), run)
            for camera, sequence in enumerate(sequences)
        }
        return by_camera, _counts(sequences, tracks, run)
    edges = np.flatnonzero(np.diff(tracks.track, prepend=-1, append=-1))
    frames, detections = (
        sum(map(len, parts)) for parts in zip(*((s.steps, s.detections) for s in sequences), strict=True)
    )
    lasted_s = tracks.time_s[edges[1:] - 1] - tracks.time_s[edges[:-1]]
    median_s = round(float(np.median(lasted_s)), 3) if len(lasted_s) else None
    return {}, TrackCounts(frames, detections, len(lasted_s), len(tracks), median_s)


def _counts(sequences: Sequence[CameraSequence], tracks: Tracks, run: StoredRun) -> TrackCounts:
    times_s = run.scene.times_s(0, run.steps)[tracks.step]
    count = int(tracks.identity.max(initial=-1)) + 1
    first_s, last_s = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first_s, tracks.identity, times_s)
    np.maximum.at(last_s, tracks.identity, times_s)
    return TrackCounts(
        sum(len(sequence.steps) for sequence in sequences),
        sum(len(sequence.detections) for sequence in sequences),
        count,
        len(tracks),
        round(float(np.median(last_s - first_s)), 3) if count else None,
    )
