"""The track of one vessel at the steps of a scene, from its reports."""

from collections import Counter
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.scene.ais.hulls import AisHull
from modsim3d.scene.ais.messages import Positions, reachable
from modsim3d.scene.ais.options import Options, time_text
from modsim3d.world.poses.base import generated_timestamps

TRUST_M, TRUST_SHARE = 15.0, 0.25
"""Two reported velocities are used if their mean times the interval misses the way between the positions by at most
TRUST_M plus TRUST_SHARE of that way."""
ROUNDING_S = 1e-6


@dataclass(frozen=True, eq=False)
class ReportedTrack:
    """Reports of one vessel, with the places of its antenna."""

    times_s: Array  # ascending, (n,)
    places_m: Array  # east and north, (n, 2)
    velocities_m_s: Array  # east and north, NaN where unknown, (n, 2)
    headings_rad: Array  # counter-clockwise from w1, (n,)


def steps_near(known_s: Array, times_s: Array, max_gap_s: float) -> Indices:
    """The times, shape (m,) ascending, at which a vessel with some reports may be there, as indices, shape (k,). These
    are all from one report, shape (n,) ascending, to the next, where they are not further apart than the longest gap,
    and those at a report. A vessel with a few reports costs little then, however long the scene is."""
    joined = np.append(np.diff(known_s) <= max_gap_s, False)
    last = np.where(joined, np.append(known_s[1:], known_s[-1:]), known_s)
    stops = np.searchsorted(times_s, last + ROUNDING_S, side="right")
    starts = np.searchsorted(times_s, known_s - ROUNDING_S, side="left")
    starts = np.maximum(starts, np.maximum.accumulate(np.append(0, stops[:-1])))
    counts = np.maximum(stops - starts, 0)
    return np.repeat(starts - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())


def resample(track: ReportedTrack, times_s: Array, max_gap_s: float) -> tuple[Mask, Array, Array]:
    """Whether a vessel is there at some times, shape (m,), its places in metres, (m, 2), and headings in radians, (m,).
    Between two reports the vessel follows the cubic with the reported velocities at both ends (cubic Hermite
    interpolation), or a straight line where these are unknown or do not fit the positions. Its heading turns evenly
    along the shorter arc. The vessel is away before the first report, after the last, and between reports that are
    further apart than the longest gap."""
    reports_s = track.times_s
    if len(reports_s) == 1:
        present = np.abs(times_s - reports_s[0]) <= ROUNDING_S
        return present, np.repeat(track.places_m, len(times_s), axis=0), np.full(len(times_s), track.headings_rad[0])
    within = (times_s >= reports_s[0] - ROUNDING_S) & (times_s <= reports_s[-1] + ROUNDING_S)
    leg = np.clip(np.searchsorted(reports_s, times_s, side="right") - 1, 0, len(reports_s) - 2)
    span_s = reports_s[leg + 1] - reports_s[leg]
    share = np.clip((times_s - reports_s[leg]) / span_s, 0.0, 1.0)
    on_report = np.minimum(share, 1 - share) * span_s <= ROUNDING_S
    present = within & ((span_s <= max_gap_s) | on_report)
    turn = np.diff(track.headings_rad)
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    return present, _places(track, leg, share), track.headings_rad[leg] + share * turn[leg]


def _places(track: ReportedTrack, leg: Indices, share: Array) -> Array:
    span_s = np.diff(track.times_s)[:, None]
    way = np.diff(track.places_m, axis=0)
    leaving, arriving = track.velocities_m_s[:-1] * span_s, track.velocities_m_s[1:] * span_s
    miss = np.linalg.norm((leaving + arriving) / 2 - way, axis=1)
    trusted = miss <= TRUST_M + TRUST_SHARE * np.linalg.norm(way, axis=1)  # false where one is unknown
    leaving, arriving = (np.where(trusted[:, None], velocity, way) for velocity in (leaving, arriving))
    u = share[:, None]
    # Hermite's basis, as what is added to the straight line: it vanishes where both velocities are the mean one.
    bend = u * (1 - u) * ((1 - u) * (leaving - way)[leg] - u * (arriving - way)[leg])
    return np.asarray((1 - u) * track.places_m[leg] + u * track.places_m[leg + 1] + bend)


def to_hull_centre(antenna_m: Array, headings_rad: Array, ahead_m: float, to_port_m: float) -> Array:
    """Places of a hull's centre from those of its antenna, shape (m, 2), at headings counter-clockwise from w1, (m,).
    The centre lies `ahead_m` ahead of the antenna and `to_port_m` to port of it."""
    cosine, sine = np.cos(headings_rad), np.sin(headings_rad)
    offset = np.stack([ahead_m * cosine - to_port_m * sine, ahead_m * sine + to_port_m * cosine], axis=-1)
    return antenna_m + offset


# ---- Fills in the headings that reports leave open ----

MOVING_KN, MOVING_M = 0.5, 10.0  # a receiver's course at lower speeds, and the bearing over less, are mostly noise


class HeadingSource(IntEnum):
    """Origin of a heading."""

    REPORT = 0
    COURSE = 1
    BEARING = 2
    HELD = 3
    NOTHING = 4


def fill_headings(
    times_s: Array, places_m: Array, speed_kn: Array, course_deg: Array, heading_deg: Array, max_gap_s: float
) -> tuple[Array, Indices]:
    """Compass headings of one vessel at each of its reports, in degrees clockwise from north, and where each comes
    from, of `HeadingSource`, shape (n,) each. A missing heading is replaced by the course over ground while the vessel
    moves, or without a course by the bearing from the position before to the one after, unless these are more than
    `max_gap_s` apart. A vessel that does not move keeps its last heading, or takes its next. If it has no heading at
    any time, the mean of its courses is used, and without courses north. Times are ascending, shape (n,); places are
    metres east and north, shape (n, 2); speeds, courses and headings are NaN where unknown, shape (n,)."""
    bearing, way_m, span_s = _bearings(times_s, places_m, max_gap_s)
    implied_kn = way_m / np.where(span_s > 0, span_s, np.inf) / KNOT_M_S
    moving = np.where(np.isnan(speed_kn), (implied_kn >= MOVING_KN) & (way_m >= MOVING_M), speed_kn >= MOVING_KN)
    filled = heading_deg.copy()
    source = np.where(np.isnan(heading_deg), HeadingSource.NOTHING, HeadingSource.REPORT).astype(np.int64)

    def fill(where: Mask, values: Array, kind: HeadingSource) -> None:
        filled[where], source[where] = values[where], kind

    fill(np.isnan(filled) & moving & ~np.isnan(course_deg), course_deg, HeadingSource.COURSE)
    fill(np.isnan(filled) & moving & (way_m >= MOVING_M), bearing, HeadingSource.BEARING)
    still = np.isnan(filled)
    rows = np.flatnonzero(~still)
    if len(rows):
        earlier = np.searchsorted(rows, np.arange(len(filled)), side="right") - 1
        fill(still, filled[rows[np.maximum(earlier, 0)]], HeadingSource.HELD)
    elif np.isfinite(course_deg).any():
        angles = np.deg2rad(course_deg[np.isfinite(course_deg)])
        mean = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())) % 360
        fill(still, np.full(len(filled), mean), HeadingSource.COURSE)
    else:
        fill(still, np.zeros(len(filled)), HeadingSource.NOTHING)
    return filled, source


def _bearings(times_s: Array, places_m: Array, max_gap_s: float) -> tuple[Array, Array, Array]:
    """Bearing, distance and time from the position before each report to the one after, shape (n,) each. Where the gap
    before or after is too long, the report's own position is used in place of that neighbour."""
    number = len(times_s)
    linked = np.diff(times_s) <= max_gap_s
    before = np.arange(number) - np.r_[False, linked].astype(np.int64)
    after = np.arange(number) + np.r_[linked, False].astype(np.int64)
    way = places_m[after] - places_m[before]
    bearing = np.rad2deg(np.arctan2(way[:, 0], way[:, 1])) % 360
    return bearing, np.hypot(way[:, 0], way[:, 1]), times_s[after] - times_s[before]


def heading_rad(compass_deg: Array) -> Array:
    """Headings counter-clockwise from w1 (east), from compass headings clockwise from north, shape (n,)."""
    return np.pi / 2 - np.deg2rad(compass_deg)


MAX_STEPS = 1_000_000


@dataclass(frozen=True, eq=False)
class TimeGrid:
    """Times of a scene's steps."""

    start_s: float  # Unix time of the first step
    times_s: Array  # of each step since the first, (S,); `timestamps` has them as text
    timestamps: tuple[str, ...]

    @property
    def end_s(self) -> float:
        """Unix time of the last step."""
        return self.start_s + float(self.times_s[-1])

    def within(self, unix_s: Array, margin_s: float) -> Mask:
        """Mask of the times within the scene's, widened by a margin at both ends, shape (n,)."""
        return np.asarray((unix_s >= self.start_s - margin_s) & (unix_s <= self.end_s + margin_s))


def time_grid(positions: Positions, options: Options) -> TimeGrid:
    """The steps that the user asked for; by default they reach from the first report to the last. Raises ModsimError if
    there would be too many steps."""
    start = float(positions.time_s.min()) if options.start_s is None else options.start_s
    end = float(positions.time_s.max()) if options.end_s is None else options.end_s
    span = end - start if options.duration_s is None else options.duration_s
    steps = int(np.floor(span / options.time_step_s + ROUNDING_S)) + 1 if span >= 0 else 1
    if steps > MAX_STEPS:
        raise ModsimError(
            f"from {time_text(start)} to {time_text(start + span)} in steps of {options.time_step_s:g} s would be "
            f"{steps:,} steps, more than {MAX_STEPS:,}: choose --start and --end, or a larger --time-step"
        )
    timestamps = generated_timestamps(steps, options.time_step_s)
    return TimeGrid(start, np.array([float(text) for text in timestamps]), timestamps)


HEADING_NAMES = {
    HeadingSource.COURSE: "heading_from_course",
    HeadingSource.BEARING: "heading_from_bearing",
    HeadingSource.HELD: "heading_held",
    HeadingSource.NOTHING: "heading_unknown",
}


@dataclass(frozen=True, eq=False)
class VesselTrack:
    """One vessel of the traffic."""

    mmsi: int
    hull: AisHull
    reported_s: Array  # of the positions that were used, since the first step, ascending, (m,)
    reported_m: Array  # w1 and w2 of the antenna at these, (m, 2)
    jumps_s: Array  # of the positions that the vessel cannot have reached, and that were dropped, (k,)
    jumps_m: Array  # w1 and w2 of these, (k, 2)
    replaced: Counter[str]  # what was missing → in how many of the used positions it was replaced
    steps: Indices  # at which it is there, ascending, (n,)
    places_m: Array  # w1 and w2 of the hull's centre at these, (n, 2)
    headings_rad: Array  # counter-clockwise from w1 at these, (n,)

    @property
    def messages(self) -> int:
        """Number of positions that were used."""
        return len(self.reported_s)

    @property
    def jumps(self) -> int:
        """Number of positions that were dropped because the vessel cannot have reached them."""
        return len(self.jumps_s)


def vessel_track(positions: Positions, places_m: Array, hull: AisHull, grid: TimeGrid, options: Options) -> VesselTrack:
    """The track of one vessel from its reports by time, with their metres east and north of the origin, shape (n, 2).
    Jumps are dropped, and missing headings and courses filled in."""
    every_s = positions.time_s - grid.start_s
    kept = reachable(every_s, places_m, options.max_speed_kn * KNOT_M_S)
    used, places, since_s = positions.take(kept), places_m[kept], every_s[kept]
    speed, course, heading = used.speed_kn, used.course_deg, used.heading_deg
    compass, source = fill_headings(since_s, places, speed, course, heading, options.max_gap_s)
    course_taken = np.isnan(course) & ~np.isnan(heading) & (speed >= MOVING_KN)
    course = np.where(course_taken, heading, course)
    track = ReportedTrack(since_s, places, _velocities(speed, course), heading_rad(compass))
    steps = steps_near(since_s, grid.times_s, options.max_gap_s)
    present, antenna, headings = resample(track, grid.times_s[steps], options.max_gap_s)
    steps, antenna, headings = steps[present], antenna[present], headings[present]
    replaced = Counter({name: int((source == kind).sum()) for kind, name in HEADING_NAMES.items()})
    replaced["course_from_heading"] = int(course_taken.sum())
    replaced["course_unknown"] = int((np.isnan(course) & ~(speed < MOVING_KN)).sum())
    replaced["speed_unknown"] = int(np.isnan(speed).sum())
    return VesselTrack(
        mmsi=int(used.mmsi[0]),
        hull=hull,
        reported_s=since_s,
        reported_m=places,
        jumps_s=every_s[~kept],
        jumps_m=places_m[~kept],
        replaced=+replaced,
        steps=steps,
        places_m=to_hull_centre(antenna, headings, hull.ahead_m, hull.to_port_m),
        headings_rad=headings,
    )


def _velocities(speed_kn: Array, course_deg: Array) -> Array:
    """East and north in m/s, shape (n, 2), NaN where unknown; a vessel that lies still needs no course."""
    direction = np.deg2rad(np.where(np.isnan(course_deg) & (speed_kn == 0), 0.0, course_deg))
    speed_m_s = speed_kn * KNOT_M_S
    return np.stack([speed_m_s * np.sin(direction), speed_m_s * np.cos(direction)], axis=-1)
