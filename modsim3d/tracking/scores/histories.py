"""The frames of each identity one after another, and which track followed it in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.runs.files.columns import NOBODY
from modsim3d.tracking.scores.scored import Scored


@dataclass(frozen=True, eq=False)
class Histories:
    """All vessels of a matching, n rows in order of identity and frame, whether they are scored or not.

    Attributes:
        row: Row of the matching's vessels, shape (n,).
        identity: Number of the appearance, shape (n,).
        frame: Number of the frame, shape (n,).
        time_s: Time of the frame since the first step, shape (n,).
        hidden: Whether other things hide all of the vessel, shape (n,).
        visible_fraction: NaN where unknown, shape (n,).
        track: Identity of the track that follows it, `NOBODY` for none, shape (n,).
        counted: Whether the frame is among those that count, shape (n,).
    """

    row: Indices
    identity: Indices
    frame: Indices
    time_s: Array
    hidden: Mask
    visible_fraction: Array
    track: Indices
    counted: Mask

    @classmethod
    def of(cls, scored: Scored) -> Self:
        """Those of a matching."""
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
