"""Vessels that pass through lanes: they arrive at random, keep to starboard, and make way for those before them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.poses.traffic.craft import Chart, Craft, arrivals, between, greatest_radius_m, kind_of
from modsim3d.motion.poses.traffic.keys import LaneKeys, TrafficSections
from modsim3d.motion.poses.traffic.kinds import SPREAD, Hull
from modsim3d.motion.poses.traffic.paths import Path, corner_radii_m, rounded
from modsim3d.motion.poses.traffic.tracks import Track
from modsim3d.random_streams import Purpose

TRIES = 6
EASY = 2.0
"""Radii of turns in least radii, where the legs leave room: ships do not turn as tightly as they can."""
DELAYS_S = (-240.0, -120.0, -60.0, -30.0, -15.0, 0.0, 15.0, 30.0, 60.0, 120.0, 240.0)
SOON_S = 60.0
"""Delays up to this are tried first."""
PACES = (0.8, 0.9, 1.1)
SHIFTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Places across the lane, as shares of the width that the hull may use."""
SIDESTEPS_M = (50.0, 100.0, 200.0, 350.0)
STEEPEST = 0.6
"""Greatest slope of a sidestep against the lane: an alteration of 31°."""
SECONDS_A_COST, LANE_A_COST, PACE_A_COST, SIDESTEP_COST, METRES_A_COST = 60.0, 1.0, 5.0, 1.0, 200.0


@dataclass(frozen=True, eq=False)
class _Drawn:
    """What was drawn of a vessel in a lane; `across` is her place in the usable width, port first."""

    hull: Hull
    way: Path
    width: tuple[float, float]
    across: float
    speed_m_s: float
    speeds_m_s: tuple[float, float]
    start_s: float

    def track(self, delay_s: float = 0.0, across: float | None = None, pace: float = 1.0) -> Track:
        """Her track with changes: a delay, another place across the lane, another speed."""
        place = self.across if across is None else across
        cost = abs(delay_s) / SECONDS_A_COST + LANE_A_COST * abs(place - self.across) + PACE_A_COST * abs(pace - 1)
        path = self.way.displaced(-between(self.width, place))
        return Track(self.hull, path, self.speed_m_s * pace, self.start_s + delay_s, cost)

    def sidestep(self, track: Track, aside_m: float, middle_m: float) -> Track | None:
        """The track with an alteration to starboard around a place, and back; None if it needs too tight a turn."""
        ramp = max(math.pi * aside_m / (2 * STEEPEST), math.pi * math.sqrt(self.hull.turning_radius_m * aside_m))
        off = np.abs(track.path.along_m - middle_m) / ramp
        if middle_m < ramp or middle_m > track.path.length_m - ramp:
            return None  # she would enter or leave outside the lane
        path = track.path.displaced(-aside_m * (1 + np.cos(math.pi * np.minimum(off, 1.0))) / 2)
        if _tightest_m(path) < self.hull.turning_radius_m:
            return None
        return replace(track, path=path, cost=track.cost + SIDESTEP_COST + aside_m / METRES_A_COST)


def lane_problems(keys: TrafficSections, name: str, lane: LaneKeys) -> list[str]:
    """Why vessels of a kind cannot pass through a lane: no room to turn, or too narrow."""
    waypoints, problems = np.array(lane.waypoints_m), []
    room = corner_radii_m(waypoints, np.inf) - lane.width_m / 2
    for kind in (kind for kind, weight in lane.kinds.items() if weight > 0):
        entry, needed = keys.kinds[kind], greatest_radius_m(keys, lane, kind)
        beam = max(entry.beam_m) * (1 + SPREAD)
        least = 2 * beam + keys.clearance_m if lane.both_ways else beam
        if lane.width_m < least:
            problems.append(f"lanes.{name}.width_m: {kind} with a beam of {beam:.0f} m needs {least:.0f} m here")
        tight = np.flatnonzero(room < needed)
        if len(tight):
            problems.append(
                f"lanes.{name}.waypoints_m[{tight[0] + 1}]: {kind} turns on a radius of {needed:.0f} m, and the legs "
                f"leave room for {max(room[tight[0]], 0):.0f} m: use longer legs, a smaller change of course, or "
                "another kind"
            )
    return problems


def expected_arrivals(keys: TrafficSections, lane: LaneKeys, duration_s: float) -> tuple[float, float]:
    """Mean number of vessels of a lane, and the time before 0 at which the first ones come."""
    legs = np.diff(np.array(lane.waypoints_m), axis=0)
    slowest = min(keys.speed_range(lane, kind)[0] for kind, weight in lane.kinds.items() if weight > 0)
    before_s = float(np.hypot(legs[:, 0], legs[:, 1]).sum()) / (slowest * min(PACES)) + DELAYS_S[-1]
    return lane.per_hour / 3600 * (before_s + duration_s + DELAYS_S[-1]), before_s


def draw_lane(chart: Chart, name: str, lane: LaneKeys) -> Iterator[Craft]:
    """The vessels of a lane that are in it at some time of the drive, in the order in which they come."""
    mean, before_s = expected_arrivals(chart.keys, lane, chart.waters.end_s)
    for ordinal, place in enumerate(arrivals(chart.streams, Purpose.TRAFFIC_ARRIVALS, name, mean), start=1):
        yield from _draw_vessel(chart, name, lane, ordinal, place / lane.per_hour * 3600 - before_s)


def _draw_vessel(chart: Chart, name: str, lane: LaneKeys, ordinal: int, start_s: float) -> Iterator[Craft]:
    kind, outbound, section = "", True, f"lanes.{name}"
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_LANE, name, str(ordinal), step=attempt)
        if not attempt:  # a vessel that does not fit is drawn anew, but not as one that fits more easily
            kind, outbound = kind_of(lane, rng), not lane.both_ways or bool(rng.random() < 0.5)
        drawn = _draw(chart, lane, kind, outbound, start_s, rng)
        first = drawn.track()
        if not attempt and not _seen(first, chart):
            return
        track = chart.waters.best(first, lambda conflict_s, drawn=drawn: _changes(drawn, conflict_s))
        if track is not None:
            if _seen(track, chart):
                yield from chart.accept(Craft(f"{name}_{ordinal}", section, track, outbound), section)
            return
    yield from chart.accept(None, section)


def _seen(track: Track, chart: Chart) -> bool:
    return track.end_s >= 0 and track.start_s <= chart.waters.end_s


def _draw(chart: Chart, lane: LaneKeys, kind: str, outbound: bool, start_s: float, rng: np.random.Generator) -> _Drawn:
    hull, speed = chart.hull(lane, kind, rng)
    way = rounded(np.array(lane.waypoints_m), EASY * hull.turning_radius_m + lane.width_m / 2)
    starboard = (lane.width_m - hull.beam_m) / 2
    port = (hull.beam_m + chart.keys.clearance_m) / 2 if lane.both_ways else -starboard
    return _Drawn(
        hull=hull,
        way=way if outbound else way.reversed(),
        width=(port, max(starboard, port)),
        across=float(rng.random(2).mean()),
        speed_m_s=speed,
        speeds_m_s=chart.keys.speed_range(lane, kind),
        start_s=start_s,
    )


def _changes(drawn: _Drawn, conflict_s: float | None) -> Iterator[Sequence[Track]]:
    """All changed tracks: another time, another place across the lane, another speed, an alteration to starboard."""
    first = drawn.track()
    across = [drawn.track(across=place) for place in SHIFTS]
    yield [*across, *(_later(first, delay) for delay in DELAYS_S if abs(delay) <= SOON_S)]
    low, high = drawn.speeds_m_s
    paces = [drawn.track(pace=pace) for pace in PACES if low <= drawn.speed_m_s * pace <= high]
    aside = [] if conflict_s is None else _sidesteps(drawn, first, (conflict_s - first.start_s) * first.speed_m_s)
    yield [_later(track, delay) for track, delay in product([first, *across, *paces, *aside], DELAYS_S)]


def _sidesteps(drawn: _Drawn, track: Track, conflict_m: float) -> list[Track]:
    found = [
        drawn.sidestep(track, aside, conflict_m + 2 * aside * ahead)
        for aside, ahead in product(SIDESTEPS_M, (-1.0, 0.0, 1.0))
    ]
    return [track for track in found if track is not None]


def _later(track: Track, delay_s: float) -> Track:
    return replace(track, start_s=track.start_s + delay_s, cost=track.cost + abs(delay_s) / SECONDS_A_COST)


def _tightest_m(path: Path) -> float:
    """Least radius on a path."""
    bend: Array = np.abs(np.diff(path.headings_rad)) / np.diff(path.along_m)
    return 1 / max(float(bend.max()), 1e-9)
