"""Drawn traffic for tests: a strait with an island, two lanes, leisure craft, and own ship that meets four vessels."""

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modsim3d.world.bodies import Obstacle, extruded
from modsim3d.world.poses.base import PoseRequest, Poses
from modsim3d.world.poses.registry import read_source
from modsim3d.world.traffic.generate import DrawnTraffic
from modsim3d.world.vessels import Vessel

OWN = Vessel("own", "boat", 20.0, 6.0, 10.5)
LAND = {
    "north": ([(-2500, 1300), (0, 1100), (1500, 1250), (4500, 1300), (4500, 2200), (-2500, 2200)], 0, 20),
    "south": ([(-2500, -1300), (0, -1500), (1800, -1250), (4500, -1300), (4500, -2200), (-2500, -2200)], 0, 20),
    "island": ([(1500, 500), (1900, 450), (2100, 650), (1700, 800)], 0, 12),
}
TRAFFIC = {
    "own": {"own": {"waypoints_m": [[-1200, -450], [800, -450], [2800, -100]], "speed_m_s": [4.5, 6.0]}},
    "encounters": {
        "meets": {"kind": "head_on", "closest_m": [60, 200], "time_s": [60, 140], "kinds": ["motorboat", "coaster"]},
        "crosses": {"kind": "crossing", "closest_m": [80, 250], "time_s": 110, "kinds": ["sailing_yacht", "motorboat"]},
        "passes": {"kind": "overtaking", "closest_m": 90, "time_s": [90, 150], "kinds": ["motorboat", "pilot_boat"]},
        "passed": {"kind": "overtaken", "closest_m": [50, 120], "time_s": [80, 150], "kinds": "sailing_yacht"},
    },
    "lanes": {
        "fairway": {
            "waypoints_m": [[-2500, 0], [1000, 0], [4500, 150]],
            "width_m": 500,
            "both_ways": True,
            "per_hour": 30,
            "kinds": {"container_ship": 1, "tanker": 1, "coaster": 4, "tug": 1},
        },
        "ferry": {"waypoints_m": [[-300, -1350], [-300, 1050]], "width_m": 100, "per_hour": 12, "kinds": "ferry"},
    },
    "leisure": {
        "bay": {
            "polygon_m": [[-2400, -1300], [4400, -1300], [4400, 1300], [-2400, 1300]],
            "per_km2": 0.8,
            "kinds": {"sailing_yacht": 3, "motorboat": 3, "kayak": 2, "fishing_vessel": 1},
        }
    },
}


@dataclass(frozen=True)
class Drive:
    """A seed's vessels and poses."""

    vessels: tuple[Vessel, ...]
    traffic: DrawnTraffic
    entries: dict

    @property
    def poses(self) -> Poses:
        return self.traffic.recorded

    def column(self, name: str) -> int:
        return [vessel.name for vessel in self.vessels].index(name)

    def of(self, section: str) -> list:
        return [craft for craft in self.traffic.craft if craft.section == section]

    def way(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Places, shape (n, 2), and headings while a vessel is there."""
        column = self.column(name)
        there = self.poses.present[:, column]
        return self.poses.positions_m[there, column, :2], self.poses.headings_rad[there, column]


def traffic_keys(**changes) -> dict:
    """`TRAFFIC` with other values: `lanes__ferry__per_hour=3`."""
    keys = copy.deepcopy(TRAFFIC)
    for path, value in changes.items():
        *parents, last = path.split("__")
        section = keys
        for parent in parents:
            section = section.setdefault(parent, {})
        section[last] = value
    return keys


def draw(keys: dict, seed: int = 0, steps: int = 360, time_step_s: float = 0.5, land: dict = LAND) -> Drive:
    """Draw traffic as a scene does: the vessels first, then their poses."""
    source = read_source({"traffic": keys}, "scene").keys
    solids = {name: extruded(np.array(corners, dtype=float), *sides) for name, (corners, *sides) in land.items()}
    obstacles = tuple(Obstacle(name, parts) for name, parts in solids.items())
    request = PoseRequest(Path(), (OWN.name,), (OWN,), steps, time_step_s, seed, obstacles)
    entries, sides = source.vessels(request), ("label", "length_m", "beam_m", "air_draft_m")
    drawn = [Vessel(name, *(entry[side] for side in sides)) for name, entry in entries.items()]
    vessels, names = (OWN, *drawn), (OWN.name, *entries)
    return Drive(vessels, source.build(replace(request, vessels=vessels, names=names)), entries)
