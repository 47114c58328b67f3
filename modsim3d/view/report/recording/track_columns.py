"""The tracks of a tracker for the player of a run's page: columns of numbers, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.runs.files.columns import NOBODY
from modsim3d.scene.scene import Scene
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.report.recording.overview import rows_of
from modsim3d.view.report.recording.packing import NONE, ROW_BEFORE, Coded, Column, in_quanta, starts
from modsim3d.view.report.recording.part_columns import PartFrames
from modsim3d.view.report.recording.stretches import StretchesBuilder

UNSCORED, SWITCHED, MOVED = 1, 2, 4
"""What is so of a row, as bits of the column `trackFlags`."""


class TrackRows:
    """The rows of tracks that a recording shows, and what is marked at them.

    A switch in a frame that is not shown is marked at its track's next box that is.
    """

    def __init__(self, followed: FollowedTracks, scene: Scene, steps: Indices) -> None:
        """Find the rows in the frames that the cameras show at ascending steps, shape (S,)."""
        tracks = followed.tracks
        self._followed, self._drawn = followed, np.flatnonzero(np.isin(tracks.frame, _shown_frames(scene, steps)))
        flags = UNSCORED * followed.unscored
        for bit, marked in ((SWITCHED, followed.switched), (MOVED, followed.moved)):
            flags = flags + bit * _at_next(np.flatnonzero(marked), tracks.identity, self._drawn)
        self._flags = flags

    def columns(self, frames: PartFrames, quantum: float) -> dict[str, Column | Coded]:
        """The rows in the frames of a part. A lane is one track of one camera."""
        followed, tracks = self._followed, self._followed.tracks
        first, last = (int(reach(frames.numbers)) for reach in (np.min, np.max)) if frames.count else (0, -1)
        some = self._drawn[slice(*np.searchsorted(tracks.frame[self._drawn], (first, last + 1)).tolist())]
        frame = frames.of(tracks.frame[some])
        order = np.argsort(frame, kind="stable")
        order = order[frame[order] != NOBODY]
        rows = some[order]
        return {
            "trackStart": Coded(starts(frame[order], frames.pages), by=ROW_BEFORE),
            "trackLane": Coded(tracks.identity[rows].astype(np.uint32), by=ROW_BEFORE),
            "trackVessel": Coded(
                np.where(followed.false, NONE, followed.vessel)[rows].astype(np.uint16), by="trackLane"
            ),
            "trackFlags": self._flags[rows].astype(np.uint8),
            "trackBox": Coded(in_quanta(tracks.boxes_px[rows], quantum), by="trackLane"),
        }


def _shown_frames(scene: Scene, steps: Indices) -> Indices:
    """The numbers of the frames that the cameras show at ascending steps, shape (S,)."""
    found = []
    for camera, each in enumerate(scene.cameras):
        taken = scene.frame_steps(each, 0, int(steps[-1]) + 1)
        place = np.searchsorted(taken, steps, side="right") - 1
        found.append(taken[place[place >= 0]] * len(scene.cameras) + camera)
    return np.unique(np.concatenate(found))


class Lanes:
    """Which vessel each track of one camera follows, over a run that comes in parts."""

    def __init__(self, vessels: int) -> None:
        """Begin with no track in a scene with so many vessels."""
        self._vessels = vessels
        self._found, self._marks = StretchesBuilder(), [np.empty((0, 3), dtype=np.int64)]
        self._taken = NOBODY

    def add(self, index: Indices, shown: Indices, taken: Indices, columns: Mapping[str, Column]) -> None:
        """Add the tracks at some steps: their indices, the frame of each in a part, and its step, all of shape (i,)."""
        rows, at = rows_of(shown, columns["trackStart"])
        lane, flags = columns["trackLane"][rows].astype(np.int64), columns["trackFlags"][rows]
        vessel = columns["trackVessel"][rows].astype(np.int64)
        vessel = np.where(vessel == NONE, self._vessels, vessel)
        key = (lane * (self._vessels + 1) + vessel) * 2 + (flags & UNSCORED > 0)
        self._found.add(key, index[at])
        new = np.diff(taken, prepend=self._taken) != 0
        marked = np.flatnonzero(new[at] & (flags & (SWITCHED | MOVED) > 0))
        self._marks.append(np.column_stack([lane[marked], index[at[marked]], flags[marked]]))
        self._taken = int(taken[-1])

    def columns(self, prefix: str) -> dict[str, Column | Coded]:
        """The stretches of the lanes in order of time, and their marks."""
        found = self._found.stretches().by_time()
        lane_and_vessel, pale = np.divmod(found.key, 2)
        lane, vessel = np.divmod(lane_and_vessel, self._vessels + 1)
        vessel = np.where(vessel == self._vessels, NONE, vessel)
        marks = np.concatenate(self._marks)
        return {
            f"{prefix}lane": Coded(lane.astype(np.uint32), by=ROW_BEFORE),
            f"{prefix}index": Coded(found.first.astype(np.uint32), by=ROW_BEFORE),
            f"{prefix}long": Coded((found.until - found.first).astype(np.uint32)),
            f"{prefix}vessel": Coded(vessel.astype(np.uint16), by=f"{prefix}lane"),
            f"{prefix}pale": pale.astype(np.uint8),
            f"{prefix}markLane": marks[:, 0].astype(np.uint32),
            f"{prefix}markIndex": Coded(marks[:, 1].astype(np.uint32), by=ROW_BEFORE),
            f"{prefix}markFlags": marks[:, 2].astype(np.uint8),
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
