"""Vessels that pass through lanes: they arrive at random, keep to starboard, and make way for those before them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from modsim3d.core.random_streams import Purpose, Streams, on_grid
from modsim3d.world.traffic.clearance import Waters
from modsim3d.world.traffic.keys import Drawn, LaneKeys, TrafficSections
from modsim3d.world.traffic.paths import VesselPath, corner_radii_m, length_m, rounded
from modsim3d.world.traffic.tracks import SPREAD, DrawnHull, Track, draw_hull, draw_one, turning_radius_m


@dataclass(frozen=True)
class Approach:
    """The closest approach to own ship that an encounter was drawn with: kind, distance of the centres, and time."""

    kind: str
    own: str
    closest_m: float
    time_s: float


@dataclass(frozen=True)
class Craft:
    """A drawn vessel."""

    name: str  # her ID in the scene
    section: str  # that drew her, such as `lanes.north`
    track: Track
    outbound: bool = True  # whether she follows a lane from its first waypoint to its last
    asked: Approach | None = None  # of an encounter


@dataclass(eq=False)
class Chart:
    """Surroundings that vessels are drawn in: the keys, the seed's streams, and the waters with those there already.
    `own` has the tracks of the vessels of the scene file; `left_out` counts those without room by section."""

    keys: TrafficSections
    streams: Streams
    waters: Waters
    own: dict[str, Track]
    left_out: dict[str, int] = field(default_factory=dict)

    def hull(self, section: Drawn, kind: str, rng: np.random.Generator) -> tuple[DrawnHull, float]:
        """A hull of a kind, and her speed."""
        speed = between(self.keys.speed_range(section, kind), float(rng.random()))
        return draw_hull(kind, self.keys.kinds[kind], speed, rng), speed

    def accept(self, craft: Craft | None, section: str) -> Iterator[Craft]:
        """Enter a craft into the waters, or count that there is none."""
        if craft is None:
            self.left_out[section] = self.left_out.get(section, 0) + 1
            return
        self.waters.add(craft.track)
        yield craft


def between(limits: tuple[float, float], share: float) -> float:
    """A number in a range."""
    return limits[0] + (limits[1] - limits[0]) * share


def kind_of(section: Drawn, rng: np.random.Generator) -> str:
    """A kind by the weights of a section."""
    return draw_one(section.kinds, float(rng.random()))


def arrivals(streams: Streams, name: str, mean: float) -> Sequence[float]:
    """Places of the points of a section's Poisson process of rate 1 in [0, mean), rising."""
    rng = streams.generator(Purpose.TRAFFIC_ARRIVALS, name, step=0)
    places: list[float] = []
    place = 0.0
    while True:
        place += float(on_grid(-np.log1p(-rng.random(1)))[0])
        if place >= mean:
            return places
        places.append(place)


TRIES = 6
EASY = 2.0  # radii of turns in least radii, where the legs leave room: ships do not turn as tightly as they can
DELAYS_S = tuple(sign * delay for delay in (10.0, 20.0, 40.0, 60.0, 90.0, 120.0, 180.0, 240.0) for sign in (-1, 1))
LENGTHS = 3.0  # least length of a lane in those of a vessel, who is wholly in it from her first moment to her last
LONGER = 1.2  # ways on the outer side of turns are longer than the middle of the lane, by no more than this factor
SOON_S = 60.0  # delays up to this are tried first
SEEN, STRICT_TRIES = 0.7, 4
"""A changed track must be in the drive for this share of the time of the drawn one, or a vessel would make way by not
being there; the last tries may be in it for less, but must be in it."""
PACES = (0.8, 0.9, 1.1)
SHIFTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # places across the lane, as shares of the width that the hull may use
SIDESTEPS_M = (50.0, 100.0, 200.0, 350.0)
STEEPEST = 0.6  # greatest slope of a sidestep against the lane: an alteration of 31°
SECONDS_A_COST, LANE_A_COST, PACE_A_COST, SIDESTEP_COST, METRES_A_COST = 60.0, 1.0, 5.0, 1.0, 200.0


@dataclass(frozen=True, eq=False)
class _Vessel:
    """Vessel drawn in a lane; `across` is her place in the usable width, port first."""

    hull: DrawnHull
    way: VesselPath
    width: tuple[float, float]
    across: float
    speed_m_s: float
    speeds_m_s: tuple[float, float]
    start_s: float

    def track(self, delay_s: float = 0.0, across: float | None = None, pace: float = 1.0) -> Track:
        """Her track with changes: a delay, another place across the lane, another speed."""
        place = self.across if across is None else across
        cost = abs(delay_s) / SECONDS_A_COST + LANE_A_COST * abs(place - self.across) + PACE_A_COST * abs(pace - 1)
        path = self.way.displaced(-between(self.width, place)).trimmed(self.hull.length_m / 2)
        return Track(self.hull, path, self.speed_m_s * pace, self.start_s + delay_s, cost)

    def sidestep(self, track: Track, aside_m: float, middle_m: float) -> Track | None:
        """The track with an alteration to starboard around a place, and back; None if it needs too tight a turn."""
        ramp = max(math.pi * aside_m / (2 * STEEPEST), math.pi * math.sqrt(self.hull.turning_radius_m * aside_m))
        off = np.abs(track.path.along_m - middle_m) / ramp
        if middle_m < ramp or middle_m > track.path.length_m - ramp:
            return None  # she would enter or leave outside the lane
        path = track.path.displaced(-aside_m * (1 + np.cos(math.pi * np.minimum(off, 1.0))) / 2)
        bend = np.abs(np.diff(path.headings_rad)) / np.diff(path.along_m)
        if 1 / max(float(bend.max()), 1e-9) < self.hull.turning_radius_m:
            return None
        return replace(track, path=path, cost=track.cost + SIDESTEP_COST + aside_m / METRES_A_COST)


def lane_problems(keys: TrafficSections, name: str, lane: LaneKeys) -> list[str]:
    """Reasons why vessels of a kind cannot pass through a lane: no room to turn, or too narrow."""
    waypoints, long_m, problems = np.array(lane.waypoints_m), length_m(lane.waypoints_m), []
    room = corner_radii_m(waypoints, np.inf) - lane.width_m / 2
    for kind in (kind for kind, weight in lane.kinds.items() if weight > 0):
        entry = keys.kinds[kind]
        needed = turning_radius_m(entry.turning_lengths, entry.length_m[2], keys.speed_range(lane, kind)[1])
        beam = max(entry.beam_m) * (1 + SPREAD)
        least = 2 * beam + keys.clearance_m if lane.both_ways else beam
        if lane.width_m < least:
            problems.append(f"lanes.{name}.width_m: {kind} with a beam of {beam:.0f} m needs {least:.0f} m here")
        if long_m < LENGTHS * entry.length_m[2]:
            needed_m = f"at least {LENGTHS:g} lengths of a {kind}, {LENGTHS * entry.length_m[2]:.0f} m, are needed"
            problems.append(f"lanes.{name}.waypoints_m: the lane is {long_m:.0f} m long: {needed_m}")
        tight = np.flatnonzero(room < needed)
        if len(tight):
            turns, free = f"{kind} turns on a radius of {needed:.0f} m", f"{max(room[tight[0]], 0):.0f} m"
            remedy = f"the legs leave room for {free}: use longer legs, a smaller change of course, or another kind"
            problems.append(f"lanes.{name}.waypoints_m[{tight[0] + 1}]: {turns}, and {remedy}")
    return problems


def expected_arrivals(keys: TrafficSections, lane: LaneKeys, duration_s: float) -> tuple[float, float]:
    """Mean number of vessels of a lane, and the time before 0 at which the first ones come."""
    slowest = min(keys.speed_range(lane, kind)[0] for kind, weight in lane.kinds.items() if weight > 0)
    before_s = length_m(lane.waypoints_m) / slowest * LONGER
    return lane.per_hour / 3600 * (before_s + duration_s), before_s


def draw_lane(chart: Chart, name: str, lane: LaneKeys) -> Iterator[Craft]:
    """The vessels of a lane that are in it at some time of the drive, in the order in which they come."""
    mean, before_s = expected_arrivals(chart.keys, lane, chart.waters.end_s)
    for ordinal, place in enumerate(arrivals(chart.streams, name, mean), start=1):
        yield from _draw_vessel(chart, name, lane, ordinal, place / lane.per_hour * 3600 - before_s)


def _draw_vessel(chart: Chart, name: str, lane: LaneKeys, ordinal: int, start_s: float) -> Iterator[Craft]:
    kind, outbound, section = "", True, f"lanes.{name}"
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_LANE, name, str(ordinal), step=attempt)
        if not attempt:  # a vessel that does not fit is drawn anew, but not as one that fits more easily
            kind, outbound = kind_of(lane, rng), not lane.both_ways or bool(rng.random() < 0.5)
        drawn = _draw(chart, lane, kind, outbound, start_s, rng)
        first = drawn.track()
        if not attempt and _seen_s(first, chart) < 0:
            return
        least_s = _seen_s(first, chart) * (SEEN if attempt < STRICT_TRIES else 0.0)
        track = chart.waters.best(first, partial(_seen_changes, chart, drawn, least_s))
        if track is not None:
            yield from chart.accept(Craft(f"{name}_{ordinal}", section, track, outbound), section)
            return
    yield from chart.accept(None, section)


def _seen_s(track: Track, chart: Chart) -> float:
    """Time for which a vessel is in the drive; negative if she is not."""
    return min(track.end_s, chart.waters.end_s) - max(track.start_s, 0.0)


def _seen_changes(chart: Chart, drawn: _Vessel, least_s: float, conflict_s: float | None) -> Iterator[Sequence[Track]]:
    for tracks in _changes(drawn, conflict_s):
        if seen := [track for track in tracks if _seen_s(track, chart) >= least_s]:
            yield seen


def _draw(chart: Chart, lane: LaneKeys, kind: str, outbound: bool, start_s: float, rng: np.random.Generator) -> _Vessel:
    hull, speed = chart.hull(lane, kind, rng)
    way = rounded(np.array(lane.waypoints_m), EASY * hull.turning_radius_m + lane.width_m / 2)
    starboard = (lane.width_m - hull.beam_m) / 2
    port = (hull.beam_m + chart.keys.clearance_m) / 2 if lane.both_ways else -starboard
    return _Vessel(
        hull=hull,
        way=way if outbound else way.reversed(),
        width=(port, max(starboard, port)),
        across=float(rng.random(2).mean()),
        speed_m_s=speed,
        speeds_m_s=chart.keys.speed_range(lane, kind),
        start_s=start_s,
    )


def _changes(drawn: _Vessel, conflict_s: float | None) -> Iterator[Sequence[Track]]:
    """All changed tracks: another time, another place across the lane, another speed, an alteration to starboard."""
    first = drawn.track()
    across = [drawn.track(across=place) for place in SHIFTS]
    yield [*across, *(_later(first, delay) for delay in DELAYS_S if abs(delay) <= SOON_S)]
    low, high = drawn.speeds_m_s
    paces = [drawn.track(pace=pace) for pace in PACES if low <= drawn.speed_m_s * pace <= high]
    aside = [] if conflict_s is None else _sidesteps(drawn, first, (conflict_s - first.start_s) * first.speed_m_s)
    yield [_later(track, delay) for track, delay in product([first, *across, *paces, *aside], (0.0, *DELAYS_S))]


def _sidesteps(drawn: _Vessel, track: Track, conflict_m: float) -> list[Track]:
    tracks = [
        drawn.sidestep(track, aside, conflict_m + 2 * aside * ahead)
        for aside, ahead in product(SIDESTEPS_M, (-1.0, 0.0, 1.0))
    ]
    return [track for track in tracks if track is not None]


def _later(track: Track, delay_s: float) -> Track:
    return replace(track, start_s=track.start_s + delay_s, cost=track.cost + abs(delay_s) / SECONDS_A_COST)
