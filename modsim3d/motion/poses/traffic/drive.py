"""The plan of a whole drive: every vessel's track."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely

from modsim3d.errors import InputError
from modsim3d.inputs.validation import join_path
from modsim3d.motion.poses.traffic.craft import Chart, Craft
from modsim3d.motion.poses.traffic.gaps import Land
from modsim3d.motion.poses.traffic.keys import TrafficSections
from modsim3d.motion.poses.traffic.lanes import draw_lane, expected_arrivals, lane_problems
from modsim3d.motion.poses.traffic.leisure import craft_on_average, draw_area
from modsim3d.motion.poses.traffic.meetings import draw_encounter, encounter_problems
from modsim3d.motion.poses.traffic.own import enter_own
from modsim3d.motion.poses.traffic.paths import rounded
from modsim3d.motion.poses.traffic.tracks import Track
from modsim3d.motion.poses.traffic.waters import LONGEST_INTERVAL_S, TooCrowded, Waters
from modsim3d.random_streams import Streams
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Vessel

WHERE = "poses.traffic"
MOST_VESSELS = 1000
MOST_SECONDS = 2_000_000
"""Vessels times the seconds of the drive."""
AFTER_LAST_ENCOUNTER_S = 30.0


@dataclass(frozen=True)
class Setting:
    """What traffic depends on beside its keys: the scene file's vessels that have a route, obstacles, times, seed."""

    own: tuple[Vessel, ...]
    obstacles: tuple[Obstacle, ...]
    steps: int
    time_step_s: float
    seed: int


@dataclass(frozen=True, eq=False)
class Plan:
    """A drive: tracks of the scene file's vessels, drawn vessels, and how many of each section found no room."""

    own: Mapping[str, Track]
    craft: tuple[Craft, ...]
    left_out: Mapping[str, int]


@lru_cache(maxsize=4)
def plan(keys_json: str, setting: Setting) -> Plan:
    """The plan for some keys, as JSON. A scene asks twice: for the vessels, then for their poses.

    Raises:
        InputError: With every problem found.
    """
    keys = TrafficSections.model_validate_json(keys_json)
    duration = _duration_s(keys, setting)
    if duration > MOST_SECONDS:
        raise refused([f": a drive of {duration:,.0f} s is too long: at most {MOST_SECONDS:,} s"])
    waters = Waters.during(Land.of(setting.obstacles), duration, setting.time_step_s, keys.clearance_m)
    chart = Chart(keys, Streams(setting.seed), waters, {})
    problems = _problems(chart) + enter_own(chart, setting.own)
    for name, meeting in keys.encounters.items():
        problems += encounter_problems(chart, name, meeting)
    if problems:
        raise refused(problems)
    try:
        craft = tuple(_draw(chart))
    except TooCrowded:
        left = ", ".join(f"{number} of {name}" for name, number in chart.left_out.items()) or "none"
        full = f"too many vessels for the water or the time: {len(waters.fleet)} found room so far, {left} did not"
        raise refused([f": {full}; ask for fewer, or for a shorter drive"]) from None
    return Plan(chart.own, craft, chart.left_out)


def refused(problems: list[str]) -> InputError:
    """The error for problems, each with its path below the section."""
    return InputError(WHERE, [f"{WHERE}{'' if text.startswith(':') else '.'}{text}" for text in problems])


def _duration_s(keys: TrafficSections, setting: Setting) -> float:
    """Time that is planned: the scene, or more, so that a short run sees the beginning of the same traffic."""
    last = max((meeting.time_s[1] + AFTER_LAST_ENCOUNTER_S for meeting in keys.encounters.values()), default=0.0)
    return max((setting.steps - 1) * setting.time_step_s, keys.duration_s, last)


def _problems(chart: Chart) -> list[str]:
    """What no seed can draw, and what would take too long."""
    problems = []
    for name, lane in chart.keys.lanes.items():
        problems += lane_problems(chart.keys, name, lane)
        if at := _on_land(chart.waters.land, np.array(lane.waypoints_m), lane.width_m):
            problems.append(f"{join_path('lanes', name)}.waypoints_m: leads over an obstacle at {at}")
    return problems or _too_many(chart)


def _too_many(chart: Chart) -> list[str]:
    keys, duration = chart.keys, max(chart.waters.end_s, LONGEST_INTERVAL_S)
    means = {f"encounters.{name}.count": float(meeting.count) for name, meeting in keys.encounters.items()}
    means |= {f"lanes.{name}.per_hour": expected_arrivals(keys, lane, duration)[0] for name, lane in keys.lanes.items()}
    means |= {f"leisure.{name}.per_km2": craft_on_average(chart, area) for name, area in keys.leisure.items()}
    most = min(MOST_VESSELS, MOST_SECONDS / duration)
    if sum(means.values()) <= most:
        return []
    key = max(means, key=lambda name: means[name])
    return [
        f"{key}: means {means[key]:,.0f} vessels, of {sum(means.values()):,.0f} in all; at most {most:,.0f} can be "
        f"planned for {duration:,.0f} s"
    ]


def _on_land(land: Land, waypoints_m: np.ndarray, width_m: float) -> str:
    """The place at which the middle of a lane leads over what is in the way of every vessel; empty if nowhere."""
    line = shapely.LineString(rounded(waypoints_m, width_m).places_m)
    area = land.below(0.1)
    if not area.intersects(line):
        return ""
    place = shapely.get_coordinates(area.intersection(line))[0]
    return f"[{place[0]:.0f}, {place[1]:.0f}]"


def _draw(chart: Chart) -> Iterator[Craft]:
    """All drawn vessels, in the order of their right of way."""
    for name, meeting in chart.keys.encounters.items():
        yield from draw_encounter(chart, name, meeting)
    for name, lane in chart.keys.lanes.items():
        yield from draw_lane(chart, name, lane)
    for name, area in chart.keys.leisure.items():
        yield from draw_area(chart, name, area)
