"""Drops reported positions that are of no use and counts them by reason.

The result does not depend on the order of rows. Values that mean unknown are latitude 91, longitude 181, speed 102.3
kn, course 360°, heading 511° (ITU-R M.1371-5, annex 8, table 48) and an empty cell. The identity (MMSI) of a ship
begins with 2 to 7 (ITU-R M.585: the country), that of a craft that belongs to a ship with 98. All others are stations
ashore, aids to navigation, aircraft and rescue beacons.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.ais.region import Region, wrapped_deg
from modsim3d.ais.reports import Positions
from modsim3d.arrays import Mask

NOT_A_SHIP, NO_POSITION, IMPOSSIBLE, OUTSIDE_REGION, OUTSIDE_WINDOW, DUPLICATE, JUMP = (
    "not_a_ship",
    "no_position",
    "impossible_position",
    "outside_region",
    "outside_window",
    "duplicate",
    "jump",
)
NO_LATITUDE, NO_LONGITUDE = 91.0, 181.0
SLACK_S = 1.0
"""Most files round times to seconds, so two reports may be up to a second further apart than their times."""


def ship_identity(positions: Positions) -> Mask:
    """Which reports come from ships, by kind of sender and by identity, shape (n,)."""
    leading = positions.mmsi // 100_000_000
    return np.asarray(positions.ship & (((leading >= 2) & (leading <= 7)) | (positions.mmsi // 10_000_000 == 98)))


def without_position(positions: Positions) -> Mask:
    """Which reports give no position, shape (n,)."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    none = (latitude == NO_LATITUDE) | (longitude == NO_LONGITUDE)
    return np.asarray(none | np.isnan(latitude) | np.isnan(longitude))


def impossible(positions: Positions) -> Mask:
    """Which positions are nowhere on Earth, shape (n,)."""
    return ~((np.abs(positions.latitude_deg) <= 90) & (np.abs(positions.longitude_deg) <= 180))


def sift(
    positions: Positions, region: Region | None, first_s: float, last_s: float
) -> tuple[Positions, dict[str, int]]:
    """Keep positions of ships in a region and a span of time.

    Args:
        positions: Reported positions in any order.
        region: Everywhere if None.
        first_s: Unix time at which the span begins.
        last_s: Unix time at which the span ends.

    Returns:
        What was kept, and reason → number of positions dropped.
    """
    dropped: dict[str, int] = {}

    def drop(reason: str, wrong: Mask) -> None:
        nonlocal positions
        dropped[reason] = int(wrong.sum())
        positions = positions.take(~wrong)

    drop(NOT_A_SHIP, ~ship_identity(positions))
    drop(NO_POSITION, without_position(positions))
    drop(IMPOSSIBLE, impossible(positions))
    if region is not None:
        drop(OUTSIDE_REGION, ~region.holds(positions.latitude_deg, positions.longitude_deg))
    drop(OUTSIDE_WINDOW, (positions.time_s < first_s) | (positions.time_s > last_s))
    return positions, dropped


def in_order(positions: Positions) -> tuple[Positions, int]:
    """Sort by vessel and time and drop duplicates: one report of a vessel is kept for each time.

    Which of them is decided by their values, known before unknown, so that the order of rows changes nothing.

    Returns:
        What was kept, and the number of duplicates.
    """
    columns = (positions.heading_deg, positions.course_deg, positions.speed_kn)
    places = (positions.longitude_deg, positions.latitude_deg)
    ordered = positions.take(np.lexsort((*columns, *places, positions.time_s, positions.mmsi)))
    again = np.zeros(len(ordered), dtype=bool)
    again[1:] = (np.diff(ordered.mmsi) == 0) & (np.diff(ordered.time_s) == 0)
    return ordered.take(~again), int(again.sum())


def blank_unknown(positions: Positions) -> Positions:
    """Put NaN in place of every speed, course and heading that means unknown or is out of range."""
    speed, course, heading = positions.speed_kn, positions.course_deg, positions.heading_deg
    return replace(
        positions,
        longitude_deg=wrapped_deg(positions.longitude_deg),
        speed_kn=np.where((speed >= 0) & (speed < 102.25), speed, np.nan),
        course_deg=np.where((course >= 0) & (course < 360), course, np.nan),
        heading_deg=np.where((heading >= 0) & (heading < 360), heading, np.nan),
    )
