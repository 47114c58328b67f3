"""The pose source `traffic`: vessels and poses that the seed draws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.validation import nearest
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys, generated_timestamps
from modsim3d.motion.poses.replay import RecordedPoses, check_pose_count
from modsim3d.motion.poses.traffic.craft import MOST_ARRIVALS, Chart, Craft, between
from modsim3d.motion.poses.traffic.gaps import Land, least_gaps
from modsim3d.motion.poses.traffic.keys import LaneKeys, TrafficSections
from modsim3d.motion.poses.traffic.kinds import Hull, turning_radius_m
from modsim3d.motion.poses.traffic.lanes import draw_lane, expected_arrivals, lane_problems
from modsim3d.motion.poses.traffic.leisure import craft_on_average, draw_area
from modsim3d.motion.poses.traffic.meetings import draw_encounter
from modsim3d.motion.poses.traffic.paths import corner_radii_m, rounded
from modsim3d.motion.poses.traffic.tracks import Sweep, Track
from modsim3d.motion.poses.traffic.waters import Waters
from modsim3d.random_streams import Purpose, Streams, on_grid
from modsim3d.vessels.obstacles import Obstacle
from modsim3d.vessels.vessel import Vessel

MOST_PLANNED = 4_000_000
"""Vessels times compared times of a drive."""
AFTER_LAST_ENCOUNTER_S = 30.0


@dataclass(frozen=True, eq=False)
class DrawnTraffic(RecordedPoses):
    """The poses of a drive, with what was drawn.

    Attributes:
        craft: The drawn vessels, in their order in the scene.
        left_out: Vessels for which there was no room, by section, such as `lanes.north`.
    """

    craft: tuple[Craft, ...]
    left_out: Mapping[str, int]


class TrafficKeys(SourceKeys, TrafficSections):
    """The section `poses.traffic`; see `TrafficSections` for its keys."""

    def vessels(self, request: PoseRequest) -> dict[str, dict[str, object]]:
        """Entries of the drawn vessels, as in a vessels file."""
        return {craft.name: self._entry(craft) for craft in self._plan(request).craft}

    def build(self, request: PoseRequest) -> DrawnTraffic:
        """The poses of the scene file's vessels and of the drawn ones."""
        plan = self._plan(request)
        steps, interval = request.steps or 0, request.time_step_s or 0.0
        check_pose_count("poses.traffic", steps, len(request.vessels))
        tracks = dict(plan.own) | {craft.name: craft.track for craft in plan.craft}
        times = np.arange(steps) * interval
        poses = Poses.absent(steps, len(request.vessels))
        for column, vessel in enumerate(request.vessels):
            if (track := tracks.get(vessel.name)) is not None:
                there = track.present(times)
                places, headings = track.at(times[there])
                poses.present[there, column] = True
                poses.positions_m[there, column, :2] = on_grid(places)
                poses.headings_rad[there, column] = on_grid(headings)
        return DrawnTraffic(generated_timestamps(steps, interval), poses, plan.craft, plan.left_out)

    def _entry(self, craft: Craft) -> dict[str, object]:
        hull = craft.track.hull
        entry: dict[str, object] = {
            "length_m": hull.length_m,
            "beam_m": hull.beam_m,
            "air_draft_m": hull.air_draft_m,
            "label": self.label(hull.kind),
        }
        mesh = self.kinds[hull.kind].mesh
        return entry if mesh is None else entry | {"mesh": mesh}

    def _plan(self, request: PoseRequest) -> _Plan:
        if problems := self.problems() + self._own_problems(request):
            raise InputError("poses.traffic", [f"poses.traffic.{problem}" for problem in problems])
        own = tuple(vessel for vessel in request.vessels if vessel.name in self.own)
        scene = _Scene(own, request.obstacles, request.steps or 0, request.time_step_s or 0.0, request.seed)
        return _plan(self.model_dump_json(), scene)

    def _own_problems(self, request: PoseRequest) -> list[str]:
        names = [vessel.name for vessel in request.vessels]
        return [
            f"own.{name}: no vessel '{name}' in the scene ({nearest(name, names)})"
            for name in self.own
            if name not in names
        ]


@dataclass(frozen=True)
class _Scene:
    """What the traffic depends on, beside its keys."""

    own: tuple[Vessel, ...]
    obstacles: tuple[Obstacle, ...]
    steps: int
    time_step_s: float
    seed: int


@dataclass(frozen=True, eq=False)
class _Plan:
    """The tracks of the scene file's vessels, and the drawn vessels."""

    own: Mapping[str, Track]
    craft: tuple[Craft, ...]
    left_out: Mapping[str, int]


@lru_cache(maxsize=4)
def _plan(keys_json: str, scene: _Scene) -> _Plan:
    """The plan of a whole drive. A scene asks twice: for the vessels, then for their poses."""
    keys = TrafficSections.model_validate_json(keys_json)
    waters = Waters.during(Land.of(scene.obstacles), _duration_s(keys, scene), scene.time_step_s, keys.clearance_m)
    chart = Chart(keys, Streams(scene.seed), waters, {})
    _check(chart)
    _draw_own(chart, scene)
    craft = tuple(_draw(chart))
    return _Plan(chart.own, craft, chart.left_out)


def _duration_s(keys: TrafficSections, scene: _Scene) -> float:
    """Time that is planned: the scene, or more, so that a short run sees the beginning of the same traffic."""
    last = max((meeting.time_s[1] + AFTER_LAST_ENCOUNTER_S for meeting in keys.encounters.values()), default=0.0)
    return max((scene.steps - 1) * scene.time_step_s, keys.duration_s, last)


def _check(chart: Chart) -> None:
    """Refuse what no seed can draw, and what would take too long."""
    keys, duration = chart.keys, chart.waters.end_s
    problems, total = [], float(len(keys.own) + sum(meeting.count for meeting in keys.encounters.values()))
    for name, lane in keys.lanes.items():
        problems += [*lane_problems(keys, name, lane), *_on_land(chart, name, lane)]
        mean = expected_arrivals(keys, lane, duration)[0]
        total += mean
        if mean > MOST_ARRIVALS:
            problems.append(f"lanes.{name}.per_hour: means {mean:,.0f} vessels in the lane: at most {MOST_ARRIVALS:,}")
    for name, area in keys.leisure.items():
        mean = craft_on_average(chart, area)
        total += mean
        if mean > MOST_ARRIVALS:
            problems.append(f"leisure.{name}.per_km2: means {mean:,.0f} craft in the area: at most {MOST_ARRIVALS:,}")
    times = len(chart.waters.times_s)
    if not problems and total * times > MOST_PLANNED:
        problems.append(
            f"{total:,.0f} vessels for {duration:,.0f} s are too many to plan: use fewer vessels or a shorter drive"
        )
    if problems:
        raise InputError("poses.traffic", [_path(problem) for problem in problems])


def _path(problem: str) -> str:
    return f"poses.traffic.{problem}" if problem[0].isalpha() else f"poses.traffic: {problem}"


def _on_land(chart: Chart, name: str, lane: LaneKeys) -> list[str]:
    """A lane whose middle leads over land that is in the way of every vessel."""
    middle = rounded(np.array(lane.waypoints_m), lane.width_m)
    import shapely

    land = chart.waters.land.below(0.1)
    if land.is_empty or not land.intersects(shapely.LineString(middle.places_m)):
        return []
    at = shapely.get_coordinates(land.intersection(shapely.LineString(middle.places_m)))[0]
    return [f"lanes.{name}.waypoints_m: leads over an obstacle at {_shown(at)}"]


def _shown(place: Array) -> str:
    return f"[{place[0]:.0f}, {place[1]:.0f}]"


def _draw_own(chart: Chart, scene: _Scene) -> None:
    """Enter the scene file's vessels, which make way for nobody."""
    problems: list[str] = []
    vessels = {vessel.name: vessel for vessel in scene.own}
    for name, keys in chart.keys.own.items():
        rng = chart.streams.generator(Purpose.TRAFFIC_OWN, name, step=0)
        speed = between(keys.speed_m_s, float(rng.random()))
        vessel, waypoints = vessels[name], np.array(keys.waypoints_m)
        radius = turning_radius_m(keys.turning_lengths, vessel.length_m, speed)
        room = corner_radii_m(waypoints, np.inf)
        if len(room) and room.min() < radius:
            corner = int(np.argmin(room)) + 1
            problems.append(
                f"own.{name}.waypoints_m[{corner}]: she turns on a radius of {radius:.0f} m, and the legs leave room for "
                f"{room.min():.0f} m: use longer legs or a smaller change of course"
            )
            continue
        hull = Hull(name, vessel.length_m, vessel.beam_m, vessel.air_draft_m, radius)
        track = Track(hull, rounded(waypoints, 1.5 * radius), speed, 0.0)
        problems += _own_conflicts(chart, name, track)
        chart.own[name] = track
        chart.waters.add(track)
    if problems:
        raise InputError("poses.traffic", [f"poses.traffic.{problem}" for problem in problems])


def _own_conflicts(chart: Chart, name: str, track: Track) -> list[str]:
    """What a vessel of the scene file runs into: an obstacle, or another such vessel."""
    waters, problems = chart.waters, []
    sweep = Sweep.of([track], waters.times_s, waters.interval_s)
    if waters.land.gaps(sweep, waters.interval_s, waters.clearance_m)[0] < waters.clearance_m:
        problems.append(
            f"own.{name}.waypoints_m: leads closer to an obstacle than clearance_m ({waters.clearance_m:g} m)"
        )
    for other, theirs in zip(chart.own, waters.fleet, strict=True):
        gap, step = least_gaps(sweep, theirs, waters.interval_s, waters.clearance_m)
        if gap[0] < waters.clearance_m:
            at = waters.times_s[step[0]]
            problems.append(f"own.{name}: comes closer than clearance_m to '{other}' at {at:.0f} s")
    return problems


def _draw(chart: Chart) -> Iterator[Craft]:
    """All drawn vessels, in the order of their right of way."""
    for name, meeting in chart.keys.encounters.items():
        yield from draw_encounter(chart, name, meeting)
    for name, lane in chart.keys.lanes.items():
        yield from draw_lane(chart, name, lane)
    for name, area in chart.keys.leisure.items():
        yield from draw_area(chart, name, area)
