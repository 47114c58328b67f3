"""How large each vessel is and where on it its antenna stands, from what it says of itself or from its type."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.ais.reports import Particulars
from modsim3d.ais.ship_types import UNKNOWN, group_of, ship_types
from modsim3d.arrays import Array

MAX_LENGTH_M, MAX_BEAM_M = 460.0, 125.0
"""No ship was longer than Seawise Giant, 458 m, or wider than Pioneering Spirit, 124 m; fields of ones say 1022 m."""


@dataclass(frozen=True)
class Hull:
    """A vessel as the scene needs it.

    Attributes:
        name: As broadcast, or empty.
        group: Of its ship type.
        length_m: Along the hull.
        beam_m: Across it.
        air_draft_m: Height above the waterline.
        ahead_m: The centre of the hull lies this far ahead of the antenna.
        to_port_m: The centre of the hull lies this far to port of the antenna.
        defaults: Which of `type`, `length`, `beam`, `antenna` were left open; the air draft always is.
    """

    name: str
    group: str
    length_m: float
    beam_m: float
    air_draft_m: float
    ahead_m: float
    to_port_m: float
    defaults: tuple[str, ...]


def antenna_offset(to_bow_m: float, to_stern_m: float, to_port_m: float, to_starboard_m: float) -> tuple[float, float]:
    """Where the centre of the hull lies from the antenna (ITU-R M.1371-5, annex 8, figure 41).

    With A before the antenna and B behind it the middle of the length is (A − B) / 2 ahead; with C to port and D to
    starboard the middle of the beam is (C − D) / 2 to port. A = C = 0 with B and D given means that the antenna's
    place is not known, only the size.

    Args:
        to_bow_m: A.
        to_stern_m: B.
        to_port_m: C.
        to_starboard_m: D.

    Returns:
        Metres ahead, and metres to port.
    """
    if not place_known(to_bow_m, to_port_m):
        return 0.0, 0.0
    return (to_bow_m - to_stern_m) / 2, (to_port_m - to_starboard_m) / 2


def place_known(to_bow_m: float, to_port_m: float) -> bool:
    """Whether the antenna's place is given beside the dimensions."""
    return not (to_bow_m == 0 and to_port_m == 0)


def hulls(particulars: Particulars, mmsi: list[int]) -> dict[int, Hull]:
    """The hull of each vessel.

    Of each thing that a vessel says of itself the latest counts.

    Args:
        particulars: All that is known, in any order.
        mmsi: The vessels.
    """
    sizes = particulars.to_bow_m, particulars.to_stern_m, particulars.to_port_m, particulars.to_starboard_m
    texts = particulars.ship_type.astype(str), particulars.name.astype(str)
    whole = particulars.length_m, particulars.beam_m
    said = particulars.take(np.lexsort((*sizes, *whole, *texts, particulars.time_s, particulars.mmsi)))
    first = np.searchsorted(said.mmsi, mmsi, side="left")
    stop = np.searchsorted(said.mmsi, mmsi, side="right")
    return {
        vessel: _hull(said.take(np.arange(a, b)))
        for vessel, a, b in zip(mmsi, first.tolist(), stop.tolist(), strict=True)
    }


def _hull(said: Particulars) -> Hull:
    """The hull of the vessel that said this, oldest first."""
    groups = [group for text in said.ship_type if (group := group_of(text)) != UNKNOWN]
    names = [name for name in said.name if name]
    group = groups[-1] if groups else UNKNOWN
    typical = ship_types()[group]
    length, ends = _extent(said.to_bow_m, said.to_stern_m, 511, said.length_m, MAX_LENGTH_M)
    beam, sides = _extent(said.to_port_m, said.to_starboard_m, 63, said.beam_m, MAX_BEAM_M)
    ahead, to_port = 0.0, 0.0
    known = ends is not None and sides is not None and place_known(ends[0], sides[0])
    if ends is not None and sides is not None:
        ahead, to_port = antenna_offset(*ends, *sides)
    left_open = {"type": not groups, "length": length is None, "beam": beam is None, "antenna": not known}
    return Hull(
        names[-1] if names else "",
        group,
        typical.length_m if length is None else length,
        typical.beam_m if beam is None else beam,
        typical.air_draft_m,
        ahead,
        to_port,
        tuple(name for name, is_open in left_open.items() if is_open),
    )


def _extent(
    one_m: Array, other_m: Array, most_m: float, whole_m: Array, limit_m: float
) -> tuple[float | None, tuple[float, float] | None]:
    """The latest length or beam, and the latest distances to both ends of it.

    Args:
        one_m: A or C, shape (n,).
        other_m: B or D, shape (n,).
        most_m: The largest value that fits the message's field; it stands for anything beyond.
        whole_m: Where the source gives the sum itself, shape (n,).
        limit_m: What no ship exceeds.
    """
    total = one_m + other_m
    good = np.flatnonzero((total > 0) & (total <= limit_m) & (np.minimum(one_m, other_m) >= 0))
    good = good[np.maximum(one_m, other_m)[good] < most_m]
    if len(good):
        last = good[-1]
        return float(total[last]), (float(one_m[last]), float(other_m[last]))
    given = np.flatnonzero((whole_m > 0) & (whole_m <= limit_m))
    return (float(whole_m[given[-1]]) if len(given) else None), None
