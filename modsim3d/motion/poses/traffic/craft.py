"""Vessels of drawn traffic, and what all ways to draw them share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from modsim3d.motion.poses.traffic.keys import Drawn, TrafficSections
from modsim3d.motion.poses.traffic.kinds import Hull, draw_hull, draw_one, turning_radius_m
from modsim3d.motion.poses.traffic.tracks import Track
from modsim3d.motion.poses.traffic.waters import Waters
from modsim3d.random_streams import Purpose, Streams, on_grid


@dataclass(frozen=True)
class Approach:
    """The closest approach to own ship that an encounter was drawn with: kind, distance of the centres, and time."""

    kind: str
    own: str
    closest_m: float
    time_s: float


@dataclass(frozen=True)
class Craft:
    """A drawn vessel.

    Attributes:
        name: Her ID in the scene.
        section: What drew her, such as `lanes.north`.
        track: Her hull and way.
        outbound: Whether she follows a lane from its first waypoint to its last.
        asked: The closest approach, of an encounter.
    """

    name: str
    section: str
    track: Track
    outbound: bool = True
    asked: Approach | None = None


@dataclass(eq=False)
class Chart:
    """What vessels are drawn with: the keys, the seed's streams, and the waters with those that are there already.

    `own` has the tracks of the vessels of the scene file; `left_out` counts vessels by section for which there was no
    room.
    """

    keys: TrafficSections
    streams: Streams
    waters: Waters
    own: dict[str, Track]
    left_out: dict[str, int] = field(default_factory=dict)

    def hull(self, section: Drawn, kind: str, rng: np.random.Generator) -> tuple[Hull, float]:
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


def greatest_radius_m(keys: TrafficSections, section: Drawn, kind: str) -> float:
    """Turning radius of the longest and fastest vessel of a kind in a section."""
    entry = keys.kinds[kind]
    return turning_radius_m(entry.turning_lengths, entry.length_m[2], keys.speed_range(section, kind)[1])
