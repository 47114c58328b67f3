"""Finds latitude and longitude in each other's place."""

from __future__ import annotations

import numpy as np

from modsim3d.ais.cleaning import NO_LATITUDE
from modsim3d.ais.region import Region, wrapped_deg
from modsim3d.ais.reports import Mask, Positions
from modsim3d.errors import InputError
from modsim3d.frames import Array

NEAR_DEG, FAR_DEG = 1.0, 5.0
"""What turns up within the one when turned round, and beyond the other as it stands, was swapped."""


def swapped_error(source: str, positions: Positions, row: int, why: str) -> InputError:
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
        raise swapped_error(source, positions, int(np.argmax(wrong)), "a latitude lies between −90 and 90")


def inside_if_swapped(positions: Positions, region: Region) -> Mask:
    """Which positions are outside a region, but inside it with latitude and longitude exchanged."""
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    return ~region.holds(latitude, longitude) & region.holds(longitude, latitude)


def check_neighbours(sources: list[str], positions: Positions) -> None:
    """Refuse positions that would be where the vessel, or the traffic of the other files, is if they were swapped.

    Args:
        sources: What to call each file.
        positions: In any order.

    Raises:
        InputError: With the first such row.
    """
    for wrong, why in (
        (_vessels_astray(positions), "swapped, it would be where this vessel is at other times"),
        (_files_astray(positions), "swapped, this file's traffic would be where that of the other files is"),
    ):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[np.lexsort((positions.row[wrong], positions.file[wrong]))[0]])
            raise swapped_error(sources[positions.file[row]], positions, row, why)


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


def _middle(latitude_deg: Array, longitude_deg: Array) -> tuple[float, float]:
    return float(np.median(latitude_deg)), float(np.median(longitude_deg))


def _turned_round(latitude_deg: Array, longitude_deg: Array, middle: tuple[float, float]) -> Mask:
    def off(latitude: Array, longitude: Array) -> Array:
        return np.maximum(np.abs(latitude - middle[0]), np.abs(wrapped_deg(longitude - middle[1])))

    return (off(latitude_deg, longitude_deg) > FAR_DEG) & (off(longitude_deg, latitude_deg) < NEAR_DEG)
