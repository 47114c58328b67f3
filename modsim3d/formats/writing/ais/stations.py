"""Which vessels carry AIS, of which class, and under which number and name."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.scene.scene import Scene
from modsim3d.vessels.vessel import Vessel

TABLE = Path(__file__).with_name("carriage.yaml")
LEAST_LENGTH_M = 5.0
"""Shorter craft carry no AIS unless the scene says so."""
MADE_UP_MMSI = 799_000_000
"""The country codes of ships go from 201 to 775 (ITU, table of maritime identification digits), so 799 is nobody's."""
MADE_UP_NUMBERS = 1_000_000
_MMSI = re.compile(r"[2-7]\d{8}|98\d{7}", re.ASCII)
MOST_ENDS_M, MOST_SIDES_M = 511, 63
"""The largest distances from the antenna to an end and to a side that fit a message; they mean this or more."""
NO_CLASS = "none"


@dataclass(frozen=True, eq=False)
class Station:
    """The AIS equipment of a vessel.

    Attributes:
        vessel: Index of the vessel in the scene; `name` is its ID, which is truth and is never sent.
        ais_class: `A` or `B`.
        own: Whether it is own ship's, whose receiver gives its reports as `VDO`.
        sides_m: Whole metres from the antenna to bow, stern, port and starboard: A, B, C and D of the standard.
    """

    vessel: int
    name: str
    mmsi: int
    ais_class: str
    ship_type: int
    own: bool
    length_m: float
    sides_m: tuple[int, int, int, int]
    height_m: float

    @property
    def antenna_m(self) -> Array:
        """Place of the antenna in VCF, shape (3,): such that the reported sides give the centre of the hull."""
        bow, stern, port, starboard = self.sides_m
        return np.array([(stern - bow) / 2, (starboard - port) / 2, self.height_m])

    @property
    def ship_name(self) -> str:
        """A made-up name."""
        return f"SIM {self.mmsi:09d}"

    @property
    def call_sign(self) -> str:
        """A made-up call sign, of seven letters and digits at most."""
        return f"S{np.base_repr(self.mmsi, 36)}"


def stations(scene: Scene, own: Collection[int]) -> tuple[Station, ...]:
    """The stations of a scene's vessels, in the order of the vessels; `own` are the indices of own ships."""
    found = []
    numbers = mmsi_of([vessel.name for vessel in scene.vessels])
    for index, (vessel, mmsi) in enumerate(zip(scene.vessels, numbers, strict=True)):
        chosen, ship_type = usual(vessel, index in own)
        chosen = scene.ais.vessels.get(vessel.name, chosen)
        if chosen != NO_CLASS:
            sides = antenna_sides(vessel, chosen)
            height_m = vessel.air_draft_m / 2
            found.append(
                Station(index, vessel.name, mmsi, chosen, ship_type, index in own, vessel.length_m, sides, height_m)
            )
    return tuple(found)


def usual(vessel: Vessel, own: bool) -> tuple[str, int]:
    """Class and ship type that fit a vessel's label and size. Own ships carry class A: they are craft at work."""
    label = vessel.label.lower()
    fitting = (kind for kind in _table()["kinds"] if any(word in label for word in kind["words"]))
    kind = next(fitting, _table()["others"])
    if own:
        return "A", kind.get("ship_type", 0)
    if kind.get("none") or vessel.length_m < LEAST_LENGTH_M:
        return NO_CLASS, kind.get("ship_type", 0)
    return ("A" if vessel.length_m >= kind["class_a_from_m"] else "B"), kind["ship_type"]


@cache
def _table() -> dict[str, Any]:
    table: dict[str, Any] = load_yaml(TABLE, "table of AIS carriage")
    return table


def mmsi_of(names: list[str]) -> list[int]:
    """The number of each vessel: its ID if that is a ship's MMSI, else a made-up one that depends on the ID.

    If two IDs lead to the same number, the later one gets the next that is free.
    """
    taken: set[int] = set()
    for name in names:
        if _MMSI.fullmatch(name):
            taken.add(int(name))
    numbers = []
    for name in names:
        if _MMSI.fullmatch(name):
            numbers.append(int(name))
            continue
        digest = hashlib.blake2b(name.encode("utf-8"), digest_size=8).digest()
        offset = int.from_bytes(digest, "little") % MADE_UP_NUMBERS
        while MADE_UP_MMSI + offset in taken:
            offset = (offset + 1) % MADE_UP_NUMBERS
        taken.add(MADE_UP_MMSI + offset)
        numbers.append(MADE_UP_MMSI + offset)
    return numbers


def antenna_sides(vessel: Vessel, ais_class: str) -> tuple[int, int, int, int]:
    """Metres from the antenna to bow, stern, port and starboard.

    The antenna is on the centre line: a quarter of the length from the stern on class A ships, whose bridge is mostly
    aft, else amidships. Length and beam are rounded to whole metres.
    """
    length, beam = max(round(vessel.length_m), 1), max(round(vessel.beam_m), 1)
    stern = round(length / 4) if ais_class == "A" else length // 2
    ends = min(length - stern, MOST_ENDS_M), min(stern, MOST_ENDS_M)
    return *ends, min(beam - beam // 2, MOST_SIDES_M), min(beam // 2, MOST_SIDES_M)
