"""What all scores are taken from: a run, and the one matching of its vessels and the tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.scores.rules import Rules
from modsim3d.tracks.following import Following, follow
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks


@dataclass(frozen=True, eq=False)
class Scored:
    """Tracks in the frames of a run, held against its truth.

    Attributes:
        rows: The run.
        rules: The rules.
        following: Which track follows which vessel, of all vessels in the image.
        frames: Numbers of the frames that count, ascending, shape (F,).
    """

    rows: RunRows
    rules: Rules
    following: Following
    frames: Indices

    @classmethod
    def of(cls, rows: RunRows, tracks: Tracks, rules: Rules) -> Self:
        """Match all tracks with all vessels."""
        truth = TrueTracks.of(rows, rules.truth, rules.gap_s)
        return cls(rows, rules, follow(truth, tracks, rules.similarity), rows.frames)

    def in_frames(self, frames: Indices) -> Self:
        """The same matching, some frames of it only."""
        return replace(self, frames=frames)

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
        """What a frame's number is divided by to give its step."""
        return self.following.truth.cameras

    def state_frames(self, state: int) -> Indices:
        """The frames of a performance state, shape (f,)."""
        chosen: Indices = self.frames[self.rows.states_of(self.frames) == state]
        return chosen
