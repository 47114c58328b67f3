"""Approaches of vessels to own ship: how far away each came into view, and from where on a track kept it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.world.following import WorldMatching, in_last_frames, visibility
from modsim3d.tracks.true_tracks import TrackMatching
from modsim3d.world.encounters import hull_tracks

LOST_S = 5.0  # a vessel in view that no track follows for longer is lost
_DECIMALS = 3


@dataclass(frozen=True)
class VesselApproach:
    """A vessel that a camera of own ship saw. Distances are of the centres, each the least so far at that moment: a
    vessel was known before it came to R if `known_m` is R or more."""

    own_ship: str  # ID
    vessel: str  # ID
    label: str
    length_m: float
    in_view_m: float  # when a camera of own ship first saw a pixel of it
    closest_m: float  # at the closest approach in the run
    known_m: float  # from when on tracks followed it until the closest approach, never lost while in view; 0 if never
    one_track_m: float  # from when on the same track did


def tracks_in_images(rows: RunRows, following: TrackMatching) -> Indices:
    """Number of the track that follows each of V vessels in the last frame of each of C cameras at S steps, shape
    (S, C, V); `NOBODY` for none. Tracks of two cameras are two."""
    identity = np.append(following.tracks.identity, NOBODY)[following.track_row]  # the last is that of NOBODY
    return in_last_frames(rows, following.truth.frame, following.truth.vessel, identity)


def tracks_in_world(rows: RunRows, following: WorldMatching) -> Indices:
    """Number of the track in the world that follows each vessel, as in `tracks_in_images`, for each camera the same."""
    track = np.append(following.tracks.track, NOBODY)[following.followed_by]
    return np.repeat(track[:, None], len(rows.scene.cameras), axis=1)


def approaches(rows: RunRows, track: Indices) -> Iterator[VesselApproach]:
    """All vessels that came into view of each own ship; `track` is as in `tracks_in_images`."""
    scene, in_view = rows.scene, visibility(rows)
    centres_m = hull_tracks(scene.vessels, scene.poses, rows.steps).centres_m
    times_s = scene.times_s(0, rows.steps)
    step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    for own in scene.own_ships:
        name = scene.vessel_names[own]
        mine = [index for index, camera in enumerate(scene.cameras) if camera.mount.vessel == name]
        followed = np.where(in_view, track, NOBODY)[:, mine].max(axis=1)
        for index in np.flatnonzero(in_view[:, mine].any(axis=(0, 1))).tolist():
            apart_m = np.hypot(*(centres_m[:, index] - centres_m[:, own]).T)
            so_far_m = np.fmin.accumulate(apart_m)
            steps = np.flatnonzero(in_view[:, mine, index].any(axis=1))
            before = steps[steps <= int(np.nanargmin(apart_m))]
            here, vessel = followed[before, index], scene.vessels[index]
            kept = [so_far_m[before[_kept_from(here, step_s, same) :]][:1].sum() for same in (False, True)]
            distances = (so_far_m[steps[0]], so_far_m[-1], *kept)
            rounded = (round(float(distance), _DECIMALS) for distance in distances)
            yield VesselApproach(name, vessel.name, vessel.label, vessel.length_m, *rounded)


def _kept_from(track: Indices, step_s: float, same: bool) -> int:
    """Place in the steps in view, (n,), from which on tracks follow a vessel until the last, and are never away for
    longer than `LOST_S`; with `same` it is one track. n if there is none."""
    places = np.flatnonzero(track != NOBODY)
    away: Array = (np.diff(np.append(places, len(track))) - 1) * step_s
    ends = away > LOST_S
    if same:
        ends[:-1] |= np.diff(track[places]) != 0
    kept = places[np.flatnonzero(ends)[-1] + 1 :] if ends.any() else places
    return int(kept[0]) if len(kept) else len(track)
