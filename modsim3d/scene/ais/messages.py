"""Results of the readers: reported positions and particulars of vessels, in columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Positions(Columns):
    """Reported positions, shape (n,) each, NaN where a report leaves a value open."""

    mmsi: Indices  # the vessel's identity
    time_s: Array  # Unix time
    latitude_deg: Array  # of the antenna
    longitude_deg: Array
    speed_kn: Array  # over ground
    course_deg: Array  # over ground, clockwise from north
    heading_deg: Array  # true heading of the bow, clockwise from north
    ship: Mask  # the sender is of a kind that sits on ships (class A or B)
    row: Indices  # its row or line in the file, the first being 1


@dataclass(frozen=True, eq=False)
class Particulars(Columns):
    """Names, types and dimensions that vessels report, shape (n,) each, NaN or empty where they report none."""

    mmsi: Indices  # the vessel's identity
    time_s: Array  # Unix time at which this was last reported
    name: NDArray[np.object_]
    ship_type: NDArray[np.object_]  # code or words of the source
    to_bow_m: Array  # from the antenna, A in the standard; the distances to the other sides are B, C and D
    to_stern_m: Array
    to_port_m: Array
    to_starboard_m: Array
    length_m: Array  # where the source gives it itself, beside these distances or in their place
    beam_m: Array


@dataclass(frozen=True, eq=False)
class Chunk:
    """Result of a reader for a part of a file."""

    positions: Positions
    particulars: Particulars
    messages: int  # read, with those dropped
    dropped: Mapping[str, int]  # reason → number of messages that are in neither table
    problems: tuple[str, ...] = ()  # one line on each of the first dropped messages
    odd: str = ""  # what cannot be right in all messages so far; empty if nothing is


# ---- Places on the Earth ----

SEA_LEVEL_STEPS = 4  # each step takes the height above the ellipsoid off the height above the tangent plane


def wrapped_deg(angle_deg: ArrayLike) -> Array:
    """Angles of any shape, brought into [−180, 180)."""
    return np.mod(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0


@dataclass(frozen=True)
class SeaRegion:
    """All places between two corners, the short way round the Earth: `width_deg` eastward from `west_deg`."""

    south_deg: float
    north_deg: float
    west_deg: float
    width_deg: float

    @classmethod
    def between(cls, latitude1: float, longitude1: float, latitude2: float, longitude2: float) -> SeaRegion:
        """From two opposite corners, in any order."""
        width = float(wrapped_deg(longitude2 - longitude1))
        west = longitude1 if width >= 0 else longitude2
        return cls(min(latitude1, latitude2), max(latitude1, latitude2), west, abs(width))

    def holds(self, latitude_deg: Array, longitude_deg: Array) -> Mask:
        """Mask of the places inside, shape (n,)."""
        between = (latitude_deg >= self.south_deg) & (latitude_deg <= self.north_deg)
        return between & (np.mod(longitude_deg - self.west_deg, 360.0) <= self.width_deg)

    def __str__(self) -> str:
        """Its two corners as they are given on the command line."""
        east = float(wrapped_deg(self.west_deg + self.width_deg))
        return f"{self.south_deg:g},{self.west_deg:g},{self.north_deg:g},{east:g}"


def local_metres(latitude_deg: Array, longitude_deg: Array, origin: tuple[float, float]) -> Array:
    """Metres east and north of an origin (latitude, longitude), shape (n, 2), of places, shape (n,) each."""
    import pymap3d

    east, north, _ = pymap3d.geodetic2enu(latitude_deg, longitude_deg, 0.0, *origin, 0.0)
    return np.stack([np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)], axis=-1)


def places(metres: Array, origin: tuple[float, float]) -> tuple[Array, Array]:
    """Latitude and longitude of places at sea level, shape (n,) each, from metres east and north of an origin, (n, 2).
    The other way round than `local_metres`, to a millimetre within 200 km."""
    import pymap3d

    east, north = metres[:, 0], metres[:, 1]
    up = np.zeros(len(metres))
    for _ in range(SEA_LEVEL_STEPS):
        latitude, longitude, height = pymap3d.enu2geodetic(east, north, up, *origin, 0.0)
        up = up - np.asarray(height, dtype=np.float64)
    return np.asarray(latitude, dtype=np.float64), wrapped_deg(longitude)


def median_place(latitude_deg: Array, longitude_deg: Array) -> tuple[float, float]:
    """Median latitude and longitude of places, shape (n,) each, also across the date line."""
    angles = np.deg2rad(longitude_deg)
    about = np.rad2deg(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    longitude = wrapped_deg(about + np.median(wrapped_deg(longitude_deg - about)))
    return float(np.median(latitude_deg)), float(longitude)


NO_LATITUDE, NO_LONGITUDE = 91.0, 181.0
LOOKED_BACK_PIECES = 1000  # for the piece before, so that the time grows with the number of pieces, not with its square
SLACK_S = 1.0  # most files round times to seconds, so two reports may be up to a second further apart than their times
LISTED_ROWS = 5


def exchanged(positions: Positions) -> Positions:
    """Positions with latitude and longitude exchanged."""
    return replace(positions, latitude_deg=positions.longitude_deg, longitude_deg=positions.latitude_deg)


def check_order(source: str, positions: Positions, exchange: bool) -> None:
    """Refuse positions of a table, after the exchange if the user asked for it, that are possible only with latitude
    and longitude exchanged, such as 110, 35. Whether latitude 12, longitude 56 is Denmark or the Arabian Sea only the
    courses tell, see `warning`. Raises InputError, which names the rows and the file `source`."""
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
    """Mask of the reports without a position, shape (n,)."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    none = (latitude == NO_LATITUDE) | (longitude == NO_LONGITUDE) | ((latitude == 0) & (longitude == 0))
    return np.asarray(none | np.isnan(latitude) | np.isnan(longitude))


def sift(
    positions: Positions, region: SeaRegion | None, first_s: float, last_s: float
) -> tuple[Positions, dict[str, Indices]]:
    """Keep positions of ships in a region (everywhere if None) and between two Unix times; and reason → the sender of
    each position dropped, shape (n,)."""
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
    """Sort by vessel and time and drop duplicates: one report of a vessel is kept for each time, chosen by values,
    known before unknown, so that the order of rows changes nothing. Also the number of duplicates, and how many of
    these say the same in all columns."""
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
    """The largest part of a track in which each position can be reached from the one before, as a mask, shape (n,). The
    track is cut wherever the speed between neighbours is too high. Of the chains of pieces in which each piece can be
    reached from the one before, which is one of the thousand pieces before it, the one with most positions is kept. So
    a single wrong position is dropped wherever it stands, also at the beginning, and of two vessels that share an
    identity the one with more reports is kept. Times are ascending, shape (n,); places are metres east and north, shape
    (n, 2)."""

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
