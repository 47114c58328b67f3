"""Paths that vessels follow: waypoints with rounded corners, displaced to a side, and places along them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.ops import substring

from modsim3d.core.arrays import Array
from modsim3d.geometry.camera_poses import heading_of

MAX_POINTS = 20_000
POINTS_A_RADIUS = 30  # on a stretch as long as the turning radius
SHARPEST_RAD = 2.6  # sharpest corner of a route (149°): the circle in a sharper one would lie far from it


@dataclass(frozen=True, eq=False)
class VesselPath:
    """A smooth line as a dense polyline."""

    along_m: Array  # distance from the start of each point: (K,)
    places_m: Array  # the points: (K, 2)
    headings_rad: Array  # tangents at the points, without jumps of a turn: (K,)

    @classmethod
    def through(cls, places_m: Array) -> VesselPath:
        """The path through dense points, shape (K, 2)."""
        steps = np.diff(places_m, axis=0)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        return cls(along, places_m, np.unwrap(heading_of(np.gradient(places_m, axis=0))))

    @property
    def length_m(self) -> float:
        """Length from start to end."""
        return float(self.along_m[-1])

    def at(self, along_m: Array) -> tuple[Array, Array]:
        """Places, shape (..., 2), and headings at distances from the start; straight on beyond both ends."""
        inside = np.clip(along_m, 0.0, self.length_m)
        place = np.stack([np.interp(inside, self.along_m, self.places_m[:, i]) for i in (0, 1)], axis=-1)
        heading = np.interp(inside, self.along_m, self.headings_rad)
        beyond = (along_m - inside)[..., None]
        return place + beyond * np.stack([np.cos(heading), np.sin(heading)], axis=-1), heading

    def displaced(self, to_port_m: Array | float) -> VesselPath:
        """The path at a distance to port, a number or one for each point, shape (K,)."""
        normal = np.stack([-np.sin(self.headings_rad), np.cos(self.headings_rad)], axis=-1)
        return VesselPath.through(self.places_m + normal * np.broadcast_to(to_port_m, self.along_m.shape)[:, None])

    def trimmed(self, margin_m: float) -> VesselPath:
        """The path without a piece at either end; together they are shorter than the path."""
        ends = np.array([margin_m, self.length_m - margin_m])
        inside = (self.along_m > ends[0]) & (self.along_m < ends[1])
        (first, last), turned = self.at(ends)
        headings = np.concatenate([turned[:1], self.headings_rad[inside], turned[1:]])
        along = np.concatenate([[0.0], self.along_m[inside] - margin_m, [ends[1] - margin_m]])
        return VesselPath(along, np.concatenate([first[None], self.places_m[inside], last[None]]), headings)

    def reversed(self) -> VesselPath:
        """Path from its end to its start."""
        return VesselPath(self.length_m - self.along_m[::-1], self.places_m[::-1], self.headings_rad[::-1] + math.pi)


def rounded(waypoints_m: Array, radius_m: float) -> VesselPath:
    """The path through at least two waypoints that differ (k, 2), whose corners are circles of a radius, or of what
    their legs leave room for. Curvature rises and falls over half a radius, as a ship's rate of turn does."""
    legs = np.diff(waypoints_m, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    along = legs / length[:, None]
    pieces = [waypoints_m[:1]]
    for corner, radius in enumerate(corner_radii_m(waypoints_m, radius_m), start=1):
        pieces.append(_arc(waypoints_m[corner], along[corner - 1], along[corner], float(radius)))
    return _evenly(np.concatenate([*pieces, waypoints_m[-1:]]), radius_m)


def turns_rad(waypoints_m: Array) -> Array:
    """Changes of course at the inner waypoints, to port positive, shape (k − 2,)."""
    legs = np.diff(waypoints_m, axis=0)
    cross = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    turns: Array = np.arctan2(cross, (legs[:-1] * legs[1:]).sum(axis=1))
    return turns


def corner_radii_m(waypoints_m: Array, wanted_m: float) -> Array:
    """Radii of the circles in the corners, shape (k − 2,): as wanted, or as large as the legs leave room for."""
    legs = np.diff(waypoints_m, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    room = np.full(len(length), 0.5)
    room[[0, -1]] = 1.0  # the first and the last leg have a corner at one end
    free = length * room
    tangent = np.tan(np.abs(turns_rad(waypoints_m)) / 2)
    most = np.minimum(free[:-1], free[1:]) / np.maximum(tangent, 1e-9)
    radii: Array = np.minimum(most, wanted_m)
    return radii


def _arc(corner: Array, before: Array, after: Array, radius_m: float) -> Array:
    """Points of a circle that touches both legs, directions of shape (2,); the corner itself if it hardly turns."""
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
    if abs(turn) < 1e-4:
        return corner[None]
    tangent = radius_m * math.tan(abs(turn) / 2)
    side = math.copysign(1.0, turn)
    start, inward = corner - tangent * before, side * np.array([-before[1], before[0]])
    angles = np.linspace(0.0, abs(turn), max(3, math.ceil(abs(turn) * POINTS_A_RADIUS)))[:, None]
    return start + radius_m * (np.sin(angles) * before + (1 - np.cos(angles)) * inward)


def _evenly(line: Array, radius_m: float) -> VesselPath:
    """Points at even distances on a line of straight pieces and arcs, smoothed over half a radius."""
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    total = float(along[-1])
    spacing = max(radius_m / POINTS_A_RADIUS, total / MAX_POINTS)
    count = max(math.ceil(total / spacing), 8) + 1
    even = np.linspace(0.0, total, count)
    places = np.stack([np.interp(even, along, line[:, i]) for i in (0, 1)], axis=-1)
    half = min(POINTS_A_RADIUS // 4, (count - 1) // 4)
    return VesselPath.through(_running_mean(places, half))


def _running_mean(places: Array, half: int) -> Array:
    """Mean of each point and `half` points on either side; the line goes on straight beyond its ends."""
    ahead = np.arange(1, half + 1)[:, None]
    start = places[0] - ahead[::-1] * (places[1] - places[0])
    end = places[-1] + ahead * (places[-1] - places[-2])
    total = np.cumsum(np.concatenate([np.zeros((1, 2)), start, places, end]), axis=0)
    width = 2 * half + 1
    mean: Array = (total[width:] - total[:-width]) / width
    return mean


PLACES, COURSES, STEPS_BACK = 60, 14, 30
LEG_RADII, LEG_S = (6.0, 14.0), (45.0, 180.0)  # length of a leg in turning radii and in seconds; the longer one counts
TURN_RAD, SHARPEST_TURN_RAD = (0.25, 1.2), 2.3
CLOSE_HAULED_RAD = math.radians(43)  # least angle between a sailing yacht's course and the wind
SPARE = 1.2  # shore for a way along it, in lengths of the way, since that leaves out its smallest bends


@dataclass(frozen=True, eq=False)
class Wanderer:
    """A craft that wanders."""

    water: shapely.Geometry  # where her centre may be, prepared
    radius_m: float  # of her turns
    speed_m_s: float
    wind_from_rad: float | None  # direction from which the wind blows, if she sails
    rng: np.random.Generator
    # Whether a leg (2, 2) that begins after a distance on her way is clear of others.
    is_clear: Callable[[Array, float], bool] | None = None

    def course(self, needed_m: float) -> VesselPath | None:
        """A way through the water of at least a length; None if there is none from the place drawn."""
        start = self._somewhere()
        if start is None:
            return None
        places, headings, back = [start], [math.nan], 0
        # Rounding the corners shortens the way.
        while (gone := length_m(places) - 0.6 * self.radius_m * (len(places) - 1)) < needed_m:
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

    def along(self, shore: shapely.Geometry, needed_m: float) -> VesselPath | None:
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

    def through(self, waypoints: Array) -> VesselPath | None:
        """The path through waypoints; None if it needs too tight a turn, or leaves the water."""
        room = corner_radii_m(waypoints, self.radius_m) if len(waypoints) > 2 else np.array([np.inf])
        if len(waypoints) < 2 or room.min() < 0.99 * self.radius_m:
            return None
        path = rounded(waypoints, self.radius_m)
        return path if self.water.contains(shapely.LineString(path.places_m)) else None

    def _next(self, place: Array, heading: float, gone_m: float) -> tuple[Array, float] | None:
        """The next waypoint and the course to it, wholly in the water; any course if there is no heading yet."""
        short, long = np.maximum(np.multiply(LEG_RADII, self.radius_m), np.multiply(LEG_S, self.speed_m_s)).tolist()
        for trial in range(COURSES):
            urge = trial / (COURSES - 1)  # she turns sharper, and sooner, if the water ahead is short
            share, turn, side = self.rng.random(3)
            length = max((short + (long - short) * share) * (1 - 0.6 * urge), LEG_RADII[0] * self.radius_m)
            most = TURN_RAD[1] + (SHARPEST_TURN_RAD - TURN_RAD[1]) * urge
            turned = math.copysign(TURN_RAD[0] + (most - TURN_RAD[0]) * turn, side - 0.5)
            course = 2 * math.pi * side if math.isnan(heading) else heading + turned
            end = place + length * np.array([math.cos(course), math.sin(course)])
            if self.wind_from_rad is not None and math.cos(course - self.wind_from_rad) >= math.cos(CLOSE_HAULED_RAD):
                continue
            leg = np.array([place, end])
            if self.water.contains(shapely.LineString(leg)) and (self.is_clear is None or self.is_clear(leg, gone_m)):
                return end, course
        return None

    def _somewhere(self) -> Array | None:
        if self.water.is_empty:
            return None
        west, south, east, north = self.water.bounds
        places = np.array([west, south]) + self.rng.random((PLACES, 2)) * np.array([east - west, north - south])
        inside = np.flatnonzero(shapely.contains_xy(self.water, places))
        return places[inside[0]] if len(inside) else None


def length_m(places: Sequence[ArrayLike]) -> float:
    """Length of the way along some places, shape (2,) each."""
    steps = np.diff(np.array(places), axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _thinned(places: Array, apart_m: float) -> Array:
    kept = [places[0]]
    for place in places[1:]:
        if math.hypot(*(place - kept[-1])) >= apart_m:
            kept.append(place)
    return np.array(kept)
