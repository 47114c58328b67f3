"""The tracks of a tracker for the player of a run's page: columns of numbers, and what they mean."""

from __future__ import annotations

from typing import Any

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.report.packing import Column, in_quanta, starts
from modsim3d.view.report.silhouettes import NONE

UNSCORED, SWITCHED, MOVED = 1, 2, 4
"""What is so of a row, as bits of the column `trackFlags`."""


def track_columns(followed: FollowedTracks, frames: Indices, pages: int, quantum: float) -> dict[str, Column]:
    """The tracks in some frames, by their numbers; the recording has so many pages.

    A lane is one track of one camera. A switch in a frame that is not shown is marked at its track's next box that is.
    """
    tracks = followed.tracks
    drawn = np.flatnonzero(np.isin(tracks.frame, frames))
    flags = UNSCORED * followed.unscored
    for bit, marked in ((SWITCHED, followed.switched), (MOVED, followed.moved)):
        flags = flags + bit * _at_next(np.flatnonzero(marked), tracks.identity, drawn)
    return {
        "trackStart": starts(np.searchsorted(frames, tracks.frame[drawn]), pages),
        "trackLane": tracks.identity[drawn].astype(np.uint32),
        "trackVessel": np.where(followed.false, NONE, followed.vessel)[drawn].astype(np.uint16),
        "trackFlags": flags[drawn].astype(np.uint8),
        "trackBox": in_quanta(tracks.boxes_px[drawn], quantum),
    }


def track_facts(followed: FollowedTracks) -> dict[str, Any]:
    """What the columns mean, and the number of the track of each lane."""
    _, first = np.unique(followed.tracks.identity, return_index=True)
    return {
        "name": followed.name,
        "numbers": followed.tracks.track[first].tolist(),
        "flags": {"UNSCORED": UNSCORED, "SWITCHED": SWITCHED, "MOVED": MOVED},
        "rule": f"{followed.similarity} below {followed.similarity.least:g}",
    }


def _at_next(marked: Indices, identity: Indices, drawn: Indices) -> Column:
    """Whether each row is the first drawn one of its track at or after a marked one, shape (k,)."""
    order = np.lexsort((drawn, identity[drawn]))
    keys = identity[drawn[order]] * len(identity) + drawn[order]  # ascending, as rows are in order of time
    place = np.searchsorted(keys, identity[marked] * len(identity) + marked)
    found = place < len(keys)
    row = drawn[order[place[found]]]
    at = np.zeros(len(identity), dtype=bool)
    at[row[identity[row] == identity[marked[found]]]] = True
    return at
