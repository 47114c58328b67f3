"""Drops reported positions that are of no use, and refuses tables with latitude and longitude exchanged.

The result does not depend on the order of rows. Values that mean unknown are latitude 91, longitude 181, speed 102.3
kn, course 360°, heading 511° (ITU-R M.1371-5, annex 8, table 48) and an empty cell; latitude and longitude of
exactly 0 are what receivers without a fix send. The identity (MMSI) of a ship begins with 2 to 7 (ITU-R M.585: the
country), that of a craft that belongs to a ship with 98. All others are stations
ashore, aids to navigation, aircraft and rescue beacons.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.ais.geography import Region, wrapped_deg
from modsim3d.ais.messages import Positions
from modsim3d.arrays import Array, Indices, Mask
from modsim3d.errors import InputError

NO_LATITUDE, NO_LONGITUDE = 91.0, 181.0
LOOKED_BACK_PIECES = 1000
"""For the piece before, so that the time grows with the number of pieces, not with its square."""
SLACK_S = 1.0
"""Most files round times to seconds, so two reports may be up to a second further apart than their times."""
LISTED_ROWS = 5


def exchanged(positions: Positions) -> Positions:
    """The same positions with latitude and longitude exchanged."""
    return replace(positions, latitude_deg=positions.longitude_deg, longitude_deg=positions.latitude_deg)


def check_order(source: str, positions: Positions, exchange: bool) -> None:
    """Refuse positions of a table that are possible only with latitude and longitude exchanged, such as 110, 35.

    Whether latitude 12, longitude 56 is Denmark or the Arabian Sea cannot be known from the file.

    Args:
        source: Name of the file in the message.
        positions: The table's positions, after the exchange if the user asked for it.
        exchange: Whether the user did.

    Raises:
        InputError: There are such positions; their rows are named.
    """
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    wrong = np.flatnonzero(~_in_range(latitude, longitude) & _in_range(longitude, latitude))
    if not len(wrong):
        return
    rows = ", ".join(str(row) for row in positions.row[wrong[:LISTED_ROWS]])
    more = " and more" if len(wrong) > LISTED_ROWS else ""
    place = f"latitude {latitude[wrong[0]]:g}, longitude {longitude[wrong[0]]:g}"
    if exchange:
        problem = f"--swap-coordinates makes these positions impossible ({place}); leave the option out"
    else:
        problem = (
            f"latitude and longitude look swapped: {place} is possible only the other way round; "
            "use --swap-coordinates to exchange them in all tables, or --region to leave such rows out"
        )
    raise InputError(source, [f"row {rows}{more}: {problem}"])


def _in_range(latitude_deg: Array, longitude_deg: Array) -> Mask:
    """Whether both values are within their range or say that they are not known, shape (n,)."""
    latitude = (np.abs(latitude_deg) <= 90) | (latitude_deg == NO_LATITUDE)
    longitude = (np.abs(longitude_deg) <= 180) | (longitude_deg == NO_LONGITUDE)
    return np.asarray(latitude & longitude)


def without_position(positions: Positions) -> Mask:
    """Which reports give no position, shape (n,)."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    none = (latitude == NO_LATITUDE) | (longitude == NO_LONGITUDE) | ((latitude == 0) & (longitude == 0))
    return np.asarray(none | np.isnan(latitude) | np.isnan(longitude))


def sift(
    positions: Positions, region: Region | None, first_s: float, last_s: float
) -> tuple[Positions, dict[str, Indices]]:
    """Keep positions of ships in a region (everywhere if None) and between two Unix times.

    Returns:
        What was kept, and reason → the sender of each position dropped, shape (n,).
    """
    dropped: dict[str, Indices] = {}

    def drop(reason: str, wrong: Mask) -> None:
        nonlocal positions
        dropped[reason] = positions.mmsi[wrong]
        positions = positions.take(~wrong)

    leading = positions.mmsi // 100_000_000
    ship = ((leading >= 2) & (leading <= 7)) | (positions.mmsi // 10_000_000 == 98)
    drop("not_a_ship", ~(positions.ship & ship))
    drop("no_position", without_position(positions))
    on_earth = (np.abs(positions.latitude_deg) <= 90) & (np.abs(positions.longitude_deg) <= 180)
    drop("impossible_position", ~on_earth)
    if region is not None:
        drop("outside_region", ~region.holds(positions.latitude_deg, positions.longitude_deg))
    drop("outside_window", (positions.time_s < first_s) | (positions.time_s > last_s))
    return positions, dropped


def in_order(positions: Positions) -> tuple[Positions, int, int]:
    """Sort by vessel and time and drop duplicates: one report of a vessel is kept for each time.

    Which of them is decided by their values, known before unknown, so that the order of rows changes nothing.

    Returns:
        What was kept, the number of duplicates, and how many of these say the same in all columns.
    """
    columns = (positions.heading_deg, positions.course_deg, positions.speed_kn)
    places = (positions.longitude_deg, positions.latitude_deg)
    order = np.lexsort((*columns, *places, positions.time_s, positions.mmsi))
    ordered, values = positions.take(order), np.column_stack((*columns, *places))[order]
    again = np.zeros(len(ordered), dtype=bool)
    again[1:] = (np.diff(ordered.mmsi) == 0) & (np.diff(ordered.time_s) == 0)
    same = again[1:] & np.all((values[1:] == values[:-1]) | np.isnan(values[1:] + values[:-1]), axis=1)
    return ordered.take(~again), int(again.sum()), int(same.sum())


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


def reachable(times_s: Array, places_m: Array, max_speed_m_s: float) -> Mask:
    """The largest part of a track in which each position can be reached from the one before, as a mask, shape (n,).

    The track is cut wherever the speed between neighbours is too high. Of the chains of pieces in which each piece can
    be reached from the one before, which is one of the thousand pieces before it, the one with most positions is kept.
    So a single wrong position is dropped wherever it stands, also at the beginning, and of two vessels that share an
    identity the one with more reports is kept.

    Args:
        times_s: Ascending, shape (n,).
        places_m: East and north, shape (n, 2).
        max_speed_m_s: A position that asks for more speed cannot be reached.
    """

    def possible(start: Indices, end: Indices) -> Mask:
        way = np.linalg.norm(places_m[end] - places_m[start], axis=-1)
        return np.asarray(way <= max_speed_m_s * (times_s[end] - times_s[start] + SLACK_S))

    number = len(times_s)
    rows = np.arange(number)
    cuts = np.flatnonzero(~possible(rows[:-1], rows[1:])) + 1
    firsts, stops = np.r_[0, cuts], np.r_[cuts, number]
    best = stops - firsts  # positions in the longest chain that ends with a piece
    before = np.full(len(firsts), -1)
    for piece in range(1, len(firsts)):
        begin = max(0, piece - LOOKED_BACK_PIECES)
        reached = begin + np.flatnonzero(possible(stops[begin:piece] - 1, firsts[piece]))
        if len(reached):
            before[piece] = reached[np.argmax(best[reached])]
            best[piece] += best[before[piece]]
    kept = np.zeros(number, dtype=bool)
    piece = int(np.argmax(best))
    while piece >= 0:
        kept[firsts[piece] : stops[piece]] = True
        piece = int(before[piece])
    return kept
