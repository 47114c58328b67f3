"""The column layouts of AIS in CSV, from `layouts.yaml`, which says how to add one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from modsim3d.inputs.strict_yaml import load_yaml

TABLE = Path(__file__).with_name("layouts.yaml")
NEEDED = ("time", "mmsi", "latitude", "longitude")
LEAST_NAMES = 3
"""A header with fewer known names is of some other kind of file."""


@dataclass(frozen=True)
class Layout:
    """A CSV layout.

    Attributes:
        name: Who publishes it.
        columns: Our name of a column → its name in the file, in the published case.
        time_format: Format of times, for `strptime`.
        ships: Words in the column `station` that mean ships, in lower case.
    """

    name: str
    columns: Mapping[str, str]
    time_format: str
    ships: frozenset[str]

    def found(self, header: Sequence[str]) -> dict[str, str]:
        """Our name → the file's own name, of the columns that a header has."""
        known = {_plain(name): name for name in header}
        return {ours: known[_plain(name)] for ours, name in self.columns.items() if _plain(name) in known}

    def missing(self, header: Sequence[str]) -> list[str]:
        """Columns that a header lacks and must have."""
        found = self.found(header)
        return [self.columns[name] for name in NEEDED if name not in found]


@cache
def layouts() -> tuple[Layout, ...]:
    """All layouts."""
    entries = load_yaml(TABLE, "table of CSV layouts").items()
    return tuple(
        Layout(name, entry["columns"], entry["time_format"], frozenset(entry.get("ships", ())))
        for name, entry in entries
    )


def layout_of(header: Sequence[str]) -> Layout | None:
    """The layout that a header fits best, or None if it fits none.

    A layout that misses fewer of its needed columns comes first, because layouts share the names of many others.
    """
    best = max(layouts(), key=lambda layout: (-len(layout.missing(header)), len(layout.found(header))))
    telling = [name for name in best.found(header).values() if len(name.strip()) > 1]  # any table may have an A and a B
    return best if len(telling) >= LEAST_NAMES else None


def _plain(name: str) -> str:
    """A column's name in lower case, without the mark that makes a header of `# Timestamp`."""
    return name.strip().lstrip("# ").lower()
