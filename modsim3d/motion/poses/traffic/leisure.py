"""Leisure craft, which wander about in an area for the whole drive."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
import shapely

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
    found = arrivals(chart.streams, Purpose.TRAFFIC_ARRIVALS, name, craft_on_average(chart, area))
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
        path = _course(chart, area, hull, speed, rng)
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


def _course(chart: Chart, area: LeisureKeys, hull: Hull, speed_m_s: float, rng: np.random.Generator) -> Path | None:
    """A way through the water that is long enough for the drive."""
    land, kind = chart.waters.land.below(hull.air_draft_m), chart.keys.kinds[hull.kind]
    margin = hull.reach_m + chart.keys.clearance_m
    water = shapely.Polygon(area.polygon_m).buffer(-hull.reach_m).difference(land.buffer(margin, quad_segs=4))
    shapely.prepare(water)
    wind = chart.keys.wind_from_rad if kind.sails else None
    wanderer = Wanderer(water, hull.turning_radius_m, speed_m_s, wind, rng)
    needed = speed_m_s * (chart.waters.end_s + HEAD_STARTS_S[-1] + 2 * chart.waters.interval_s)
    if kind.near_shore:
        off = margin + between(SHORE_M, float(rng.random()))
        path = wanderer.along(chart.waters.land.below(SHALLOW_M).buffer(off).boundary, needed)
        if path is not None:
            return path
    return wanderer.course(needed)
