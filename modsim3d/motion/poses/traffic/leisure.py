"""Leisure craft, which wander about in an area for the whole drive."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import product

import shapely

from modsim3d.arrays import Array
from modsim3d.motion.poses.traffic.craft import Chart, Craft, arrivals, between, kind_of
from modsim3d.motion.poses.traffic.keys import LeisureKeys
from modsim3d.motion.poses.traffic.kinds import Hull
from modsim3d.motion.poses.traffic.paths import Path
from modsim3d.motion.poses.traffic.tracks import Track
from modsim3d.motion.poses.traffic.wandering import Wanderer
from modsim3d.random_streams import Purpose

TRIES = 40
GOOD_ENOUGH = 0.3
"""Crowding with which a craft is taken at once, and not the best of all tries."""
HEAD_STARTS_S = (0.0, 20.0, 40.0, 60.0)
"""Ways are longer than the drive, so that a craft may be further along hers at its beginning."""
PACES = (1.0, 0.85, 0.7)
SHORE_M = (12.0, 60.0)
"""Distance from the shore of those that keep near it, beside the clearance."""
SHALLOW_M = 1.0
"""What begins lower than this above the sea takes water away from the area."""


def craft_on_average(chart: Chart, area: LeisureKeys) -> float:
    """Mean number of craft in an area."""
    water = shapely.Polygon(area.polygon_m).difference(chart.waters.land.below(SHALLOW_M))
    return float(area.per_km2 * water.area / 1e6)


def draw_area(chart: Chart, name: str, area: LeisureKeys) -> Iterator[Craft]:
    """The craft of an area."""
    section = f"leisure.{name}"
    found = arrivals(chart.streams, name, craft_on_average(chart, area))
    for ordinal in range(1, len(found) + 1):
        track = _draw_craft(chart, name, area, ordinal)
        craft = None if track is None else Craft(f"{name}_{ordinal}", section, track)
        yield from chart.accept(craft, section)


def _draw_craft(chart: Chart, name: str, area: LeisureKeys, ordinal: int) -> Track | None:
    """The first of many tries that keeps well clear of all others, or the best; None if none keeps clear."""
    best, least, kind = None, math.inf, ""
    for attempt in range(TRIES):
        rng = chart.streams.generator(Purpose.TRAFFIC_LEISURE, name, str(ordinal), step=attempt)
        if not attempt:
            kind = kind_of(area, rng)
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


def _course(chart: Chart, hull: Hull, wanderer: Wanderer) -> Path | None:
    """A way through the water that is long enough for the drive."""
    needed = wanderer.speed_m_s * (chart.waters.end_s + HEAD_STARTS_S[-1] + 2 * chart.waters.interval_s)
    if chart.keys.kinds[hull.kind].near_shore:
        off = hull.reach_m + chart.keys.clearance_m + between(SHORE_M, float(wanderer.rng.random()))
        path = wanderer.along(chart.waters.land.below(SHALLOW_M).buffer(off).boundary, needed)
        if path is not None:
            return path
    return wanderer.course(needed)


def _water(chart: Chart, area: LeisureKeys, hull: Hull) -> shapely.Geometry:
    """Where the centre of a hull may be."""
    land = chart.waters.land.below(hull.air_draft_m).buffer(hull.reach_m + chart.keys.clearance_m, quad_segs=4)
    water = shapely.Polygon(area.polygon_m).buffer(-hull.reach_m).difference(land)
    shapely.prepare(water)
    return water


def _is_clear(chart: Chart, hull: Hull, speed_m_s: float, leg: Array, gone_m: float) -> bool:
    """Whether a leg that begins after a distance on her way keeps clear of the vessels planned so far."""
    track = Track(hull, Path.through(leg), speed_m_s, gone_m / speed_m_s)
    return chart.waters.is_clear(track, track.start_s, track.end_s)
