"""The track of one vessel at the steps of a scene, from its reports."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from modsim3d.ais.cleaning import reachable
from modsim3d.ais.headings import KNOT_M_S, MOVING_KN, HeadingSource, fill_headings, heading_rad
from modsim3d.ais.hulls import Hull
from modsim3d.ais.messages import Positions
from modsim3d.ais.options import Options
from modsim3d.ais.resampling import ReportedTrack, resample, steps_near, to_hull_centre
from modsim3d.ais.time_grid import TimeGrid
from modsim3d.arrays import Array, Indices

HEADING_NAMES = {
    HeadingSource.COURSE: "heading_from_course",
    HeadingSource.BEARING: "heading_from_bearing",
    HeadingSource.HELD: "heading_held",
    HeadingSource.NOTHING: "heading_unknown",
}


@dataclass(frozen=True, eq=False)
class VesselTrack:
    """One vessel of the traffic.

    Attributes:
        reported_s: Times of the positions that were used, since the first step, ascending, shape (m,).
        reported_m: w1 and w2 of the antenna at these, shape (m, 2).
        jumps_s: Times of the positions that the vessel cannot have reached, and that were dropped, shape (k,).
        jumps_m: w1 and w2 of these, shape (k, 2).
        replaced: What was missing → in how many of the used positions it was replaced.
        steps: The steps at which it is there, ascending, shape (n,).
        places_m: w1 and w2 of the hull's centre at these, shape (n, 2).
        headings_rad: Counter-clockwise from w1 at these, shape (n,).
    """

    mmsi: int
    hull: Hull
    reported_s: Array
    reported_m: Array
    jumps_s: Array
    jumps_m: Array
    replaced: Counter[str]
    steps: Indices
    places_m: Array
    headings_rad: Array

    @property
    def messages(self) -> int:
        """Number of positions that were used."""
        return len(self.reported_s)

    @property
    def jumps(self) -> int:
        """Number of positions that were dropped because the vessel cannot have reached them."""
        return len(self.jumps_s)


def vessel_track(positions: Positions, places_m: Array, hull: Hull, grid: TimeGrid, options: Options) -> VesselTrack:
    """The track of one vessel from its reports by time, with their metres east and north of the origin, shape (n, 2).

    Jumps are dropped, and missing headings and courses filled in.
    """
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
