"""Runs a tracker over the detections of a finished run, and writes its tracks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import key_table
from modsim3d.io.overwrite_guard import claimed
from modsim3d.runs.camera_sequences import CameraSequence, camera_sequences
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.trackers.running import tracked
from modsim3d.tracks.reading import track_paths, write_claimed_tracks
from modsim3d.tracks.tracks import Origin, Tracks, TrackSet


@dataclass(frozen=True)
class TrackCounts:
    """Counts of a tracker's output for a camera, or for all."""

    frames: int
    detections: int  # that the tracker was given
    tracks: int  # that it reported
    boxes: int  # that it reported, one for each track and frame
    median_track_s: float | None  # median time from a track's first box to its last; None without tracks


@dataclass(frozen=True, eq=False, repr=False)
class TrackResult:
    """Tracks in a run, from `track_run`.

    Attributes:
        folder: The folder that was written.
        name: What tables call the tracks: the tracker, and the settings that were given.
        tracks: The tracks.
        origin: The tracker, all its settings and where they come from.
        camera_counts: What the tracker made of each camera, by its name.
        counts: The same for all cameras.
        seconds: Wall-clock time of the tracker alone.
    """

    folder: Path
    name: str
    tracks: Tracks
    origin: Origin
    camera_counts: dict[str, TrackCounts]
    counts: TrackCounts
    seconds: float

    def __repr__(self) -> str:
        """Where they are, and how many, in a line."""
        return f"<TrackResult {self.folder}: {', '.join(f'{key} {value}' for key, value in self._rows().items())}>"

    def _repr_html_(self) -> str:
        """A notebook's table."""
        return key_table(f"Tracks {self.folder}", self._rows())

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
    tracker: str = "reference",
    settings: Mapping[str, object] | None = None,
    overwrite: bool = False,
    progress: Callable[[int], None] = lambda frames: None,
) -> TrackResult:
    """Run a tracker over the detections of a run, and write `tracks.parquet` and `tracks.json`.

        result = modsim3d.track_run("runs/first", "tracks/reference")
        result = modsim3d.track_run("runs/first", "tracks/patient", settings={"lost_s": 8})

    Args:
        run: A finished run, or its directory.
        folder: The folder for the tracks.
        tracker: Name of a tracker, or of a plug-in.
        settings: Settings of the tracker, in place of those that were chosen for the scene.
        overwrite: Replace tracks that are there.
        progress: Called with the number of frames done since its last call.

    Raises:
        ModsimError: The run was interrupted, there is no such tracker or setting, the tracker fails, or the folder
            cannot be used.
        TypeError: The run or the folder is neither text nor a path, or the settings are no mapping.
    """
    run, folder = opened_run(run), as_path(folder, "folder", "a folder for tracks")
    run.finished_tables.check_checksums()
    with claimed(track_paths(folder), overwrite=overwrite, inputs=[*read_of_run(run.folder), run.folder]):
        given = {} if settings is None else settings
        named = named_tracker(tracker, given, run.scene.name)
        origin, cameras = named.origin, tuple(range(len(run.scene.cameras)))
        sequences = camera_sequences(run, cameras)
        started = perf_counter()
        tracks = tracked(named, sequences, cameras, run.scene, progress)
        seconds = perf_counter() - started
        changed = ", ".join(f"{key}={value}" for key, value in given.items())  # tells it from the same with others
        track_set = TrackSet(f"{named.name} ({changed})" if changed else named.name, tracks, origin)
        write_claimed_tracks(folder, run, track_set)
    parts = zip(sequences, cameras, strict=True)
    by_camera = {each.camera.name: _counts([each], tracks.take(tracks.camera == camera), run) for each, camera in parts}
    counts = _counts(sequences, tracks, run)
    return TrackResult(folder, track_set.name, tracks, origin, by_camera, counts, seconds)


def _counts(sequences: Sequence[CameraSequence], tracks: Tracks, run: StoredRun) -> TrackCounts:
    times_s = run.scene.times_s(0, run.steps)[tracks.step]
    count = int(tracks.identity.max(initial=-1)) + 1
    first_s, last_s = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(first_s, tracks.identity, times_s)
    np.maximum.at(last_s, tracks.identity, times_s)
    return TrackCounts(
        sum(len(each.steps) for each in sequences),
        sum(len(each.detections) for each in sequences),
        count,
        len(tracks),
        round(float(np.median(last_s - first_s)), 3) if count else None,
    )
