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
    """A group of ship types: its label for a detector, its typical dimensions, and the codes and words that mean it."""

    label: str
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
        types[group] = ShipType(entry["label"], length_m, beam_m, air_draft_m, frozenset(codes + entry["words"]))
    return types


@cache
def group_of(text: str) -> str:
    """The group of a ship type, given as a code or a word; `unknown` for any other text."""
    plain = text.strip().lower()
    number, point, zeros = plain.partition(".")
    if point and not zeros.strip("0"):  # 70.0, as tables with gaps in them are often saved
        plain = number
    return next((group for group, kind in ship_types().items() if plain in kind.spellings), UNKNOWN)
