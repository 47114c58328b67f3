"""Source of all scores: a run, and the one matching of its vessels and the tracks."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.tracks.true_tracks import DEFAULT_GAP_S, TrackMatching, TrueTracks, TruthName, follow

MAX_CUTOFF = 1e6  # more than any distance in an image, and its tenth power is still a number


@dataclass(frozen=True)
class SetDistance:
    """Costs in GOSPA and OSPA: the base distance is that of the centres."""

    cutoff: float = 100.0  # c, in the unit of the distance; missed and false ones cost c^p / 2 each in GOSPA
    power: float = 1.0  # p; with 1 the parts are additive distances
    switch: float | None = None  # γ of T-GOSPA, what a change of a vessel's track costs; c if None

    def __post_init__(self) -> None:
        """Raise ModsimError if a value is out of range."""
        if not 0 < self.cutoff <= MAX_CUTOFF:
            raise ModsimError(f"--gospa C: must be above 0 and at most {MAX_CUTOFF:,.0f} (got {self.cutoff:g})")
        if not 1 <= self.power <= 10:
            raise ModsimError(f"--gospa C:P: must have a power from 1 to 10 (got {self.power:g})")
        if self.switch is not None and not 0 < self.switch <= MAX_CUTOFF:
            raise ModsimError(f"--gospa C:P:G: must have a G above 0, at most {MAX_CUTOFF:,.0f} (got {self.switch:g})")


@dataclass(frozen=True)
class Rules:
    """The rules by which tracks are scored."""

    truth: TruthName = "annotated"  # what tracks are held against, as in `TrueTracks.of`
    gap_s: float = DEFAULT_GAP_S  # after so long outside the image a vessel that comes back is a new identity
    similarity: Similarity = field(default_factory=Similarity)  # of boxes
    by_class: bool = False  # whether only tracks of a vessel's class count for it
    set_distance: SetDistance = field(default_factory=SetDistance)  # of GOSPA and OSPA, in pixels
    cameras: tuple[str, ...] = ()  # names of those that are scored, in the order of the scene; all if there are none

    def __post_init__(self) -> None:
        """Raise ModsimError if the gap is out of range."""
        if not 0 <= self.gap_s < np.inf:
            raise ModsimError(f"--gap must be 0 or more seconds (got {self.gap_s:g})")


@dataclass(frozen=True, eq=False)
class ScoredRun:
    """Tracks in the frames of a run, held against its truth."""

    rows: RunRows
    rules: Rules
    following: TrackMatching  # which track follows which vessel, of all vessels in the image
    frames: Indices  # numbers of the frames that count, ascending, shape (F,)

    @classmethod
    def of(cls, rows: RunRows, tracks: Tracks, rules: Rules) -> Self:
        """Match all tracks with all vessels."""
        truth = TrueTracks.of(rows, rules.truth, rules.gap_s)
        return cls(rows, rules, follow(truth, tracks, rules.similarity, rows.regions), rows.frames)

    @cached_property
    def truth(self) -> TrueTracks:
        """The vessels that are scored in these frames."""
        return self.following.truth.take(self.truth_rows)

    @cached_property
    def tracks(self) -> Tracks:
        """The tracks that are scored in these frames: not those on a vessel that is not scored."""
        return self.following.tracks.take(self.track_rows)

    @cached_property
    def truth_rows(self) -> Indices:
        """Rows of the matching's vessels that are scored, shape (n,)."""
        truth = self.following.truth
        return np.flatnonzero(truth.scored & np.isin(truth.frame, self.frames))

    @cached_property
    def track_rows(self) -> Indices:
        """Rows of the matching's tracks that are scored, shape (k,)."""
        following = self.following
        return np.flatnonzero(following.counted & np.isin(following.tracks.frame, self.frames))

    @cached_property
    def pairs(self) -> tuple[Indices, Indices]:
        """Rows of the matching's vessels that are scored and followed, and of the tracks that do, shapes (m,)."""
        rows = self.truth_rows[self.following.track_row[self.truth_rows] != NOBODY]
        return rows, self.following.track_row[rows]

    @cached_property
    def times_s(self) -> Array:
        """Time of each step since the first, shape (steps,)."""
        return self.rows.scene.times_s(0, self.rows.steps)

    @property
    def by_step(self) -> int:
        """Divisor that turns a frame's number into its step."""
        return self.following.truth.cameras

    def state_frames(self, state: int) -> Indices:
        """The frames of a performance state, shape (f,)."""
        chosen: Indices = self.frames[self.rows.states_of(self.frames) == state]
        return chosen


@dataclass(frozen=True, eq=False)
class Histories:
    """All vessels of a matching, n rows in order of identity and frame, whether they are scored or not; shapes (n,)."""

    row: Indices  # of the matching's vessels
    identity: Indices  # number of the appearance
    frame: Indices  # number of the frame
    time_s: Array  # of the frame since the first step
    hidden: Mask  # whether other things hide all of the vessel
    visible_fraction: Array  # NaN where unknown
    track: Indices  # identity of the track that follows it, `NOBODY` for none
    counted: Mask  # whether the frame is among those that count

    @classmethod
    def of(cls, scored: ScoredRun) -> Self:
        """Histories of a matching."""
        following, truth = scored.following, scored.following.truth
        order = np.lexsort((truth.frame, truth.identity))
        track = np.append(following.tracks.identity, NOBODY)[following.track_row]  # the last is that of NOBODY
        return cls(
            order,
            truth.identity[order],
            truth.frame[order],
            scored.times_s[truth.frame[order] // scored.by_step],
            truth.hidden[order],
            scored.rows.numbers("visible_fraction")[truth.row[order]],
            track[order],
            np.isin(truth.frame[order], scored.frames),
        )

    @property
    def followed(self) -> Mask:
        """Whether a track follows the vessel, shape (n,)."""
        return np.not_equal(self.track, NOBODY)

    def last_before(self, wanted: Mask) -> Indices:
        """The last wanted place before each place in the history of its identity, `NOBODY` if there is none, (n,)."""
        count = len(self.row)
        latest = np.maximum.accumulate(np.where(wanted, np.arange(count), NOBODY))
        before = np.concatenate([[NOBODY], latest])[:count]
        return self._own(before)

    def first_after(self, wanted: Mask) -> Indices:
        """The first wanted place after each place in the history of its identity, `NOBODY` if there is none, (n,)."""
        count = len(self.row)
        next_ones = np.minimum.accumulate(np.where(wanted, np.arange(count), count)[::-1])[::-1]
        after = np.concatenate([next_ones, [count]])[1:]
        return self._own(np.where(after < count, after, NOBODY))

    def _own(self, place: Indices) -> Indices:
        """Places in the history of another identity replaced by `NOBODY`, shape (n,)."""
        same = np.append(self.identity, NOBODY)[place] == self.identity
        return np.where(same, place, NOBODY)


def frame_lengths_s(rows: RunRows, frames: Indices) -> Array:
    """The time from each of k frames, given by their numbers, to the camera's next one, shape (k,). A camera's last
    frame stands for as long as the one before it, and an only frame for a frame of the camera's rate."""
    every, cameras, times_s = rows.frames, len(rows.scene.cameras), rows.scene.times_s(0, rows.steps)
    length_s = np.empty(len(every))
    for index, camera in enumerate(rows.scene.cameras):
        here = np.flatnonzero(every % cameras == index)
        apart = np.diff(times_s[every[here] // cameras])
        alone = 1 / (camera.frame_rate_hz or 1.0)
        length_s[here] = np.append(apart, apart[-1:] if len(apart) else alone)[: len(here)]
    spans_s: Array = length_s[np.searchsorted(every, frames)]
    return spans_s


class RowStretches(NamedTuple):
    """Stretches of rows that follow each other: places of the first and last row of each, shapes (r,)."""

    first: Indices
    last: Indices


def stretches(group: Indices, place: Indices) -> RowStretches:
    """Stretches in which the group stays and the place grows by 1 from row to row. Rows of a group stand together, and
    `place`, of each row in its group, ascends in it; shapes (k,)."""
    ends = np.flatnonzero((np.diff(group) != 0) | (np.diff(place) != 1)) + 1
    if not len(group):
        return RowStretches(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    return RowStretches(np.append(0, ends), np.append(ends, len(group)) - 1)
