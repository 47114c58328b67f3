"""The pose source `traffic`: vessels and poses that the seed draws."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product

import numpy as np
import shapely

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Purpose, Streams, on_grid
from modsim3d.io.validation import join_path, nearest
from modsim3d.world.poses.base import PoseRequest, Poses, SourceKeys, generated_timestamps
from modsim3d.world.poses.replay import RecordedPoses, check_pose_count
from modsim3d.world.traffic import lanes
from modsim3d.world.traffic.clearance import MAX_INTERVAL_S, CrowdedSea, Land, Waters, least_gaps
from modsim3d.world.traffic.encounters import draw_encounter, encounter_problems
from modsim3d.world.traffic.keys import LeisureKeys, OwnKeys, TrafficSections
from modsim3d.world.traffic.lanes import Chart, Craft, between
from modsim3d.world.traffic.paths import VesselPath, Wanderer, corner_radii_m, rounded
from modsim3d.world.traffic.tracks import DrawnHull, Sweep, Track, turning_radius_m
from modsim3d.world.vessels import Vessel, shoebox

TRIES = 40
GOOD_ENOUGH = 0.3  # crowding with which a craft is taken at once, and not the best of all tries
HEAD_STARTS_S = (0.0, 20.0, 40.0, 60.0)  # a craft may be along her way, which is longer than the drive, at its start
PACES = (1.0, 0.85, 0.7)
SHORE_M = (12.0, 60.0)  # distance from the shore of those that keep near it, beside the clearance
SHALLOW_M = 1.0  # what begins lower than this above the sea takes water away from the area


def craft_on_average(chart: Chart, area: LeisureKeys) -> float:
    """Mean number of craft in an area."""
    water = shapely.Polygon(area.polygon_m).difference(chart.waters.land.below(SHALLOW_M))
    return float(area.per_km2 * water.area / 1e6)


def draw_area(chart: Chart, name: str, area: LeisureKeys) -> Iterator[Craft]:
    """The craft of an area."""
    section = f"leisure.{name}"
    arrivals = lanes.arrivals(chart.streams, name, craft_on_average(chart, area))
    for ordinal in range(1, len(arrivals) + 1):
        track = _draw_craft(chart, name, area, ordinal)
        craft = None if track is None else Craft(f"{name}_{ordinal}", section, track)
        yield from chart.accept(craft, section)


def _draw_craft(chart: Chart, name: str, area: LeisureKeys, ordinal: int) -> Track | None:
    """The first of many tries that keeps well clear of all others, or the best; None if none keeps clear."""
    best, least, kind = None, np.inf, ""
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_LEISURE, name, str(ordinal), step=attempt)
        if not attempt:
            kind = lanes.kind_of(area, rng)
        hull, speed = chart.hull(area, kind, rng)
        # Most need not look at the others leg by leg, which takes longer.
        is_clear = None if not attempt else partial(_is_clear, chart, hull, speed)
        wind = chart.keys.wind_from_rad if chart.keys.kinds[kind].sails else None
        water = _water(chart, area, hull)
        path = _course(chart, hull, Wanderer(water, hull.turning_radius_m, speed, wind, rng, is_clear))
        if path is None:
            continue
        slowest = chart.keys.speed_range(area, kind)[0]
        tracks = [
            Track(hull, path, speed * pace, -ahead, 1 - pace)
            for ahead, pace in product(HEAD_STARTS_S, PACES)
            if pace == 1 or speed * pace >= slowest
        ]
        verdict = chart.waters.judge(tracks)
        if verdict.track is not None and verdict.crowding < least:
            best, least = verdict.track, verdict.crowding
        if least <= GOOD_ENOUGH:
            break
    return best


def _course(chart: Chart, hull: DrawnHull, wanderer: Wanderer) -> VesselPath | None:
    needed = wanderer.speed_m_s * (chart.waters.end_s + HEAD_STARTS_S[-1] + 2 * chart.waters.interval_s)
    if chart.keys.kinds[hull.kind].near_shore:
        off = hull.reach_m + chart.keys.clearance_m + between(SHORE_M, float(wanderer.rng.random()))
        path = wanderer.along(chart.waters.land.below(SHALLOW_M).buffer(off).boundary, needed)
        if path is not None:
            return path
    return wanderer.course(needed)


def _water(chart: Chart, area: LeisureKeys, hull: DrawnHull) -> shapely.Geometry:
    land = chart.waters.land.below(hull.air_draft_m).buffer(hull.reach_m + chart.keys.clearance_m, quad_segs=4)
    water = shapely.Polygon(area.polygon_m).buffer(-hull.reach_m).difference(land)
    shapely.prepare(water)
    return water


def _is_clear(chart: Chart, hull: DrawnHull, speed_m_s: float, leg: Array, gone_m: float) -> bool:
    """Whether a leg that begins after a distance on her way keeps clear of the vessels planned so far."""
    track = Track(hull, VesselPath.through(leg), speed_m_s, gone_m / speed_m_s)
    return chart.waters.is_clear(track, track.start_s, track.end_s)


EASY = 1.5  # radii of turns in least radii, where the legs leave room


def enter_own(chart: Chart, vessels: Sequence[Vessel]) -> list[str]:
    """Enter the vessels that have a route into the waters; returns what is wrong with the routes."""
    named, problems = {vessel.name: vessel for vessel in vessels}, []
    for name, keys in chart.keys.own.items():
        rng = chart.streams.generator(Purpose.TRAFFIC_OWN, name, step=0)
        speed, vessel = between(keys.speed_m_s, float(rng.random())), named[name]
        problems += _tight(name, keys, vessel)
        radius = turning_radius_m(keys.turning_lengths, vessel.length_m, speed)
        hull = DrawnHull(name, vessel.length_m, vessel.beam_m, vessel.air_draft_m, radius)
        track = Track(hull, rounded(np.array(keys.waypoints_m), EASY * radius), speed, 0.0)
        problems += _conflicts(chart, name, track)
        chart.own[name] = track
        chart.waters.add(track)
    return problems


def _tight(name: str, keys: OwnKeys, vessel: Vessel) -> list[str]:
    """A corner in which there is no room for her turn at her greatest speed."""
    radius = turning_radius_m(keys.turning_lengths, vessel.length_m, keys.speed_m_s[1])
    room = corner_radii_m(np.array(keys.waypoints_m), np.inf)
    if not len(room) or room.min() >= radius:
        return []
    turns = f"she turns on a radius of {radius:.0f} m, and the legs leave room for {room.min():.0f} m"
    corner = f"own.{name}.waypoints_m[{int(np.argmin(room)) + 1}]"
    return [f"{corner}: {turns}: use longer legs or a smaller change of course"]


def _conflicts(chart: Chart, name: str, track: Track) -> list[str]:
    waters, problems = chart.waters, []
    sweep, least = Sweep.of([track], waters.times_s, waters.interval_s), f"clearance_m ({waters.clearance_m:g} m)"
    if waters.land.gaps(sweep, waters.interval_s, waters.clearance_m)[0] < waters.clearance_m:
        problems.append(f"own.{name}.waypoints_m: leads closer to an obstacle than {least}")
    for other, other_sweep in zip(chart.own, waters.fleet, strict=True):
        gap, step = least_gaps(sweep, other_sweep, waters.interval_s, waters.clearance_m)
        if gap[0] < waters.clearance_m:
            problems.append(f"own.{name}: comes closer to '{other}' than {least} at {waters.times_s[step[0]]:.0f} s")
    return problems


WHERE = "poses.traffic"
MAX_VESSELS = 1000
MAX_SECONDS = 2_000_000  # vessels times the seconds of the drive
AFTER_LAST_ENCOUNTER_S = 30.0


@dataclass(frozen=True, eq=False)
class DrivePlan:
    """A drive: tracks of the scene file's vessels, drawn vessels, and how many of each section found no room."""

    own: Mapping[str, Track]
    craft: tuple[Craft, ...]
    left_out: Mapping[str, int]


@lru_cache(maxsize=4)
def plan(keys_json: str, setting: PoseRequest) -> DrivePlan:
    """The plan for some keys, as JSON. A scene asks twice: for the vessels, then for their poses. `setting` has no
    vessels of the scene file but those with a route, and no names. Raises InputError with every problem found."""
    keys = TrafficSections.model_validate_json(keys_json)
    # Of a short scene as of a longer one, so that a short run sees the beginning of the same traffic.
    last = max((meeting.time_s[1] + AFTER_LAST_ENCOUNTER_S for meeting in keys.encounters.values()), default=0.0)
    duration = max(((setting.steps or 0) - 1) * (setting.time_step_s or 0.0), keys.duration_s, last)
    if duration > MAX_SECONDS:
        raise refused([f": a drive of {duration:,.0f} s is too long: at most {MAX_SECONDS:,} s"])
    waters = Waters.during(Land.of(setting.obstacles), duration, setting.time_step_s or 0.0, keys.clearance_m)
    chart = Chart(keys, Streams(setting.seed), waters, {})
    problems = _problems(chart) + enter_own(chart, setting.vessels)
    for name, meeting in keys.encounters.items():
        problems += encounter_problems(chart, name, meeting)
    if problems:
        raise refused(problems)
    try:
        craft = tuple(_draw(chart))
    except CrowdedSea:
        left = ", ".join(f"{number} of {name}" for name, number in chart.left_out.items()) or "none"
        full = f"too many vessels for the water or the time: {len(waters.fleet)} found room so far, {left} did not"
        raise refused([f": {full}; ask for fewer, or for a shorter drive"]) from None
    return DrivePlan(chart.own, craft, chart.left_out)


def refused(problems: list[str]) -> InputError:
    """The error for problems, each with its path below the section."""
    return InputError(WHERE, [f"{WHERE}{'' if text.startswith(':') else '.'}{text}" for text in problems])


def _problems(chart: Chart) -> list[str]:
    """Problems of requests that no seed can draw, or that would take too long."""
    problems = []
    for name, lane in chart.keys.lanes.items():
        problems += lanes.lane_problems(chart.keys, name, lane)
        if at := _on_land(chart.waters.land, np.array(lane.waypoints_m), lane.width_m):
            problems.append(f"{join_path('lanes', name)}.waypoints_m: leads over an obstacle at {at}")
    return problems or _too_many(chart)


def _too_many(chart: Chart) -> list[str]:
    keys, duration = chart.keys, max(chart.waters.end_s, MAX_INTERVAL_S)
    means = {f"encounters.{name}.count": float(meeting.count) for name, meeting in keys.encounters.items()}
    for name, lane in keys.lanes.items():
        means[f"lanes.{name}.per_hour"] = lanes.expected_arrivals(keys, lane, duration)[0]
    means |= {f"leisure.{name}.per_km2": craft_on_average(chart, area) for name, area in keys.leisure.items()}
    most = min(MAX_VESSELS, MAX_SECONDS / duration)
    if sum(means.values()) <= most:
        return []
    key = max(means, key=lambda name: means[name])
    possible = f"at most {most:,.0f} can be planned for {duration:,.0f} s"
    return [f"{key}: means {means[key]:,.0f} vessels, of {sum(means.values()):,.0f} in all; {possible}"]


def _on_land(land: Land, waypoints_m: np.ndarray, width_m: float) -> str:
    """The place at which the middle of a lane leads over what is in the way of every vessel; empty if nowhere."""
    line = shapely.LineString(rounded(waypoints_m, width_m).places_m)
    area = land.below(0.1)
    if not area.intersects(line):
        return ""
    place = shapely.get_coordinates(area.intersection(line))[0]
    return f"[{place[0]:.0f}, {place[1]:.0f}]"


def _draw(chart: Chart) -> Iterator[Craft]:
    for name, meeting in chart.keys.encounters.items():
        yield from draw_encounter(chart, name, meeting)
    for name, lane in chart.keys.lanes.items():
        yield from lanes.draw_lane(chart, name, lane)
    for name, area in chart.keys.leisure.items():
        yield from draw_area(chart, name, area)


@dataclass(frozen=True, eq=False)
class DrawnTraffic(RecordedPoses):
    """The poses of a drive, with what was drawn."""

    craft: tuple[Craft, ...]  # in their order in the scene
    left_out: Mapping[str, int]  # vessels for which there was no room, by section, such as `lanes.north`


class TrafficKeys(SourceKeys, TrafficSections):
    """The section `poses.traffic`; see `TrafficSections` for its keys."""

    def vessels(self, request: PoseRequest) -> dict[str, dict[str, object]]:
        """Entries of the drawn vessels, as in a vessels file."""
        return {craft.name: self._entry(craft) for craft in self._plan(request).craft}

    def build(self, request: PoseRequest) -> DrawnTraffic:
        """The poses of the scene file's vessels and of the drawn ones; a vessel that is neither is always absent."""
        drive = self._plan(request)
        tracks = dict(drive.own) | {craft.name: craft.track for craft in drive.craft}
        steps, interval = request.steps or 0, request.time_step_s or 0.0
        check_pose_count(WHERE, steps, len(request.vessels))
        times_s = np.arange(steps, dtype=np.float64) * interval
        poses = Poses.absent(steps, len(request.vessels))
        for column, vessel in enumerate(request.vessels):
            if (track := tracks.get(vessel.name)) is None:
                continue
            present = track.present(times_s)
            places, headings = track.at(times_s[present])
            poses.present[present, column] = True
            poses.positions_m[present, column, :2] = on_grid(places)
            poses.headings_rad[present, column] = on_grid(headings)
        return DrawnTraffic(generated_timestamps(steps, interval), poses, drive.craft, drive.left_out)

    def _entry(self, craft: Craft) -> dict[str, object]:
        hull, mesh = craft.track.hull, self.kinds[craft.track.hull.kind].mesh
        entry: dict[str, object] = {
            "length_m": hull.length_m,
            "beam_m": hull.beam_m,
            "air_draft_m": hull.air_draft_m,
            "label": self.label(hull.kind),
        }
        return entry if mesh is None else entry | {"mesh": mesh}

    def _plan(self, request: PoseRequest) -> DrivePlan:
        names = [vessel.name for vessel in request.vessels]
        strangers = [name for name in self.own if name not in names]
        problems = [f"own.{name}: no vessel '{name}' in the scene ({nearest(name, names)})" for name in strangers]
        if problems := self.problems() + problems:
            raise refused(problems)
        own = tuple(replace(vessel, solid=shoebox()) for vessel in request.vessels if vessel.name in self.own)
        check_pose_count(WHERE, request.steps or 0, len(request.vessels))
        return plan(self.model_dump_json(), replace(request, names=None, vessels=own))
