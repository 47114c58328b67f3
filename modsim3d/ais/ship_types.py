"""Groups of ship types and the typical dimensions of each; the table is `ship_types.yaml`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from modsim3d.inputs.strict_yaml import load_yaml

TABLE = Path(__file__).with_name("ship_types.yaml")
UNKNOWN = "unknown"


@dataclass(frozen=True)
class ShipType:
    """A group of ship types: its label for a detector, and its typical dimensions."""

    label: str
    length_m: float
    beam_m: float
    air_draft_m: float


@cache
def _table() -> tuple[Mapping[str, ShipType], Mapping[str, str]]:
    """The groups, and the group of each code or word."""
    types: dict[str, ShipType] = {}
    spelt: dict[str, str] = {}
    for group, entry in load_yaml(TABLE, "table of ship types").items():
        sizes = (float(entry[key]) for key in ("length_m", "beam_m", "air_draft_m"))
        types[group] = ShipType(entry["label"], *sizes)
        codes = [str(code) for first, last in entry["codes"] for code in range(first, last + 1)]
        spelt |= dict.fromkeys([*codes, *entry["words"]], group)
    return types, spelt


def ship_types() -> Mapping[str, ShipType]:
    """All groups by name."""
    return _table()[0]


def group_of(text: str) -> str:
    """The group of a ship type, given as a code or a word; `unknown` for any other text."""
    plain = text.strip().lower()
    number, point, zeros = plain.partition(".")
    if point and not zeros.strip("0"):  # 70.0, as tables with gaps in them are often saved
        plain = number
    return _table()[1].get(plain, UNKNOWN)
