"""Encounters with own ship: vessels whose closest approach, its time and its kind by COLREG are asked for."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import shapely

from modsim3d.core.arrays import Array
from modsim3d.core.random_streams import Purpose
from modsim3d.world.traffic.keys import EncounterKeys
from modsim3d.world.traffic.lanes import Approach, Chart, Craft, between
from modsim3d.world.traffic.paths import rounded, turns_rad
from modsim3d.world.traffic.tracks import DrawnHull, Track, draw_hull, draw_one

TRIES = 100
KEPT_TRIES = 30  # with the same kind of vessel, closest approach, time and side; only then those are drawn anew too
STRAIGHT_TRIES = 10  # of ways without a bend, which cost less
ABAFT_RAD = math.radians(112.5)  # 22.5° abaft the beam: a vessel from further aft overtakes (COLREG, rule 13)
HEAD_ON_RAD = math.radians(6)
CROSSING_RAD = math.radians(55), math.radians(125)
OVERTAKING_RAD = math.radians(12)
FASTER = 1.15  # least ratio of the speeds when one overtakes the other
EASY = 1.5  # radii of bends in least radii
STEADY_S = 60.0, 40.0  # before and after the closest approach: she goes straight for so long in any case
_BENDS = (0.0, 0.35, -0.35, 0.8, -0.8)
BENDS_RAD = tuple((before, after) for before, after in product(_BENDS, _BENDS) if 0 < abs(before) + abs(after) < 1.2)
"""Alterations before and after that, where land or another vessel is in the way."""
EARLY_S = 3.0  # she is there a little before the drive and after it


@dataclass(frozen=True)
class _Meeting:
    """Request for a meeting: kind of vessel, kind of encounter, closest approach, time, and side of own ship."""

    vessel: str
    kind: str
    closest_m: float
    time_s: float
    side: float


def encounter_problems(chart: Chart, name: str, keys: EncounterKeys) -> list[str]:
    """Reasons why an encounter cannot be with some speed that own ship may draw."""
    met, where = keys.own or next(iter(chart.keys.own)), f"encounters.{name}"
    slowest, fastest = chart.keys.own[met].speed_m_s
    speeds = [chart.keys.speed_range(keys, kind) for kind, weight in keys.kinds.items() if weight > 0]
    least, greatest = min(low for low, _ in speeds), max(high for _, high in speeds)
    problems = []
    if keys.kind == "overtaking" and greatest < fastest * FASTER:
        problems.append(f"{where}.kinds: the fastest makes {greatest:g} m/s, and '{met}' up to {fastest:g} m/s")
    if keys.kind == "overtaken" and least > slowest / FASTER:
        problems.append(f"{where}.kinds: the slowest makes {least:g} m/s, and '{met}' as little as {slowest:g} m/s")
    if problems:
        problems[0] += f": one must be {FASTER:g} times as fast as the other"
    way = chart.own[met].path.length_m
    if way < fastest * keys.time_s[1]:
        gone = f"is at the end of her route after {way / fastest:.0f} s at {fastest:g} m/s"
        problems.append(f"{where}.time_s: '{met}' {gone}")
    beams = chart.own[met].hull.beam_m + min(min(chart.keys.kinds[kind].beam_m) for kind in keys.kinds)
    if keys.closest_m[1] < (near := beams / 2 + chart.keys.clearance_m):
        problems.append(f"{where}.closest_m: the centres of hulls with clearance_m between them are {near:.0f} m apart")
    return problems


def draw_encounter(chart: Chart, name: str, keys: EncounterKeys) -> Iterator[Craft]:
    """The vessels of an encounter."""
    own = keys.own or next(iter(chart.own))
    for ordinal in range(1, keys.count + 1):
        pair = _draw(chart, name, keys, ordinal, chart.own[own])
        if pair is None:
            yield from chart.accept(None, f"encounters.{name}")
            continue
        track, asked = pair
        approach = Approach(asked.kind, own, asked.closest_m, asked.time_s)
        label = name if keys.count == 1 else f"{name}_{ordinal}"
        yield from chart.accept(Craft(label, f"encounters.{name}", track, asked=approach), f"encounters.{name}")


def _draw(chart: Chart, name: str, keys: EncounterKeys, ordinal: int, own: Track) -> tuple[Track, _Meeting] | None:
    asked = None
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_ENCOUNTER, name, str(ordinal), step=attempt)
        if attempt == 0 or attempt >= KEPT_TRIES:
            asked = _meeting(chart, keys, own.speed_m_s, rng)
        if asked is None:
            continue
        speeds = _speeds(chart, keys, asked.vessel, asked.kind, own.speed_m_s)
        if speeds is None or not own.present(np.array([asked.time_s]))[0]:
            return None
        speed = between(speeds, float(rng.random()))
        hull = draw_hull(asked.vessel, chart.keys.kinds[asked.vessel], speed, rng)
        bends = BENDS_RAD if attempt >= STRAIGHT_TRIES else ()
        track = _track(chart, own, hull, speed, asked, bends, rng)
        if track is not None and _is_closest(chart, own, track, asked):
            return track, asked
    return None


def _meeting(chart: Chart, keys: EncounterKeys, own_speed: float, rng: np.random.Generator) -> _Meeting | None:
    """Meeting drawn for the request; None if no kind has a speed for it."""
    vessel, closest, time, side, which = rng.random(5)
    kind = keys.kind
    if kind == "crossing":
        kind = "crossing_from_starboard" if which < 0.5 else "crossing_from_port"
    able = {name: w for name, w in keys.kinds.items() if w > 0 and _speeds(chart, keys, name, kind, own_speed)}
    if not able:
        return None
    return _Meeting(
        vessel=draw_one(able, float(vessel)),
        kind=kind,
        closest_m=between(keys.closest_m, float(closest)),
        time_s=between(keys.time_s, float(time)),
        side=1.0 if side < 0.5 else -1.0,
    )


def _speeds(chart: Chart, keys: EncounterKeys, vessel: str, kind: str, own_speed: float) -> tuple[float, float] | None:
    """Speeds of a kind of vessel with which such a meeting can be; None if there are none."""
    low, high = chart.keys.speed_range(keys, vessel)
    if kind == "overtaking":
        low = max(low, own_speed * FASTER)
    elif kind == "overtaken":
        high = min(high, own_speed / FASTER)
    return (low, high) if low <= high else None


def _track(
    chart: Chart,
    own: Track,
    hull: DrawnHull,
    speed: float,
    asked: _Meeting,
    bends: Sequence[tuple[float, float]],
    rng: np.random.Generator,
) -> Track | None:
    """A track that meets own ship as asked and keeps clear of all others; None if the course drawn does not."""
    (place,), (heading,) = own.at(np.array([asked.time_s]))
    course = heading + _turned(asked.kind, float(rng.random()))
    ahead = _along(course)
    velocity = speed * ahead
    relative = velocity - own.speed_m_s * _along(heading)
    pace = math.hypot(*relative)
    if pace < 0.05 or not _comes_as_asked(asked.kind, -relative, heading, course):
        return None
    abeam = asked.side * np.array([-relative[1], relative[0]]) / pace
    meeting = place + asked.closest_m * abeam
    ways = [_waypoints(chart, hull, speed, meeting, course, asked.time_s, way) for way in ((0.0, 0.0), *bends)]
    land, aside = chart.waters.land.below(hull.air_draft_m), hull.beam_m / 2 + chart.waters.clearance_m
    free = ~shapely.dwithin(shapely.linestrings(np.array(ways)), land, aside)
    if not free.any():
        return None
    straight = _detour(hull, speed, meeting, ahead, asked.time_s, ways[0])
    if free[0] and chart.waters.judge([straight]).track is not None:
        return straight
    steady = asked.time_s - STEADY_S[0], asked.time_s + STEADY_S[1]
    if not free[1:].any() or not chart.waters.is_clear(straight, *steady):
        return None
    bent = [
        _detour(hull, speed, meeting, ahead, asked.time_s, way) for way, free in zip(ways, free, strict=True) if free
    ]
    return chart.waters.judge(bent).track


def _turned(kind: str, share: float) -> float:
    even = 2 * share - 1
    if kind == "head_on":
        return math.pi + HEAD_ON_RAD * even
    if kind in ("overtaking", "overtaken"):
        return OVERTAKING_RAD * even
    across = between(CROSSING_RAD, share)
    return across if kind == "crossing_from_starboard" else -across


def _comes_as_asked(kind: str, from_her: Array, heading: float, course: float) -> bool:
    """Whether the bearings, while they are far apart, make it such an encounter. `from_her` is the direction in which
    she comes closer, from own ship to her."""
    bearing = _wrapped(math.atan2(from_her[1], from_her[0]) - heading)
    aspect = _wrapped(math.atan2(-from_her[1], -from_her[0]) - course)
    if kind == "overtaking":
        return abs(bearing) > ABAFT_RAD
    if kind == "overtaken":
        return abs(aspect) > ABAFT_RAD
    if abs(bearing) > ABAFT_RAD or abs(aspect) > ABAFT_RAD:
        return False
    return kind == "head_on" or (bearing < 0) == (kind == "crossing_from_starboard")


def _waypoints(
    chart: Chart, hull: DrawnHull, speed: float, place: Array, course: float, time_s: float, bends: tuple[float, float]
) -> Array:
    """Waypoints of a way that is straight around a place, and turns by `bends` well before and after, shape (4, 2)."""
    points = []
    for way, bend, steady_s, total_s in (
        (-1.0, bends[0], STEADY_S[0], time_s + EARLY_S),
        (1.0, bends[1], STEADY_S[1], chart.waters.end_s - time_s + EARLY_S),
    ):
        room = EASY * hull.turning_radius_m * (math.tan(abs(bend) / 2) + 0.5)
        straight = speed * steady_s + room
        beyond = max(speed * total_s - straight, room) + (room if bend else 0.0)
        corner = place + way * straight * _along(course)
        points.append((corner, corner + way * beyond * _along(course + way * bend)))
    (corner_0, far_0), (corner_1, far_1) = points
    return np.array([far_0, corner_0, corner_1, far_1])


def _detour(hull: DrawnHull, speed: float, place: Array, ahead: Array, time_s: float, waypoints: Array) -> Track:
    """The track through waypoints that is at a place at a time, on a course given as a direction."""
    path = rounded(waypoints, EASY * hull.turning_radius_m)
    nearest = int(np.argmin(((path.places_m - place) ** 2).sum(axis=1)))
    along = path.along_m[nearest] + float((place - path.places_m[nearest]) @ ahead)
    return Track(hull, path, speed, time_s - along / speed, round(float(np.abs(turns_rad(waypoints)).sum()), 6))


def _is_closest(chart: Chart, own: Track, track: Track, asked: _Meeting) -> bool:
    """Whether she comes no closer to own ship at any other time."""
    times = np.append(chart.waters.times_s, asked.time_s)
    times = times[own.present(times) & track.present(times)]
    apart = np.hypot(*(own.at(times)[0] - track.at(times)[0]).T)
    return bool(apart.min() >= asked.closest_m - 1e-3)


def _along(angle: float) -> Array:
    return np.array([math.cos(angle), math.sin(angle)])


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi
