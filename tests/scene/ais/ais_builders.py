"""Small AIS files and options for the tests of modsim3d.scene.ais."""

import json
from pathlib import Path
from typing import Any

from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.traffic import AisTraffic, read_traffic
from modsim3d.scene.ais.vessel_track import VesselTrack

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "ais"
FORMATS = {
    "danish.csv": "Danish Maritime Authority",
    "marinecadastre.csv": "MarineCadastre",
    "marinecadastre_2025.csv": "MarineCadastre 2025",
    "receiver.nmea": None,
}
"""Each sample and the layout of modsim3d/ais/layouts.yaml that it has, None for sentences."""
SAMPLE_NAMES = tuple(FORMATS)
TABLES = tuple(name for name, layout in FORMATS.items() if layout)
OLD_HEADER = (
    "MMSI,BaseDateTime,LAT,LON,SOG,COG,Heading,VesselName,IMO,CallSign,VesselType,Status,Length,Width,Draft,Cargo,"
    "TransceiverClass"
)


def row(
    second: int,
    latitude: Any = 56.0,
    longitude: Any = 12.0,
    speed: Any = 10.0,
    course: Any = 90.0,
    heading: Any = 90.0,
    mmsi: Any = 219000001,
    ship_type: Any = 70,
    length: Any = 100,
    beam: Any = 20,
) -> str:
    """A row of MarineCadastre's old layout, seconds after ten o'clock."""
    time = f"2024-01-04T{10 + second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}"
    return f"{mmsi},{time},{latitude},{longitude},{speed},{course},{heading},X,,,{ship_type},0,{length},{beam},,,A"


def old_file(folder: Path, *rows: str, name: str = "old.csv", header: str = OLD_HEADER) -> Path:
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def traffic_of(*paths: Path, **options: Any) -> AisTraffic:
    return read_traffic(list(paths), Options(**options))


def only(traffic: AisTraffic) -> VesselTrack:
    (vessel,) = traffic.vessels
    return vessel


def read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
