"""Fills in the headings that reports leave open."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

MOVING_KN, MOVING_M = 0.5, 10.0
"""At lower speeds the course of a receiver is mostly noise, and so is the bearing over shorter distances."""
KNOT_M_S = 1852 / 3600


class HeadingSource(IntEnum):
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

    A missing heading is replaced by the course over ground while the vessel moves, or without a course by the bearing
    from the position before to the one after. A vessel that does not move keeps its last heading, or takes its next. If
    it has no heading at any time, the mean of its courses is used, and without courses north.

    Args:
        times_s: Ascending, shape (n,).
        places_m: East and north, shape (n, 2).
        speed_kn: NaN where unknown, shape (n,); courses and headings likewise.
        max_gap_s: No bearing is taken between positions that are further apart in time.

    Returns:
        Degrees clockwise from north, shape (n,), and where each comes from, of `HeadingSource`, shape (n,).
    """
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
    known = np.flatnonzero(~still)
    if len(known):
        earlier = np.searchsorted(known, np.arange(len(filled)), side="right") - 1
        fill(still, filled[known[np.maximum(earlier, 0)]], HeadingSource.HELD)
    elif np.isfinite(course_deg).any():
        angles = np.deg2rad(course_deg[np.isfinite(course_deg)])
        mean = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())) % 360
        fill(still, np.full(len(filled), mean), HeadingSource.COURSE)
    else:
        fill(still, np.zeros(len(filled)), HeadingSource.NOTHING)
    return filled, source


def _bearings(times_s: Array, places_m: Array, max_gap_s: float) -> tuple[Array, Array, Array]:
    """Bearing, distance and time from the position before each report to the one after, shape (n,) each.

    Where the gap before or after is too long, the report's own position is used in place of that neighbour.
    """
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
