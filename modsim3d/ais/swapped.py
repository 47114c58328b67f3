"""Finds latitude and longitude in each other's place.

One sign is enough: a latitude beyond the poles; a place far from the waters that the publishers cover, but in them if
exchanged; one far from the vessel's others, or from those of the other files, but among them if exchanged; ships that
move another way than their courses say, but that way if exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.ais.cleaning import NO_LATITUDE
from modsim3d.ais.region import Region, wrapped_deg
from modsim3d.ais.reports import Positions
from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError

NEAR_DEG, FAR_DEG = 1.0, 5.0
"""What turns up within the one when turned round, and beyond the other as it stands, was swapped."""
PUBLISHED_WATERS = tuple(
    Region.between(*corners)
    for corners in (
        (53, 2, 60, 20),  # Denmark
        (23, -130, 50, -60),  # the United States: Pacific, Gulf, Atlantic, Great Lakes
        (48, 170, 75, -129),  # Alaska
        (15, -179, 31, -150),  # Hawaii
        (15, -70, 20, -62),  # Puerto Rico, Virgin Islands
        (11, 140, 22, 148),  # Guam, Northern Marianas
        (-17, -174, -9, -166),  # American Samoa
    )
)
"""Where the traffic in files of the Danish Maritime Authority and of MarineCadastre is, with room around it."""
FEW_SHARE = 0.1
"""Of what is in a region, so much again may be elsewhere and in it if exchanged: single wrong rows are left out."""
MIN_SPEED_KN, MAX_SPEED_KN, MIN_WAY_DEG, MAX_INTERVAL_S = 2.0, 102.0, 5e-4, 300.0
"""Between which reports a course says where the vessel went."""
STEADY_DEG, FITS_DEG, TELLING_DEG = 15.0, 20.0, 60.0
"""Courses at both ends that agree; a way that fits its course; one that does not if it is turned round."""
MIN_WAYS, MIN_SHARE = 5, 0.9
"""How many telling ways of a file there must be, and how many of them must fit if turned round."""


def _swapped_error(source: str, positions: Positions, row: int, why: str) -> InputError:
    """The error that names a row."""
    latitude, longitude = positions.latitude_deg[row], positions.longitude_deg[row]
    place = f"latitude {latitude:g}, longitude {longitude:g}"
    return InputError(
        source,
        [f"latitude and longitude look swapped (row {positions.row[row]}: {place}): {why}"],
    )


def check_range(source: str, positions: Positions) -> None:
    """Refuse latitudes beyond the poles that would do as longitudes.

    Raises:
        InputError: With the first such row.
    """
    latitude, longitude = np.abs(positions.latitude_deg), np.abs(positions.longitude_deg)
    wrong = (latitude > 90) & (latitude <= 180) & (longitude <= 90) & (positions.latitude_deg != NO_LATITUDE)
    if wrong.any():
        raise _swapped_error(source, positions, int(np.argmax(wrong)), "a latitude lies between −90 and 90")


def check_waters(source: str, positions: Positions) -> None:
    """Refuse positions in nobody's waters that would be in those of a publisher if they were swapped.

    Raises:
        InputError: With the first such row.
    """
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    wrong = ~_in_waters(latitude, longitude) & _in_waters(longitude, latitude)
    if wrong.any():
        why = "swapped, it would be in the waters that such files cover; if it is right, say so with --region"
        raise _swapped_error(source, positions, int(np.argmax(wrong)), why)


def _in_waters(latitude_deg: Array, longitude_deg: Array) -> Mask:
    found: Mask = np.any([waters.holds(latitude_deg, longitude_deg) for waters in PUBLISHED_WATERS], axis=0)
    return found


def check_origin(source: str, positions: Positions, origin: tuple[float, float]) -> None:
    """Refuse an origin that is far from the traffic, but in it if swapped.

    Raises:
        InputError: With the origin.
    """
    traffic = _middle(positions.latitude_deg, positions.longitude_deg)
    if _turned_round(np.array(origin[:1]), np.array(origin[1:]), traffic)[0]:
        latitude, longitude = origin
        raise InputError(
            source,
            [
                f"--origin: latitude comes first (got {latitude:g},{longitude:g}, but the middle of the traffic is "
                f"{traffic[0]:.4f},{traffic[1]:.4f})"
            ],
        )


@dataclass
class AroundRegion:
    """What of a file is in the region asked for, and what would be if latitude and longitude were exchanged."""

    region: Region | None
    inside: int = 0
    swapped: int = 0
    first: Positions | None = None

    def add(self, positions: Positions) -> None:
        """Count some positions."""
        if self.region is None:
            return
        self.inside += int(self.region.holds(positions.latitude_deg, positions.longitude_deg).sum())
        swapped = np.flatnonzero(_inside_if_swapped(positions, self.region))
        self.swapped += len(swapped)
        if self.first is None and len(swapped):
            self.first = positions.take(swapped[:1])

    def check(self, source: str, table: bool) -> None:
        """Refuse a file of which nothing is inside as it stands, or a table of which a good part is not.

        Sentences say themselves which number is which; what is elsewhere in them is other traffic.

        Raises:
            InputError: With the first such row.
        """
        if self.first is None or self.region is None:
            return
        part = table and not self.region.meets_its_mirror and self.swapped > FEW_SHARE * self.inside
        if self.inside and not part:
            return
        why = f"swapped, it would be in the region {self.region} (or are the region's corners swapped?)"
        raise _swapped_error(source, self.first, 0, why)


def _inside_if_swapped(positions: Positions, region: Region) -> Mask:
    """Which positions are outside a region, but inside it with latitude and longitude exchanged."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    return ~region.holds(latitude, longitude) & region.holds(longitude, latitude)


def check_together(sources: list[str], positions: Positions) -> None:
    """Refuse positions that fit the vessel's others, the other files, or their courses only if they are swapped.

    Args:
        sources: What to call each file.
        positions: In any order.

    Raises:
        InputError: With the first such row.
    """
    for wrong, why in (
        (_vessels_astray(positions), "swapped, it would be where this vessel is at other times"),
        (_files_astray(positions), "swapped, this file's traffic would be where that of the other files is"),
        (_courses_astray(positions), "swapped, this file's vessels would move the way their courses say"),
    ):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[np.lexsort((positions.row[wrong], positions.file[wrong]))[0]])
            raise _swapped_error(sources[positions.file[row]], positions, row, why)


def _vessels_astray(positions: Positions) -> Mask:
    """Which positions are far from the middle of their vessel's, but near it if swapped."""
    wrong = np.zeros(len(positions), dtype=bool)
    order = np.argsort(positions.mmsi, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(positions.mmsi[order])) + 1):
        if len(rows):
            latitude, longitude = positions.latitude_deg[rows], positions.longitude_deg[rows]
            wrong[rows] = _turned_round(latitude, longitude, _middle(latitude, longitude))
    return wrong


def _files_astray(positions: Positions) -> Mask:
    """Which positions are in files whose middle is far from that of the rest, but near it if swapped.

    Of two such parts the smaller is taken for wrong, of two as large the later.
    """
    wrong = np.zeros(len(positions), dtype=bool)
    files = np.unique(positions.file)
    for file in files if len(files) > 1 else []:
        own = positions.file == file
        middle = _middle(positions.latitude_deg[own], positions.longitude_deg[own])
        others = _middle(positions.latitude_deg[~own], positions.longitude_deg[~own])
        smaller = (own.sum(), -file) < ((~own).sum(), -files[0])
        wrong[own] = smaller and bool(_turned_round(np.array([middle[0]]), np.array([middle[1]]), others)[0])
    return wrong


def _courses_astray(positions: Positions) -> Mask:
    """The ways, of files in which nearly all of those that tell fit their courses only if they are turned round.

    Returns:
        The positions at which such ways begin.
    """
    ordered = np.lexsort((positions.time_s, positions.mmsi, positions.file))
    start, end = (positions.take(part) for part in (ordered[:-1], ordered[1:]))
    north, east = end.latitude_deg - start.latitude_deg, wrapped_deg(end.longitude_deg - start.longitude_deg)
    bearing = _bearing(north, east, start.latitude_deg)
    turned_round = _bearing(east, north, start.longitude_deg)
    interval_s = end.time_s - start.time_s
    telling = (
        (start.file == end.file)
        & (start.mmsi == end.mmsi)
        & (interval_s > 0)
        & (interval_s <= MAX_INTERVAL_S)
        & (np.hypot(north, east) >= MIN_WAY_DEG)
        & _under_way(start)
        & _under_way(end)
        & (_angle_deg(start.course_deg, end.course_deg) < STEADY_DEG)
        & (_angle_deg(bearing, turned_round) > TELLING_DEG)
    )
    fits = telling & (_angle_deg(turned_round, start.course_deg) < FITS_DEG)
    wrong = np.zeros(len(positions), dtype=bool)
    for file in np.unique(start.file[telling]):
        ways = telling & (start.file == file)
        if ways.sum() >= MIN_WAYS and fits[ways].mean() >= MIN_SHARE:
            wrong[ordered[:-1][fits & ways]] = True
    return wrong


def _under_way(positions: Positions) -> Mask:
    """Which reports come with a speed and a course that mean something; both may be NaN."""
    speed, course = positions.speed_kn, positions.course_deg
    return np.asarray((speed >= MIN_SPEED_KN) & (speed < MAX_SPEED_KN) & (course >= 0) & (course < 360))


def _bearing(north_deg: Array, east_deg: Array, latitude_deg: Array) -> Array:
    """Clockwise from north, of a way in degrees of latitude and longitude."""
    return np.rad2deg(np.arctan2(east_deg * np.cos(np.deg2rad(latitude_deg)), north_deg))


def _angle_deg(one_deg: Array, other_deg: Array) -> Array:
    return np.abs(wrapped_deg(one_deg - other_deg))


def _middle(latitude_deg: Array, longitude_deg: Array) -> tuple[float, float]:
    return float(np.median(latitude_deg)), float(np.median(longitude_deg))


def _turned_round(latitude_deg: Array, longitude_deg: Array, middle: tuple[float, float]) -> Mask:
    def off(latitude: Array, longitude: Array) -> Array:
        return np.maximum(np.abs(latitude - middle[0]), np.abs(wrapped_deg(longitude - middle[1])))

    return (off(latitude_deg, longitude_deg) > FAR_DEG) & (off(longitude_deg, latitude_deg) < NEAR_DEG)
