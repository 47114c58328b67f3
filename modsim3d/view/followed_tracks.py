"""Tracks of a tracker as they are shown: which vessel each follows, where it switches, and where it has been."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, row_before
from modsim3d.core.boxes import centres
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.tracks import Similarity, Tracks, TrackSet
from modsim3d.tracks.true_tracks import TrackMatching, TrueTracks, follow

TRAIL_S = 2.0  # how far back the centres of a track's boxes are shown


@dataclass(frozen=True, eq=False)
class FollowedTracks:
    """The tracks of one tracker: k rows in order of frame and track."""

    name: str  # of the tracker
    similarity: Similarity  # by which boxes were compared
    tracks: Tracks
    time_s: Array  # of each row, shape (k,)
    vessel: Indices  # index of the vessel that each row follows, `NOBODY` for none, shape (k,)
    unscored: Mask  # where that vessel is hidden or not annotated, so that no score counts the row, shape (k,)
    # Where another track followed that appearance of the vessel last, shape (k,). Their number is that of CLEAR MOT's
    # identity switches (Bernardin & Stiefelhagen, 2008).
    switched: Mask
    moved: Mask  # where the track followed another vessel last, shape (k,)

    @classmethod
    def of(cls, track_set: TrackSet, rows: RunRows, similarity: Similarity) -> Self:
        """Tracks held against the annotated truth of a run.
        Rows on vessels that are not scored are found first. The others are then matched without those vessels, as CLEAR
        MOT's scores are, so that the switches are theirs."""
        tracks = track_set.tracks
        first = follow(TrueTracks.of(rows), tracks, similarity, rows.regions)
        counted = first.counted
        again = follow(first.truth.take(first.truth.scored), tracks.take(counted), similarity, rows.regions)
        vessel, switched = _vessels(first), np.zeros(len(tracks), dtype=bool)
        vessel[counted] = _vessels(again)
        track = np.append(again.tracks.identity, NOBODY)[again.track_row]
        switched_again = again.track_row[_changed(again.truth.identity, track, again.found)]
        switched[np.flatnonzero(counted)[switched_again]] = True
        moved = _changed(tracks.identity, vessel, vessel != NOBODY)
        time_s = rows.scene.times_s(0, rows.steps)[tracks.step]
        return cls(track_set.name, similarity, tracks, time_s, vessel, ~counted, switched, moved)

    @property
    def false(self) -> Mask:
        """Mask of the rows that follow nothing, shape (k,)."""
        return np.equal(self.vessel, NOBODY)

    @cached_property
    def before(self) -> Indices:
        """The row before of each row's track, `NOBODY` for its first, shape (k,)."""
        return row_before(self.tracks.identity)

    def rows_of(self, frame: int) -> slice:
        """The rows of a frame, by its number."""
        return slice(*np.searchsorted(self.tracks.frame, (frame, frame + 1)).tolist())

    def trail_px(self, row: int) -> Array:
        """Centres of the boxes of a row's track in the last seconds, the newest first, shape (n, 2)."""
        trail, first_s = [row], self.time_s[row] - TRAIL_S
        while (row := int(self.before[row])) != NOBODY and self.time_s[row] >= first_s:
            trail.append(row)
        return centres(self.tracks.boxes_px[trail])

    def sentence(self) -> str:
        """Summary of the tracks, in one sentence."""
        identity, count = self.tracks.identity, int(self.tracks.identity.max(initial=-1)) + 1
        on_vessel = np.zeros(count, dtype=bool)
        on_vessel[identity[~self.false]] = True
        vessels = len(np.unique(self.vessel[~self.false]))
        return (
            f"Tracks of {self.name}: {counted(count, 'track')} on {counted(vessels, 'vessel')}, "
            f"{counted(int(self.switched.sum()), 'identity switch', 'identity switches')}, "
            f"{counted(int((~on_vessel).sum()), 'false track')}."
        )


def followed_tracks(
    tracks: StrPath | None, run: StoredRun, similarity: str | None, threshold: float | None
) -> FollowedTracks | None:
    """Tracks of a run with the vessels that they follow, of what `modsim3d.report` takes; None without tracks. Raises
    ModsimError if the run is not finished or the tracks are wrong, and for a similarity without tracks."""
    if tracks is None:
        if (similarity, threshold) != (None, None):
            raise ModsimError("--similarity and --threshold are for --tracks")
        return None
    compared, path = Similarity.parse(similarity, 0.5 if threshold is None else threshold), as_path(tracks, "tracks")
    if not run.finished:
        raise ModsimError(
            f"{run.folder} holds an interrupted run, and tracks need a finished one: go on with modsim3d run --resume"
        )
    rows = RunRows.of(run)
    return FollowedTracks.of(read_tracks(path, run, rows), rows, compared)


def read_of_tracks(tracks: StrPath | None) -> list[Path]:
    """Files that are read of tracks, so that none of them is written."""
    if tracks is None:
        return []
    path = as_path(tracks, "tracks")
    return sorted(inner for inner in path.rglob("*") if inner.is_file()) if path.is_dir() else [path]


def _vessels(following: TrackMatching) -> Indices:
    """Index of the vessel that each row of the tracks follows, `NOBODY` for none."""
    return np.append(following.truth.vessel, NOBODY)[following.truth_row]


def _changed(owner: Indices, partner: Indices, counted: Mask) -> Mask:
    """Rows at which an owner has another partner than at its counted row before; rows in order of time, shape (n,)."""
    rows = np.flatnonzero(counted)
    order = rows[np.argsort(owner[rows], kind="stable")]
    changed = np.zeros(len(owner), dtype=bool)
    changed[order[1:]] = (np.diff(owner[order]) == 0) & (np.diff(partner[order]) != 0)
    return changed
