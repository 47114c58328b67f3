"""What the drawn traffic of one seed is like, measured from its poses and held against what its section asks for."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from benchmarks.hull_distances import least_hull_distance
from modsim3d.core.arrays import Array
from modsim3d.geometry.kinematics import HullTracks, closest_approach
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.world.encounters import Encounter, encounter, hull_tracks, inside, lane_offsets, speeds_m_s
from modsim3d.world.poses.registry import read_source
from modsim3d.world.traffic.generate import DrawnTraffic, TrafficKeys
from modsim3d.world.traffic.keys import LaneKeys
from modsim3d.world.traffic.lanes import Craft

SPEED_TOLERANCE = 0.02
"""A vessel's speed may leave its range by this share: a step is the chord of a turn."""
CLOSEST_TOLERANCE_M, TIME_TOLERANCE_S = 0.5, 1.0
LOOKED_AT_BEFORE_S = 600.0
"""Bearings tell the kind of an encounter while the two are far apart: so long before the closest approach, on the
courses and speeds that they have there. Whoever overtakes does so until past and clear (rule 13 d)."""
CORNER_M = 700.0
"""Corners of lanes are rounded by less than this: a line through the waypoints tells no offset there."""
KINDS = {
    "head_on": Encounter.HEAD_ON,
    "crossing_from_starboard": Encounter.GIVES_WAY,
    "crossing_from_port": Encounter.STANDS_ON,
    "overtaking": Encounter.OVERTAKEN,
    "overtaken": Encounter.OVERTAKING,
}
"""What own ship is in an encounter of each kind."""


@dataclass(frozen=True)
class Drawn:
    """A scene of one seed, and what the measures need of it."""

    scene: Scene
    keys: TrafficKeys
    tracks: HullTracks
    craft: tuple[Craft, ...]

    @classmethod
    def of_seed(cls, scene_name: str, seed: int) -> Drawn:
        scene = load_scene(scene_name, seed=seed)
        keys = read_source(scene.copy.document["poses"], scene.title).keys
        if not (isinstance(keys, TrafficKeys) and isinstance(scene.poses, DrawnTraffic)):
            raise SystemExit(f"{scene_name} has no drawn traffic")
        return cls(scene, keys, hull_tracks(scene.vessels, scene.poses, scene.steps), scene.poses.craft)

    def column(self, craft: Craft) -> int:
        return self.scene.vessel_names.index(craft.name)

    @property
    def left_out(self) -> dict[str, int]:
        return dict(self.scene.poses.left_out) if isinstance(self.scene.poses, DrawnTraffic) else {}


def look_at(scene_name: str, seed: int) -> dict[str, Any]:
    """Draw the traffic of a seed and measure it."""
    return measure(Drawn.of_seed(scene_name, seed), seed)


def measure(drawn: Drawn, seed: int) -> dict[str, Any]:
    """What is measured of one seed: requirements that are broken, counts for the tests, and the least distances."""
    hulls, land = nearest_hulls_m(drawn.tracks), nearest_land_m(drawn)
    faults = [*speed_faults(drawn), *lane_faults(drawn), *area_faults(drawn)]
    meetings = [meeting(drawn, craft) for craft in drawn.craft if craft.asked]
    faults += [fault for found in meetings for fault in found.pop("faults")]
    clearance = drawn.keys.clearance_m
    faults += [f"hulls come to {hulls:.2f} m"] if hulls < clearance - 0.05 else []
    faults += [f"a hull comes to {land:.2f} m of land"] if land < clearance - 0.5 else []
    return {
        "seed": seed,
        "vessels": len(drawn.scene.vessels),
        "left_out": drawn.left_out,
        "least_hull_distance_m": round(hulls, 2),
        "least_land_distance_m": round(land, 2),
        "faults": faults,
        "lanes": {name: lane_counts(drawn, name, lane) for name, lane in drawn.keys.lanes.items()},
        "leisure": {name: sum(c.section == f"leisure.{name}" for c in drawn.craft) for name in drawn.keys.leisure},
        "encounters": meetings,
        "poses": hashlib.sha256(drawn.tracks.centres_m.tobytes()).hexdigest()[:16],
    }


def nearest_hulls_m(tracks: HullTracks) -> float:
    """Least distance of any two hulls at any time; pairs whose centres stay farther apart than that are left out."""
    count, best = tracks.centres_m.shape[1], np.inf
    reach = np.hypot(*tracks.half_sizes_m.T)
    moved = np.nanmax(np.nan_to_num(np.hypot(*np.moveaxis(np.diff(tracks.centres_m, axis=0), -1, 0))), initial=0.0)
    bounds = []
    for one in range(count):
        apart = np.hypot(*np.moveaxis(tracks.centres_m - tracks.centres_m[:, one, None], -1, 0))
        least = np.where(np.isnan(apart), np.inf, apart).min(axis=0) - reach - reach[one] - moved
        bounds += [(float(least[other]), one, other) for other in range(one)]
    for bound, one, other in sorted(bounds):
        if bound >= best:
            break
        best = min(best, least_hull_distance(tracks, one, other)[0])
    return float(best)


def nearest_land_m(drawn: Drawn) -> float:
    """Least distance of any hull from what stands in its way, at the steps."""
    tracks, best = drawn.tracks, np.inf
    parts = [
        (v[:, 2].min(), shapely.MultiPoint(v[:, :2]).convex_hull) for o in drawn.scene.obstacles for _, v in o.solids
    ]
    for column, vessel in enumerate(drawn.scene.vessels):
        land = shapely.union_all([part for base, part in parts if base < vessel.air_draft_m])
        there = np.isfinite(tracks.headings_rad[:, column])
        heading, (length, beam) = tracks.headings_rad[there, column], tracks.half_sizes_m[column]
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        centre = tracks.centres_m[there, column]
        corners = [centre + x * length * ahead + y * beam * across for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        if there.any():
            best = min(best, float(shapely.distance(shapely.polygons(np.stack(corners, axis=1)), land).min()))
    return best


def speed_faults(drawn: Drawn) -> Iterator[str]:
    """Vessels whose speed leaves the range of their kind."""
    speeds, sections = speeds_m_s(drawn.tracks), drawn.keys.drawing
    for craft in drawn.craft:
        low, high = drawn.keys.speed_range(sections[craft.section], craft.track.hull.kind)
        found = speeds[:, drawn.column(craft)]
        found = found[np.isfinite(found)]
        if len(found) and not (
            low * (1 - SPEED_TOLERANCE) <= found.min() and found.max() <= high * (1 + SPEED_TOLERANCE)
        ):
            yield f"{craft.name}: {found.min():.2f} to {found.max():.2f} m/s, asked for {low} to {high}"


def lane_faults(drawn: Drawn) -> Iterator[str]:
    """Vessels of a lane that come onto its port half, or leave it by that side."""
    for craft, lane in _of_lanes(drawn):
        _, starboard = _in_lane(drawn, craft, lane)
        least = drawn.tracks.half_sizes_m[drawn.column(craft), 1] if lane.both_ways else -lane.width_m / 2
        if len(starboard) and starboard.min() < least - 0.5:
            yield f"{craft.name}: comes to {starboard.min():.1f} m to starboard of the middle of her lane"


def area_faults(drawn: Drawn) -> Iterator[str]:
    """Leisure craft that leave their area."""
    for craft in drawn.craft:
        group, _, name = craft.section.partition(".")
        if group == "leisure":
            places = drawn.tracks.centres_m[:, drawn.column(craft)]
            corners = np.array(drawn.keys.leisure[name].polygon_m, dtype=np.float64)
            outside = int((np.isfinite(places[:, 0]) & ~inside(corners, places)).sum())
            if outside:
                yield f"{craft.name}: is outside her area at {outside} steps"


def _of_lanes(drawn: Drawn) -> Iterator[tuple[Craft, LaneKeys]]:
    for craft in drawn.craft:
        group, _, name = craft.section.partition(".")
        if group == "lanes":
            yield craft, drawn.keys.lanes[name]


def _in_lane(drawn: Drawn, craft: Craft, lane: LaneKeys) -> tuple[Array, Array]:
    """How far along her lane a vessel is, and how far to starboard of its middle, in metres; not at corners."""
    places = drawn.tracks.centres_m[:, drawn.column(craft)]
    places = places[np.isfinite(places[:, 0])]
    waypoints = np.array(lane.waypoints_m if craft.outbound else lane.waypoints_m[::-1], dtype=np.float64)
    along, starboard = lane_offsets(waypoints, places)
    corners = np.cumsum(np.hypot(*np.diff(waypoints, axis=0).T))[:-1]
    straight = (np.abs(along[:, None] - corners) > CORNER_M).all(axis=1)
    return along[straight], starboard[straight]


def lane_counts(drawn: Drawn, name: str, lane: LaneKeys) -> dict[str, Any]:
    """How many vessels are in a lane at the start, and how many enter it, by kind and direction; steps outside it."""
    own = [craft for craft, keys in _of_lanes(drawn) if keys is lane]
    there = np.isfinite(drawn.tracks.headings_rad)
    entering = [craft for craft in own if not there[0, drawn.column(craft)] and there[:, drawn.column(craft)].any()]
    offsets = [_in_lane(drawn, craft, lane)[1] for craft in own]
    beyond = [(np.abs(found) > lane.width_m / 2).sum() for found in offsets]
    ranges = [drawn.keys.speed_range(lane, craft.track.hull.kind) for craft in entering]
    return {
        "at_start": sum(bool(there[0, drawn.column(craft)]) for craft in own),
        "entering": len(entering),
        "outbound": sum(craft.outbound for craft in entering),
        "kinds": dict(Counter(craft.track.hull.kind for craft in entering)),
        "fast": sum(c.track.speed_m_s > sum(both) / 2 for c, both in zip(entering, ranges, strict=True)),
        "steps": int(sum(map(len, offsets))),
        "steps_outside": int(sum(beyond)),
    }


def meeting(drawn: Drawn, craft: Craft) -> dict[str, Any]:
    """What was asked of an encounter, and what came of it."""
    asked, tracks = craft.asked, drawn.tracks
    if asked is None:
        raise ValueError(craft.name)
    own, other = drawn.scene.vessel_names.index(asked.own), drawn.column(craft)
    distance, when = closest_approach(tracks.times_s, tracks.centres_m[:, own], tracks.centres_m[:, other])
    keys = drawn.keys.encounters[craft.section.partition(".")[2]]
    step = min(int(np.searchsorted(tracks.times_s, asked.time_s)), len(tracks.times_s) - 2)
    places, headings = tracks.centres_m[step], tracks.headings_rad[step]
    moved = (tracks.centres_m[step + 1] - places) / (tracks.times_s[step + 1] - tracks.times_s[step])
    before = places - LOOKED_AT_BEFORE_S * moved
    kind = encounter(before[own], headings[own], before[other], headings[other])
    faults = []
    if not abs(distance - asked.closest_m) <= CLOSEST_TOLERANCE_M or not abs(when - asked.time_s) <= TIME_TOLERANCE_S:
        wanted = f"{asked.closest_m:.1f} m at {asked.time_s:.1f} s"
        faults.append(f"{craft.name}: {distance:.1f} m at {when:.1f} s, drawn as {wanted}")
    if kind is not KINDS[asked.kind]:
        faults.append(f"{craft.name}: {kind.name} by bearings, drawn as {asked.kind}")
    for value, (low, high), what in ((asked.closest_m, keys.closest_m, "m"), (asked.time_s, keys.time_s, "s")):
        if not low <= value <= high:
            faults.append(f"{craft.name}: {value:.1f} {what} is not in [{low}, {high}]")
    return {
        "section": craft.section,
        "kind": asked.kind,
        "far": asked.closest_m > sum(keys.closest_m) / 2,
        "late": asked.time_s > sum(keys.time_s) / 2,
        "from_starboard": asked.kind == "crossing_from_starboard" if keys.kind == "crossing" else None,
        "closest_error_m": round(abs(distance - asked.closest_m), 3),
        "time_error_s": round(abs(when - asked.time_s), 3),
        "faults": faults,
    }
