"""A heading for every report of a vessel, whether it gives one or not."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

MOVING_KN = 0.5
"""Slower than this, a receiver's course is mostly noise."""
MOVING_M = 10.0
"""And so is the direction from one position to another that is nearer than this."""
KNOT_M_S = 1852 / 3600


class From(IntEnum):
    """Where a heading comes from."""

    REPORT = 0
    COURSE = 1
    BEARING = 2
    HELD = 3
    NOTHING = 4


def fill_headings(
    times_s: Array, places_m: Array, speed_kn: Array, course_deg: Array, heading_deg: Array, max_gap_s: float
) -> tuple[Array, Indices]:
    """Compass headings of one vessel at each of its reports.

    In place of a missing heading stands the course over ground while the vessel moves; without a course, the bearing
    from the position before to the one after. A vessel that does not move keeps the heading it had, or has next. If
    there is none all along, the mean of what courses there are will do, then north.

    Args:
        times_s: Ascending, shape (n,).
        places_m: East and north, shape (n, 2).
        speed_kn: NaN where unknown, shape (n,).
        course_deg: NaN where unknown, shape (n,).
        heading_deg: NaN where unknown, shape (n,).
        max_gap_s: Positions further apart in time say nothing of a bearing.

    Returns:
        Degrees clockwise from north, shape (n,), and where each comes from, of `From`, shape (n,).
    """
    bearing, way_m, span_s = _bearings(times_s, places_m, max_gap_s)
    implied_kn = way_m / np.where(span_s > 0, span_s, np.inf) / KNOT_M_S
    moving = np.where(np.isnan(speed_kn), (implied_kn >= MOVING_KN) & (way_m >= MOVING_M), speed_kn >= MOVING_KN)
    filled = heading_deg.copy()
    source = np.where(np.isnan(heading_deg), From.NOTHING, From.REPORT).astype(np.int64)

    def fill(where: Mask, values: Array, kind: From) -> None:
        filled[where], source[where] = values[where], kind

    fill(np.isnan(filled) & moving & ~np.isnan(course_deg), course_deg, From.COURSE)
    fill(np.isnan(filled) & moving & (way_m >= MOVING_M), bearing, From.BEARING)
    known = np.flatnonzero(~np.isnan(filled))
    still = np.isnan(filled)
    if len(known):
        earlier = np.searchsorted(known, np.arange(len(filled)), side="right") - 1
        fill(still, filled[known[np.maximum(earlier, 0)]], From.HELD)
    elif np.isfinite(course_deg).any():
        angles = np.deg2rad(course_deg[np.isfinite(course_deg)])
        mean = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())) % 360
        fill(still, np.full(len(filled), mean), From.COURSE)
    else:
        fill(still, np.zeros(len(filled)), From.NOTHING)
    return filled, source


def _bearings(times_s: Array, places_m: Array, max_gap_s: float) -> tuple[Array, Array, Array]:
    """From the position before each to the one after, as far as they are near in time: bearing, way, time."""
    number = len(times_s)
    linked = np.diff(times_s) <= max_gap_s
    before = np.arange(number) - np.r_[False, linked].astype(np.int64)
    after = np.arange(number) + np.r_[linked, False].astype(np.int64)
    way = places_m[after] - places_m[before]
    bearing = np.rad2deg(np.arctan2(way[:, 0], way[:, 1])) % 360
    return bearing, np.hypot(way[:, 0], way[:, 1]), times_s[after] - times_s[before]


def fill_courses(course_deg: Array, heading_deg: Array, speed_kn: Array) -> tuple[Array, Mask]:
    """Courses with the reported heading where a moving vessel gives none, and where that was done."""
    taken = np.isnan(course_deg) & ~np.isnan(heading_deg) & (speed_kn >= MOVING_KN)
    return np.where(taken, heading_deg, course_deg), taken
