"""Courses of leisure craft through open water: long legs and easy turns, or along the shore."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.ops import substring

from modsim3d.arrays import Array
from modsim3d.motion.poses.traffic.paths import Path, corner_radii_m, rounded

PLACES, COURSES, STEPS_BACK = 60, 14, 30
LEG_RADII, LEG_S = (6.0, 14.0), (45.0, 180.0)
"""Length of a leg: in turning radii, and in seconds; the longer of the two counts."""
TURN_RAD, SHARPEST_TURN_RAD = (0.25, 1.2), 2.3
CLOSE_HAULED_RAD = math.radians(43)
"""Least angle between a sailing yacht's course and the wind."""
SPARE = 1.2
"""Length of shore for a way along it, in lengths of the way, since that leaves out its smallest bends."""


@dataclass(frozen=True, eq=False)
class Wanderer:
    """A craft that wanders.

    Attributes:
        water: Where her centre may be, prepared.
        radius_m: Radius of her turns.
        speed_m_s: Her speed.
        wind_from_rad: Direction from which the wind blows, if she sails.
        rng: What her courses are drawn with.
        is_clear: Whether a leg, shape (2, 2), that begins after a distance on her way is clear of others
    """

    water: shapely.Geometry
    radius_m: float
    speed_m_s: float
    wind_from_rad: float | None
    rng: np.random.Generator
    is_clear: Callable[[Array, float], bool] | None = None

    def course(self, needed_m: float) -> Path | None:
        """A way through the water of at least a length; None if there is none from the place drawn."""
        start = self._somewhere()
        if start is None:
            return None
        places, headings, back = [start], [math.nan], 0
        # Rounding the corners shortens the way.
        while (gone := _length_m(places) - 0.6 * self.radius_m * (len(places) - 1)) < needed_m:
            leg = self._next(places[-1], headings[-1], gone)
            if leg is not None:
                places.append(leg[0])
                headings.append(leg[1])
            elif len(places) > 1 and back < STEPS_BACK:
                back += 1
                places.pop()
                headings.pop()
            else:
                return None
        return self.through(np.array(places))

    def along(self, shore: shapely.Geometry, needed_m: float) -> Path | None:
        """A way along some line, such as one at an even distance from the shore; None if no line is long enough."""
        where, at, way = self.rng.random(3)
        lines = shapely.get_parts(shapely.line_merge(shapely.intersection(shore, self.water)))
        lines = [line for line in lines if line.length > needed_m * SPARE]
        if not lines:
            return None
        line = lines[int(where * len(lines))]
        begin = at * (line.length - needed_m * SPARE)
        places = shapely.get_coordinates(substring(line, begin, begin + needed_m * SPARE).simplify(1.0))
        return self.through(_thinned(places if way < 0.5 else places[::-1], 3 * self.radius_m))

    def through(self, waypoints: Array) -> Path | None:
        """The path through waypoints; None if it needs too tight a turn, or leaves the water."""
        room = corner_radii_m(waypoints, self.radius_m) if len(waypoints) > 2 else np.array([np.inf])
        if len(waypoints) < 2 or room.min() < 0.99 * self.radius_m:
            return None
        path = rounded(waypoints, self.radius_m)
        return path if self.water.contains(shapely.LineString(path.places_m)) else None

    def _next(self, place: Array, heading: float, gone_m: float) -> tuple[Array, float] | None:
        """The next waypoint and the course to it, wholly in the water; any course if there is no heading yet."""
        short, long = (
            max(radii * self.radius_m, time_s * self.speed_m_s) for radii, time_s in zip(LEG_RADII, LEG_S, strict=True)
        )
        for trial in range(COURSES):
            urge = trial / (COURSES - 1)  # she turns sharper, and sooner, if the water ahead is short
            leg, turn, side = self.rng.random(3)
            length = max((short + (long - short) * leg) * (1 - 0.6 * urge), LEG_RADII[0] * self.radius_m)
            most = TURN_RAD[1] + (SHARPEST_TURN_RAD - TURN_RAD[1]) * urge
            turned = math.copysign(TURN_RAD[0] + (most - TURN_RAD[0]) * turn, side - 0.5)
            course = 2 * math.pi * side if math.isnan(heading) else heading + turned
            end = place + length * np.array([math.cos(course), math.sin(course)])
            if self._can_sail(course) and self._is_free(np.array([place, end]), gone_m):
                return end, course
        return None

    def _is_free(self, leg: Array, gone_m: float) -> bool:
        in_water = self.water.contains(shapely.LineString(leg))
        return bool(in_water and (self.is_clear is None or self.is_clear(leg, gone_m)))

    def _can_sail(self, course: float) -> bool:
        return self.wind_from_rad is None or math.cos(course - self.wind_from_rad) < math.cos(CLOSE_HAULED_RAD)

    def _somewhere(self) -> Array | None:
        """A place in the water, evenly drawn."""
        if self.water.is_empty:
            return None
        west, south, east, north = self.water.bounds
        places = np.array([west, south]) + self.rng.random((PLACES, 2)) * np.array([east - west, north - south])
        inside = np.flatnonzero(shapely.contains_xy(self.water, places))
        return places[inside[0]] if len(inside) else None


def _length_m(places: list[Array]) -> float:
    steps = np.diff(np.array(places), axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _thinned(places: Array, apart_m: float) -> Array:
    """Some of the places, at least a distance apart."""
    kept = [places[0]]
    for place in places[1:]:
        if math.hypot(*(place - kept[-1])) >= apart_m:
            kept.append(place)
    return np.array(kept)
