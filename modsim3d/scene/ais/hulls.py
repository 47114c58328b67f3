"""The size of each vessel and the place of its antenna, from its own reports or from its type."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.io.strict_text import load_yaml
from modsim3d.scene.ais.messages import Particulars

TABLE = Path(__file__).with_name("ship_types.yaml")
UNKNOWN = "unknown"


@dataclass(frozen=True)
class ShipType:
    """A group of ship types: its label for a detector, its typical dimensions, and the codes and words that mean it."""

    label: str
    names: tuple[str, ...]  # labels that detectors may have for it, the most exact first
    length_m: float
    beam_m: float
    air_draft_m: float
    spellings: frozenset[str]


@cache
def ship_types() -> Mapping[str, ShipType]:
    """All groups by name."""
    types: dict[str, ShipType] = {}
    for group, entry in load_yaml(TABLE, "table of ship types").items():
        length_m, beam_m, air_draft_m = (float(entry[key]) for key in ("length_m", "beam_m", "air_draft_m"))
        codes = [str(code) for first, last in entry["codes"] for code in range(first, last + 1)]
        types[group] = ShipType(
            entry["label"], tuple(entry["names"]), length_m, beam_m, air_draft_m, frozenset(codes + entry["words"])
        )
    return types


@cache
def group_of(text: str) -> str:
    """The group of a ship type, given as a code or a word; `unknown` for any other text."""
    plain = text.strip().lower()
    number, point, zeros = plain.partition(".")
    if point and not zeros.strip("0"):  # 70.0, as tables with gaps in them are often saved
        plain = number
    return next((group for group, kind in ship_types().items() if plain in kind.spellings), UNKNOWN)


MAX_LENGTH_M, MAX_BEAM_M = 460.0, 125.0  # longest was Seawise Giant, 458 m, widest Pioneering Spirit, 124 m
MIN_M = 0.1  # tables give dimensions in metres, or in tenths of them; no length or beam below is believed


@dataclass(frozen=True)
class AisHull:
    """A vessel as the scene needs it."""

    name: str  # as broadcast, or empty
    group: str
    length_m: float
    beam_m: float
    air_draft_m: float
    ahead_m: float  # the centre of the hull lies this far ahead of the antenna, and so far to port
    to_port_m: float
    # which of `type`, `length`, `beam`, `antenna` were left open, and `air_draft`, which always is
    defaults: tuple[str, ...]


def antenna_offset(
    to_bow_m: float, to_stern_m: float, to_port_m: float, to_starboard_m: float
) -> tuple[float, float] | None:
    """Distances of the hull's centre ahead and to port of the antenna (ITU-R M.1371-5, annex 8, figure 41). The
    distances given are A, B, C and D of the standard: the centre is (A − B) / 2 ahead and (C − D) / 2 to port. A = C =
    0 with B and D given means that only the size is known; then the result is None."""
    if to_bow_m == 0 and to_port_m == 0:
        return None
    return (to_bow_m - to_stern_m) / 2, (to_port_m - to_starboard_m) / 2


def hulls(particulars: Particulars, mmsi: list[int]) -> dict[int, AisHull]:
    """The hull of each of some vessels, from the latest value that it reported of each dimension."""
    sizes = particulars.to_bow_m, particulars.to_stern_m, particulars.to_port_m, particulars.to_starboard_m
    texts = particulars.ship_type.astype(str), particulars.name.astype(str)
    whole = particulars.length_m, particulars.beam_m
    reported = particulars.take(np.lexsort((*sizes, *whole, *texts, particulars.time_s, particulars.mmsi)))
    first = np.searchsorted(reported.mmsi, mmsi, side="left")
    stop = np.searchsorted(reported.mmsi, mmsi, side="right")
    return {
        vessel: _hull(reported.take(np.arange(a, b)))
        for vessel, a, b in zip(mmsi, first.tolist(), stop.tolist(), strict=True)
    }


def _hull(reported: Particulars) -> AisHull:
    groups = [group for text in reported.ship_type if (group := group_of(text)) != UNKNOWN]
    names = [name for name in reported.name if name]
    group = groups[-1] if groups else UNKNOWN
    typical = ship_types()[group]
    length, ends = _extent(reported.to_bow_m, reported.to_stern_m, 511, reported.length_m, MAX_LENGTH_M)
    beam, sides = _extent(reported.to_port_m, reported.to_starboard_m, 63, reported.beam_m, MAX_BEAM_M)
    offset = antenna_offset(*ends, *sides) if ends is not None and sides is not None else None
    left_open = {"type": not groups, "length": length is None, "beam": beam is None, "antenna": offset is None}
    defaults = [name for name, is_open in left_open.items() if is_open]
    return AisHull(
        names[-1] if names else "",
        group,
        typical.length_m if length is None else length,
        typical.beam_m if beam is None else beam,
        typical.air_draft_m,
        *(offset or (0.0, 0.0)),
        (*defaults, "air_draft"),
    )


def _extent(
    one_m: Array, other_m: Array, most_m: float, whole_m: Array, limit_m: float
) -> tuple[float | None, tuple[float, float] | None]:
    """The latest length or beam, and the distances from the antenna to both ends; None where not known. `one_m` is A or
    C, and `other_m` B or D; `whole_m` is the length or beam where the source gives it itself, all of shape (n,).
    `most_m` is the largest value that fits the message's field and means "this or more"; above `limit_m` none is
    believed."""
    total = one_m + other_m
    good = np.flatnonzero((total >= MIN_M) & (total <= limit_m) & (np.minimum(one_m, other_m) >= 0))
    good = good[np.maximum(one_m, other_m)[good] < most_m]
    if len(good):
        last = good[-1]
        return float(total[last]), (float(one_m[last]), float(other_m[last]))
    given = np.flatnonzero((whole_m >= MIN_M) & (whole_m <= limit_m))
    return (float(whole_m[given[-1]]) if len(given) else None), None
