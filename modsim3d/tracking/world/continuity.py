"""How much of the time vessels are followed in the world, by how many tracks, and tracks of nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.runs.files.columns import NOBODY
from modsim3d.tracking.world.errors import OverVessels
from modsim3d.tracking.world.following import WorldFollowing


@dataclass(frozen=True)
class WorldContinuity:
    """Continuity over the steps at which vessels are scored.

    Attributes:
        vessels: Number of vessels that are scored at some step.
        established: Number of those that are followed at one of these steps.
        followed_share: Share of a vessel's scored steps at which it is followed.
        id_switches: How often a vessel is followed by another track than when it was followed last.
        track_breaks: Stretches of scored steps without a track, between two with one.
        false_tracks: Number of tracks that never follow a vessel, scored or not.
        false_track_s: Their time, that of the steps at which they are there.
    """

    vessels: int
    established: int
    followed_share: OverVessels
    id_switches: int
    track_breaks: int
    false_tracks: int
    false_track_s: float


def world_continuity(following: WorldFollowing) -> WorldContinuity:
    """Continuity of all vessels, and false tracks."""
    scored, found = following.truth.scored, following.found
    steps, followed = scored.sum(axis=0), found.sum(axis=0)
    share = np.where(steps > 0, followed / np.maximum(steps, 1), np.nan)
    tracks = following.tracks.track[following.estimates.row]
    false = ~np.isin(tracks, tracks[following.vessel != NOBODY])
    length_s = step_lengths_s(following.truth.times_s)
    pairs = [_switches_and_breaks(following, vessel) for vessel in np.flatnonzero(followed).tolist()]
    return WorldContinuity(
        vessels=int((steps > 0).sum()),
        established=int((followed > 0).sum()),
        followed_share=OverVessels.of(share),
        id_switches=sum(switches for switches, _ in pairs),
        track_breaks=sum(breaks for _, breaks in pairs),
        false_tracks=len(np.unique(tracks[false])),
        false_track_s=float(length_s[following.estimates.step[false]].sum()),
    )


def _switches_and_breaks(following: WorldFollowing, vessel: int) -> tuple[int, int]:
    """Of a vessel that is followed at some step."""
    row = following.followed_by[following.truth.scored[:, vessel], vessel]
    on = row != NOBODY
    switches = int((np.diff(following.tracks.track[row[on]]) != 0).sum())
    begins = int((np.diff(on.astype(np.int64)) == 1).sum())  # each but one that ends the wait before the first
    return switches, begins - int(not on[0])


def step_lengths_s(times_s: Array) -> Array:
    """Time from each step to the next; the last is as long as the one before it, shape (S,)."""
    gaps = np.diff(times_s)
    return np.append(gaps, gaps[-1]) if len(gaps) else np.zeros(len(times_s))
