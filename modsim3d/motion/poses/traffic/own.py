"""The vessels of the scene file on their routes: they make way for nobody."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.motion.poses.traffic.craft import Chart, between
from modsim3d.motion.poses.traffic.gaps import least_gaps
from modsim3d.motion.poses.traffic.keys import OwnKeys
from modsim3d.motion.poses.traffic.kinds import Hull, turning_radius_m
from modsim3d.motion.poses.traffic.paths import corner_radii_m, rounded
from modsim3d.motion.poses.traffic.tracks import Sweep, Track
from modsim3d.random_streams import Purpose
from modsim3d.vessels.vessel import Vessel

EASY = 1.5
"""Radii of turns in least radii, where the legs leave room."""


def enter_own(chart: Chart, vessels: Sequence[Vessel]) -> list[str]:
    """Enter the vessels that have a route into the waters; returns what is wrong with the routes."""
    named, problems = {vessel.name: vessel for vessel in vessels}, []
    for name, keys in chart.keys.own.items():
        rng = chart.streams.generator(Purpose.TRAFFIC_OWN, name, step=0)
        speed, vessel = between(keys.speed_m_s, float(rng.random())), named[name]
        problems += _tight(name, keys, vessel)
        radius = turning_radius_m(keys.turning_lengths, vessel.length_m, speed)
        hull = Hull(name, vessel.length_m, vessel.beam_m, vessel.air_draft_m, radius)
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
    return [
        f"own.{name}.waypoints_m[{int(np.argmin(room)) + 1}]: she turns on a radius of {radius:.0f} m, and the legs "
        f"leave room for {room.min():.0f} m: use longer legs or a smaller change of course"
    ]


def _conflicts(chart: Chart, name: str, track: Track) -> list[str]:
    """What she runs into: an obstacle, or another vessel of the scene file."""
    waters, problems = chart.waters, []
    sweep, least = Sweep.of([track], waters.times_s, waters.interval_s), f"clearance_m ({waters.clearance_m:g} m)"
    if waters.land.gaps(sweep, waters.interval_s, waters.clearance_m)[0] < waters.clearance_m:
        problems.append(f"own.{name}.waypoints_m: leads closer to an obstacle than {least}")
    for other, theirs in zip(chart.own, waters.fleet, strict=True):
        gap, step = least_gaps(sweep, theirs, waters.interval_s, waters.clearance_m)
        if gap[0] < waters.clearance_m:
            problems.append(f"own.{name}: comes closer to '{other}' than {least} at {waters.times_s[step[0]]:.0f} s")
    return problems
