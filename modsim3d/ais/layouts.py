"""The published column layouts of AIS in CSV, by the names of their columns.

- Danish Maritime Authority: `!_README_information_CSV_files.txt` beside the daily files on its AIS data server;
  26 columns, times as 31/12/2015 23:59:59. It describes column C as the distance to starboard and D as that to port.
  The columns carry what ships broadcast, where C is to port and D to starboard (ITU-R M.1371-5, annex 8, figure 41),
  and so they are read here.
- MarineCadastre (NOAA, BOEM), to 2024: "AIS Data Dictionary", 17 columns from MMSI to TransceiverClass, times as
  2017-02-01T20:05:07.
- MarineCadastre, 2025: the same in lower case, longitude before latitude, times with a space in the middle.

Columns are found by name, in any order and case. Only time, identity and position must be there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

DANISH, MARINECADASTRE, MARINECADASTRE_2025 = "Danish Maritime Authority", "MarineCadastre", "MarineCadastre 2025"
NEEDED = ("time", "mmsi", "latitude", "longitude")


@dataclass(frozen=True)
class Layout:
    """A CSV layout.

    Attributes:
        name: Name in messages.
        columns: Our name of a column → its name in the file, in the published case.
        time_format: Format of times, for `strptime`.
        station: Column that says what kind of sender a report comes from, and the values there that mean ships.
    """

    name: str
    columns: dict[str, str]
    time_format: str
    station: tuple[str, frozenset[str]] | None = field(default=None)

    def found(self, header: Sequence[str]) -> dict[str, str]:
        """Our name → the file's own name, of the columns that a header has."""
        known = {_plain(name): name for name in header}
        return {ours: known[_plain(name)] for ours, name in self.columns.items() if _plain(name) in known}

    def missing(self, header: Sequence[str]) -> list[str]:
        """Columns that must be there and are not."""
        found = self.found(header)
        return [self.columns[name] for name in NEEDED if name not in found]


LAYOUTS = (
    Layout(
        DANISH,
        {
            "time": "# Timestamp",
            "station": "Type of mobile",
            "mmsi": "MMSI",
            "latitude": "Latitude",
            "longitude": "Longitude",
            "speed": "SOG",
            "course": "COG",
            "heading": "Heading",
            "name": "Name",
            "ship_type": "Ship type",
            "beam": "Width",
            "length": "Length",
            "to_bow": "A",
            "to_stern": "B",
            "to_port": "C",
            "to_starboard": "D",
        },
        "%d/%m/%Y %H:%M:%S",
        ("station", frozenset({"class a", "class b"})),
    ),
    Layout(
        MARINECADASTRE,
        {
            "time": "BaseDateTime",
            "mmsi": "MMSI",
            "latitude": "LAT",
            "longitude": "LON",
            "speed": "SOG",
            "course": "COG",
            "heading": "Heading",
            "name": "VesselName",
            "ship_type": "VesselType",
            "length": "Length",
            "beam": "Width",
        },
        "%Y-%m-%d %H:%M:%S",
    ),
    Layout(
        MARINECADASTRE_2025,
        {
            "time": "base_date_time",
            "mmsi": "mmsi",
            "latitude": "latitude",
            "longitude": "longitude",
            "speed": "sog",
            "course": "cog",
            "heading": "heading",
            "name": "vessel_name",
            "ship_type": "vessel_type",
            "length": "length",
            "beam": "width",
        },
        "%Y-%m-%d %H:%M:%S",
    ),
)


def _plain(name: str) -> str:
    """A column's name without case, and without the mark that makes a header of `# Timestamp`."""
    return name.strip().lstrip("# ").lower()


LEAST_NAMES = 3
"""A header with fewer known names is of some other kind of file."""


def layout_of(header: Sequence[str]) -> Layout | None:
    """The layout that a header fits best, or None if it fits none.

    A name that only one layout has says more than one that several share, so of those equally well fitted the one
    whose needed columns are there is taken.
    """
    best = max(LAYOUTS, key=lambda layout: (-len(layout.missing(header)), len(layout.found(header))))
    telling = [name for name in best.found(header).values() if len(name.strip()) > 1]  # any table may have an A and a B
    return best if len(telling) >= LEAST_NAMES else None
