"""AIS files in, a scene folder out: the parts in their order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.ais.cleaning import DUPLICATE, JUMP, OUTSIDE_WINDOW, SLACK_S, blank_unknown, in_order
from modsim3d.ais.gathering import FileTally, Gathered, gather
from modsim3d.ais.headings import KNOT_M_S, MOVING_KN, From, fill_courses, fill_headings
from modsim3d.ais.hulls import Hull, hulls
from modsim3d.ais.jumps import reachable
from modsim3d.ais.options import Options, time_text
from modsim3d.ais.projection import heading_rad, local_metres, median_place
from modsim3d.ais.reports import Positions
from modsim3d.ais.resampling import ROUNDING_S, Track, resample, to_hull_centre
from modsim3d.ais.viewpoint import Viewpoint, viewpoint
from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError, ModsimError
from modsim3d.poses.base import generated_timestamps

MAX_STEPS = 1_000_000
MAX_POSES = 3_000_000
"""About 250 MB of JSON; reading it again takes some minutes and gigabytes."""
EXCHANGE_HINT = "if latitude and longitude are in each other's place: --swap-coordinates exchanges them in all tables"
HEADING_NAMES = {
    From.COURSE: "heading_from_course",
    From.BEARING: "heading_from_bearing",
    From.HELD: "heading_held",
    From.NOTHING: "heading_unknown",
}


@dataclass(frozen=True, eq=False)
class VesselTrack:
    """One vessel of the traffic.

    Attributes:
        mmsi: Its identity.
        hull: Dimensions and type.
        messages: Positions that were used.
        replaced: What was missing → in how many of them it was replaced.
        present: At which steps it is there, shape (S,).
        places_m: Centres of the hull, shape (S, 2).
        headings_rad: Counter-clockwise from w1, shape (S,).
    """

    mmsi: int
    hull: Hull
    messages: int
    replaced: Counter[str]
    present: Mask
    places_m: Array
    headings_rad: Array


@dataclass(frozen=True, eq=False)
class Traffic:
    """All that a scene folder is written from.

    Attributes:
        options: What was asked for.
        files: What was found in each file.
        dropped: Reason → messages left out, of all files and afterwards.
        origin: Latitude and longitude of w1 = w2 = 0.
        start_s: Unix time of the first step.
        timestamps: Text of each step's time since then.
        vessels: Those that are there at some step, by identity.
        elsewhere: Identities of vessels with usable positions that are there at no step.
        camera: Where one may look from.
    """

    options: Options
    files: list[FileTally]
    dropped: Counter[str]
    origin: tuple[float, float]
    start_s: float
    timestamps: tuple[str, ...]
    vessels: list[VesselTrack]
    elsewhere: list[int]
    camera: Viewpoint


def read_traffic(paths: Sequence[Path], options: Options) -> Traffic:
    """Tracks of all vessels in some files, on the time grid of a scene.

    Args:
        paths: AIS files of any of the known formats, in any order.
        options: How.

    Raises:
        InputError: Something is wrong with a file, or no vessel is left.
        ModsimError: It is too much for one scene.
    """
    options.check()
    gathered = gather(paths, options)
    dropped = Counter[str]()
    for tally in gathered.files:
        dropped.update(tally.dropped)
    positions, dropped[DUPLICATE] = in_order(gathered.positions)
    positions = blank_unknown(positions)
    if not len(positions):
        raise _nothing_left(gathered, options)
    start_s, times_s, timestamps = _grid(positions, options)
    first_s, last_s = start_s - options.max_gap_s, start_s + float(times_s[-1]) + options.max_gap_s
    outside = (positions.time_s < first_s) | (positions.time_s > last_s)
    dropped[OUTSIDE_WINDOW] += int(outside.sum())
    positions = positions.take(~outside)
    if not len(positions):
        raise _nothing_left(gathered, options)
    origin = options.origin or _origin(positions, start_s, times_s)
    places = local_metres(positions.latitude_deg, positions.longitude_deg, origin)
    bounds = np.r_[0, np.flatnonzero(np.diff(positions.mmsi)) + 1, len(positions)]
    every_hull = hulls(gathered.particulars, positions.mmsi[bounds[:-1]].tolist())
    vessels, elsewhere, poses = [], [], 0
    for first, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        mmsi = int(positions.mmsi[first])
        own = positions.take(np.arange(first, stop))
        track, jumped = _vessel(own, places[first:stop], every_hull[mmsi], start_s, times_s, options)
        dropped[JUMP] += jumped
        poses += int(track.present.sum())
        if poses > MAX_POSES:
            raise ModsimError(
                f"this would be more than {MAX_POSES:,} poses: take less of it (--start, --duration, --region), "
                "or fewer steps (--time-step)"
            )
        if track.present.any():
            vessels.append(track)
        else:
            elsewhere.append(mmsi)
    if not vessels:
        raise _nothing_left(gathered, options)
    camera = viewpoint(
        np.stack([vessel.present for vessel in vessels], axis=1),
        np.stack([vessel.places_m for vessel in vessels], axis=1),
        np.array([vessel.hull.length_m / 2 for vessel in vessels]),
    )
    return Traffic(options, gathered.files, dropped, origin, start_s, timestamps, vessels, elsewhere, camera)


def _grid(positions: Positions, options: Options) -> tuple[float, Array, tuple[str, ...]]:
    """Unix time of the first step, times of all steps since then, and the texts of these."""
    start = float(positions.time_s.min()) if options.start_s is None else options.start_s
    if options.duration_s is not None:
        span = options.duration_s
    else:
        span = (float(positions.time_s.max()) if options.end_s is None else options.end_s) - start
    steps = int(np.floor(span / options.time_step_s + ROUNDING_S)) + 1 if span >= 0 else 1
    if steps > MAX_STEPS:
        raise ModsimError(
            f"from {time_text(start)} to {time_text(start + span)} in steps of {options.time_step_s:g} s would be "
            f"{steps:,} steps, more than {MAX_STEPS:,}: choose --start and --duration, or a larger --time-step"
        )
    timestamps = generated_timestamps(steps, options.time_step_s)
    return start, np.array([float(text) for text in timestamps]), timestamps


def _origin(positions: Positions, start_s: float, times_s: Array) -> tuple[float, float]:
    """The median position within the scene's time, or of all if there is none, to seven decimals (1 cm)."""
    within = (positions.time_s >= start_s) & (positions.time_s <= start_s + times_s[-1])
    chosen = positions.take(within) if within.any() else positions
    latitude, longitude = median_place(chosen.latitude_deg, chosen.longitude_deg)
    return round(latitude, 7), round(longitude, 7)


def _vessel(
    positions: Positions, places_m: Array, hull: Hull, start_s: float, times_s: Array, options: Options
) -> tuple[VesselTrack, int]:
    """The track of one vessel, and how many of its positions it cannot have reached."""
    kept = reachable(positions.time_s - start_s, places_m, options.max_speed_kn * KNOT_M_S, SLACK_S)
    positions, places = positions.take(kept), places_m[kept]
    since_s = positions.time_s - start_s
    speed, course, heading = positions.speed_kn, positions.course_deg, positions.heading_deg
    compass, source = fill_headings(since_s, places, speed, course, heading, options.max_gap_s)
    filled_course, course_taken = fill_courses(course, heading, speed)
    motion = speed * KNOT_M_S
    # A vessel that lies still has a velocity, whatever its course.
    direction = np.deg2rad(np.where(np.isnan(filled_course) & (speed == 0), 0.0, filled_course))
    velocities = np.stack([motion * np.sin(direction), motion * np.cos(direction)], axis=-1)
    track = Track(since_s, places, velocities, heading_rad(compass))
    present, antenna, headings = resample(track, times_s, options.max_gap_s)
    replaced = Counter({name: int((source == kind).sum()) for kind, name in HEADING_NAMES.items()})
    replaced["course_from_heading"] = int(course_taken.sum())
    replaced["course_unknown"] = int((np.isnan(filled_course) & ~(speed < MOVING_KN)).sum())
    replaced["speed_unknown"] = int(np.isnan(speed).sum())
    centres = to_hull_centre(antenna, headings, hull.ahead_m, hull.to_port_m)
    return VesselTrack(int(positions.mmsi[0]), hull, len(positions), +replaced, present, centres, headings), int(
        (~kept).sum()
    )


def _nothing_left(gathered: Gathered, options: Options) -> InputError:
    asked = []
    if options.start_s is not None or options.end_s is not None:
        span = [time_text(time) if time is not None else "…" for time in (options.start_s, options.end_s)]
        asked.append(f"from {span[0]} to {span[1]}")
    if options.region is not None:
        asked.append(f"in the region {options.region}")
    dropped = Counter[str]()
    for tally in gathered.files:
        dropped.update(tally.dropped)
    reasons = ", ".join(f"{name} {count}" for name, count in sorted((+dropped).items()))
    return InputError(
        "AIS files",
        [
            f"no positions of ships {' '.join(asked)}".rstrip() + f": {gathered.extent}",
            *([f"left out: {reasons}"] if reasons else []),
            *([EXCHANGE_HINT] if options.region is not None else []),
        ],
    )
