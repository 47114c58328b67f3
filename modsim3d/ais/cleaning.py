"""Keeps what can be used of reported positions and counts the rest by reason; the order of rows does not matter.

What is not there: latitude 91, longitude 181, speed 102.3 kn, course 360°, heading 511° (ITU-R M.1371-5, annex 8,
table 48), or an empty cell. An identity (MMSI) of a ship begins with 2 to 7 (ITU-R M.585: the country), that of a craft
that belongs to a ship with 98; others are stations ashore, aids to navigation, aircraft and rescue beacons.
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
"""Most files give times in whole seconds, so that two reports may be a second further apart than they say."""


def ship_identity(positions: Positions) -> Mask:
    """Which reports come from ships, by kind of sender and by identity."""
    leading = positions.mmsi // 100_000_000
    return np.asarray(positions.ship & (((leading >= 2) & (leading <= 7)) | (positions.mmsi // 10_000_000 == 98)))


def without_position(positions: Positions) -> Mask:
    """Which reports say that they know no position."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    none = (latitude == NO_LATITUDE) | (longitude == NO_LONGITUDE)
    return np.asarray(none | np.isnan(latitude) | np.isnan(longitude))


def impossible(positions: Positions) -> Mask:
    """Which positions are nowhere on Earth."""
    return ~((np.abs(positions.latitude_deg) <= 90) & (np.abs(positions.longitude_deg) <= 180))


def sift(
    positions: Positions, region: Region | None, first_s: float, last_s: float
) -> tuple[Positions, dict[str, int]]:
    """Positions of ships in a region and a span of time, and how many others there were by reason."""
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
    """By vessel and time, one of each time, and how many were dropped for that.

    Of several reports of a vessel at one time the order of their values decides, known ones before unknown, so that
    the order of rows does not.
    """
    columns = (positions.heading_deg, positions.course_deg, positions.speed_kn)
    places = (positions.longitude_deg, positions.latitude_deg)
    ordered = positions.take(np.lexsort((*columns, *places, positions.time_s, positions.mmsi)))
    again = np.zeros(len(ordered), dtype=bool)
    again[1:] = (np.diff(ordered.mmsi) == 0) & (np.diff(ordered.time_s) == 0)
    return ordered.take(~again), int(again.sum())


def blank_unknown(positions: Positions) -> Positions:
    """The same with NaN wherever speed, course or heading is a value that means unknown, or is none at all."""
    speed, course, heading = positions.speed_kn, positions.course_deg, positions.heading_deg
    return replace(
        positions,
        longitude_deg=wrapped_deg(positions.longitude_deg),
        speed_kn=np.where((speed >= 0) & (speed < 102.25), speed, np.nan),
        course_deg=np.where((course >= 0) & (course < 360), course, np.nan),
        heading_deg=np.where((heading >= 0) & (heading < 360), heading, np.nan),
    )
