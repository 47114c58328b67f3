"""Leisure craft, which wander about in an area: long legs and easy turns, kayaks along the shore."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
import shapely
from shapely.ops import substring

from modsim3d.arrays import Array
from modsim3d.motion.poses.traffic.craft import Chart, Craft, arrivals, kind_of
from modsim3d.motion.poses.traffic.keys import LeisureKeys
from modsim3d.motion.poses.traffic.kinds import Hull
from modsim3d.motion.poses.traffic.paths import Path, corner_radii_m, rounded
from modsim3d.motion.poses.traffic.tracks import Track
from modsim3d.random_streams import Purpose

TRIES, PLACES, COURSES = 40, 60, 14
GOOD_ENOUGH = 0.3
"""Crowding with which a craft is taken at once, and not the best of all tries."""
LEG_RADII, LEG_S = (6.0, 14.0), (40.0, 150.0)
"""Length of a leg: in turning radii, and in seconds; the longer of the two counts."""
TURN_RAD, SHARPEST_TURN_RAD = (0.25, 1.2), 2.3
HEAD_STARTS_S = (0.0, 20.0, 40.0, 60.0)
PACES = (1.0, 0.85, 0.7)
SHORE_M = (12.0, 60.0)
"""How far from the shore a kayak keeps."""


def craft_on_average(chart: Chart, area: LeisureKeys) -> float:
    """Mean number of craft in an area."""
    water = shapely.Polygon(area.polygon_m).difference(chart.waters.land.below(1.0))
    return float(area.per_km2 * water.area / 1e6)


def draw_area(chart: Chart, name: str, area: LeisureKeys) -> Iterator[Craft]:
    """The craft of an area."""
    section = f"leisure.{name}"
    found = arrivals(chart.streams, Purpose.TRAFFIC_ARRIVALS, name, craft_on_average(chart, area))
    for ordinal in range(1, len(found) + 1):
        track = _draw_craft(chart, name, area, ordinal)
        craft = None if track is None else Craft(f"{name}_{ordinal}", section, track)
        yield from chart.accept(craft, section)


def _draw_craft(chart: Chart, name: str, area: LeisureKeys, ordinal: int) -> Track | None:
    best, least, kind = None, math.inf, ""
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_LEISURE, name, str(ordinal), step=attempt)
        if not attempt:
            kind = kind_of(area, rng)
        hull, speed = chart.hull(area, kind, rng)
        water = _water(chart, area, hull)
        path = _course(chart, water, hull, speed, rng)
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


def _water(chart: Chart, area: LeisureKeys, hull: Hull) -> shapely.Geometry:
    """Where the centre of a hull may be."""
    land = chart.waters.land.below(hull.air_draft_m)
    margin = hull.reach_m + chart.keys.clearance_m
    water = shapely.Polygon(area.polygon_m).buffer(-hull.reach_m).difference(land.buffer(margin, quad_segs=4))
    shapely.prepare(water)
    return water


def _course(
    chart: Chart, water: shapely.Geometry, hull: Hull, speed_m_s: float, rng: np.random.Generator
) -> Path | None:
    """A way through the water that is long enough for the drive; None if it leads into a corner."""
    needed = speed_m_s * (chart.waters.end_s + HEAD_STARTS_S[-1] + 2 * chart.waters.interval_s)
    kind = chart.keys.kinds[hull.kind]
    if kind.near_shore:
        path = _along_shore(chart, water, hull, needed, rng)
        if path is not None:
            return path
    start = _somewhere(water, rng)
    if start is None:
        return None
    places, heading, total = [start], rng.random() * 2 * math.pi, 0.0
    radius = hull.turning_radius_m
    legs = [max(radii * radius, seconds * speed_m_s) for radii, seconds in zip(LEG_RADII, LEG_S, strict=True)]
    while total < needed:
        found = _next(water, places[-1], heading, legs, radius, len(places) == 1, rng)
        if found is None:
            return None
        place, heading, leg = found
        places.append(place)
        total += leg - 0.6 * radius  # rounding the corner shortens the way
    return _checked(np.array(places), water, radius)


def _next(
    water: shapely.Geometry,
    place: Array,
    heading: float,
    legs: list[float],
    radius_m: float,
    any_course: bool,
    rng: np.random.Generator,
) -> tuple[Array, float, float] | None:
    """The next waypoint, the course to it and its distance, wholly in the water."""
    for trial in range(COURSES):
        eagerness = trial / (COURSES - 1)
        leg, turn, side = rng.random(3)
        length = max((legs[0] + (legs[1] - legs[0]) * leg) * (1 - 0.6 * eagerness), LEG_RADII[0] * radius_m)
        most = TURN_RAD[1] + (SHARPEST_TURN_RAD - TURN_RAD[1]) * eagerness
        turned = TURN_RAD[0] + (most - TURN_RAD[0]) * turn
        course = 2 * math.pi * side if any_course else heading + math.copysign(turned, side - 0.5)
        end = place + length * np.array([math.cos(course), math.sin(course)])
        if water.contains(shapely.LineString([place, end])):
            return end, course, length
    return None


def _somewhere(water: shapely.Geometry, rng: np.random.Generator) -> Array | None:
    """A place in the water, evenly drawn."""
    if water.is_empty:
        return None
    low_x, low_y, high_x, high_y = water.bounds
    places = np.array([low_x, low_y]) + rng.random((PLACES, 2)) * np.array([high_x - low_x, high_y - low_y])
    inside = np.flatnonzero(shapely.contains_xy(water, places))
    return places[inside[0]] if len(inside) else None


def _along_shore(
    chart: Chart, water: shapely.Geometry, hull: Hull, needed_m: float, rng: np.random.Generator
) -> Path | None:
    """A way at an even distance from the shore; None if there is no shore that is long enough."""
    off, where, at, way = rng.random(4)
    distance = hull.reach_m + chart.keys.clearance_m + SHORE_M[0] + (SHORE_M[1] - SHORE_M[0]) * off
    shore = chart.waters.land.below(1.0).buffer(distance).boundary
    lines = shapely.get_parts(shapely.line_merge(shapely.intersection(shore, water)))
    lines = [line for line in lines if line.length > needed_m * 1.2]
    if not lines:
        return None
    line = lines[int(where * len(lines))].simplify(1.0)
    begin = at * (line.length - needed_m * 1.2)
    part = substring(line, begin, begin + needed_m * 1.2)
    places = shapely.get_coordinates(part)
    return _checked(
        _thinned(places if way < 0.5 else places[::-1], 3 * hull.turning_radius_m), water, hull.turning_radius_m
    )


def _thinned(places: Array, apart_m: float) -> Array:
    """Some of the places, at least a distance apart."""
    kept = [places[0]]
    for place in places[1:]:
        if math.hypot(*(place - kept[-1])) >= apart_m:
            kept.append(place)
    return np.array(kept)


def _checked(waypoints: Array, water: shapely.Geometry, radius_m: float) -> Path | None:
    """The path through waypoints; None if it needs too tight a turn, or leaves the water."""
    if len(waypoints) < 2 or (len(waypoints) > 2 and corner_radii_m(waypoints, radius_m).min() < 0.99 * radius_m):
        return None
    path = rounded(waypoints, radius_m)
    return path if water.contains(shapely.LineString(path.places_m)) else None
