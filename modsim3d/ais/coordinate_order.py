"""Latitude and longitude in each other's columns of a table: an error, unless the user asks for the exchange.

A table counts as swapped only if a position in it is impossible as it stands and possible with the two values
exchanged, such as latitude 110, longitude 35. Whether latitude 12, longitude 56 is Denmark or the Arabian Sea cannot be
known from the file: check the origin that `ais` prints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.ais.cleaning import NO_LATITUDE, NO_LONGITUDE
from modsim3d.ais.reports import Positions
from modsim3d.arrays import Array, Mask
from modsim3d.errors import InputError

LISTED_ROWS = 5


def exchanged(positions: Positions) -> Positions:
    """The same positions with latitude and longitude exchanged."""
    return replace(positions, latitude_deg=positions.longitude_deg, longitude_deg=positions.latitude_deg)


def check_order(source: str, positions: Positions, exchange: bool) -> None:
    """Refuse positions that are possible only with latitude and longitude exchanged.

    Args:
        source: What to call the file.
        positions: Positions of a table, after the exchange if there was one.
        exchange: Whether latitude and longitude were exchanged already, because the user asked for it.

    Raises:
        InputError: There are such positions; their rows are named.
    """
    latitude, longitude = positions.latitude_deg, positions.longitude_deg
    wrong = np.flatnonzero(~_possible(latitude, longitude) & _possible(longitude, latitude))
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


def _possible(latitude_deg: Array, longitude_deg: Array) -> Mask:
    """Whether both values are within their range or say that they are not known, shape (n,)."""
    latitude = (np.abs(latitude_deg) <= 90) | (latitude_deg == NO_LATITUDE)
    longitude = (np.abs(longitude_deg) <= 180) | (longitude_deg == NO_LONGITUDE)
    return np.asarray(latitude & longitude)
