"""The keys of drawn traffic in a scene file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
import shapely
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from modsim3d.io.validation import Metres, Number, Strict, nearest, shown
from modsim3d.world.traffic.paths import SHARPEST_RAD, turns_rad
from modsim3d.world.traffic.tracks import KindKeys, SpeedRange, one_as_range, rising, shipped_kinds

MAX_WAYPOINTS, MAX_SECTIONS = 200, 100
MIN_LEG_M = 1.0
TURN_RAD = 6.3

Place = tuple[Metres, Metres]
Share = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]
Width = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1e5)]
Seconds = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e6)]
Clearance = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=1e5)]


def _route(waypoints: list[Place]) -> list[Place]:
    legs = np.diff(np.array(waypoints, dtype=np.float64), axis=0)
    short = np.flatnonzero(np.hypot(legs[:, 0], legs[:, 1]) < MIN_LEG_M)
    if len(short):
        raise ValueError(f"waypoint {short[0] + 1} is less than {MIN_LEG_M:g} m from the one before")
    sharp = np.flatnonzero(np.abs(turns_rad(np.array(waypoints, dtype=np.float64))) > SHARPEST_RAD)
    if len(sharp):
        most = np.degrees(SHARPEST_RAD)
        raise ValueError(f"turns by more than {most:.0f}° at waypoint {sharp[0] + 1}: use two waypoints there")
    return waypoints


def _area(corners: list[Place]) -> list[Place]:
    polygon = shapely.Polygon(corners)
    if not polygon.is_valid or polygon.area <= 0:
        raise ValueError("must be a polygon with an area, whose sides do not cross")
    return corners


def _weights(weights: object) -> object:
    """A list of names counts each alike, one name alone is the only one."""
    names = [weights] if isinstance(weights, str) else weights
    if isinstance(names, list) and all(isinstance(name, str) for name in names):
        return dict.fromkeys(names, 1.0)
    return weights


def _some_weight(weights: dict[str, float]) -> dict[str, float]:
    if not sum(weights.values()) > 0:
        raise ValueError(f"at least one kind with a weight above 0 is needed (got {shown(weights)})")
    return weights


def _labels(labels: object) -> object:
    values = labels.values() if isinstance(labels, Mapping) else [labels]
    if not all(isinstance(value, str) for value in values):
        raise ValueError(f"one label for all vessels, or a mapping of label to label is needed (got {shown(labels)})")
    return labels


Route = Annotated[list[Place], Field(min_length=2, max_length=MAX_WAYPOINTS), AfterValidator(_route)]
Polygon = Annotated[list[Place], Field(min_length=3, max_length=MAX_WAYPOINTS), AfterValidator(_area)]
Mix = Annotated[dict[str, Share], BeforeValidator(_weights), AfterValidator(_some_weight)]
"""Kind → weight; a list of kinds, or one, where all weigh the same."""
MetresRange = Annotated[
    tuple[Annotated[Number, Field(ge=0)], Annotated[Number, Field(ge=0)]],
    BeforeValidator(one_as_range),
    AfterValidator(rising),
]
SecondsRange = Annotated[tuple[Seconds, Seconds], BeforeValidator(one_as_range), AfterValidator(rising)]


class OwnKeys(Strict):
    """The route of a vessel of the scene file, such as own ship; she starts it at time 0.

    Attributes:
        waypoints_m: Places [w1, w2] in order. Corners are rounded with her turning circle.
        speed_m_s: Her speed, or [least, greatest] to draw one from.
        turning_lengths: Diameter of her turning circle in lengths.
    """

    waypoints_m: Route
    speed_m_s: SpeedRange
    turning_lengths: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.5, le=20)] = 3.0


class LaneKeys(Strict):
    """A lane that vessels pass through from end to end: a fairway, a traffic lane or a ferry's crossing.

    Attributes:
        waypoints_m: Middle of the lane, places [w1, w2] in order.
        width_m: Width; vessels keep within it unless they make way for others.
        both_ways: Whether vessels go in both directions; they keep to the starboard half.
        per_hour: Vessels that enter the lane in an hour, both directions together, on average. They come at random.
        kinds: Kind → weight.
        speed_m_s: Kind → speed or [least, greatest], where not as in the table of kinds.
    """

    waypoints_m: Route
    width_m: Width
    both_ways: bool = False
    per_hour: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1000)]
    kinds: Mix
    speed_m_s: dict[str, SpeedRange] = Field(default_factory=dict)


class LeisureKeys(Strict):
    """An area in which craft wander on smooth courses for the whole drive.

    Attributes:
        polygon_m: Corners [w1, w2] of the area. Craft keep within it.
        per_km2: Craft for each square kilometre of water in it, on average.
        kinds: Kind → weight.
        speed_m_s: Kind → speed or [least, greatest], where not as in the table of kinds.
    """

    polygon_m: Polygon
    per_km2: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)]
    kinds: Mix
    speed_m_s: dict[str, SpeedRange] = Field(default_factory=dict)


class EncounterKeys(Strict):
    """A vessel that meets own ship. She keeps course and speed through the closest approach.

    Attributes:
        kind: head_on, crossing, crossing_from_starboard, crossing_from_port, overtaking (she overtakes own ship) or
            overtaken (own ship overtakes her), as by the rules 13 to 15 of COLREG.
        closest_m: Distance of the centres at the closest approach, or [least, greatest] to draw it from.
        time_s: Time of the closest approach, or [least, greatest].
        kinds: Kind → weight.
        speed_m_s: Kind → speed or [least, greatest], where not as in the table of kinds.
        own: The vessel of `own` that is met; the first one by default.
        count: Number of such vessels.
    """

    kind: Literal["head_on", "crossing", "crossing_from_starboard", "crossing_from_port", "overtaking", "overtaken"]
    closest_m: MetresRange
    time_s: SecondsRange
    kinds: Mix
    speed_m_s: dict[str, SpeedRange] = Field(default_factory=dict)
    own: str | None = None
    count: Annotated[int, Field(strict=True, ge=0, le=100)] = 1


Drawn = LaneKeys | LeisureKeys | EncounterKeys
"""A section that draws vessels by kind."""


class TrafficSections(Strict):
    """The keys of `poses.traffic`.

    Attributes:
        own: Vessel of the scene file → its route.
        lanes: Name → lane. A lane has the right of way over those below it.
        leisure: Name → area with leisure craft.
        encounters: Name → encounter with own ship.
        clearance_m: Least water between any two hulls, and between a hull and an obstacle.
        duration_s: Time for which traffic is planned, if the scene is shorter: any part of it shows the same traffic.
        wind_from_rad: Direction from which the wind blows, counter-clockwise from w1. With it, leisure craft that sail
            keep 43° away from it; without it they go anywhere.
        kinds: Kinds of vessels of your own, or other values of a shipped kind.
        labels: Label of the shipped kinds → the label that takes its place, or one label for all vessels.
    """

    own: dict[str, OwnKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    lanes: dict[str, LaneKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    leisure: dict[str, LeisureKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    encounters: dict[str, EncounterKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    clearance_m: Clearance = 10.0
    duration_s: Seconds = 0.0
    wind_from_rad: Annotated[Number, Field(ge=-TURN_RAD, le=TURN_RAD)] | None = None
    kinds: dict[str, KindKeys] = Field(default_factory=dict)
    labels: Annotated[str | dict[str, str], BeforeValidator(_labels)] = Field(default_factory=dict)

    @field_validator("kinds", mode="before")
    @classmethod
    def _over_the_shipped(cls, given: object) -> object:
        """All kinds: the shipped ones with the given values."""
        shipped = shipped_kinds()
        if not isinstance(given, Mapping):
            return given
        entries = {
            name: {**shipped.get(name, {}), **entry} if isinstance(entry, Mapping) else entry
            for name, entry in given.items()
        }
        return {**shipped, **entries}

    @model_validator(mode="before")
    @classmethod
    def _with_kinds(cls, keys: object) -> object:
        return {"kinds": {}, **keys} if isinstance(keys, Mapping) else keys

    @property
    def drawing(self) -> dict[str, Drawn]:
        """All sections that draw vessels, by their path below `poses.traffic`."""
        groups: dict[str, Mapping[str, Drawn]] = {
            "encounters": self.encounters,
            "lanes": self.lanes,
            "leisure": self.leisure,
        }
        return {f"{group}.{name}": keys for group, sections in groups.items() for name, keys in sections.items()}

    def speed_range(self, section: Drawn, kind: str) -> tuple[float, float]:
        """Least and greatest speed of a kind in a section."""
        return section.speed_m_s.get(kind, self.kinds[kind].speed_m_s)

    def label(self, kind: str) -> str:
        """The label of a kind's vessels."""
        own = self.kinds[kind].label
        return self.labels if isinstance(self.labels, str) else self.labels.get(own, own)

    def problems(self) -> list[str]:
        """Problems between the keys, each with its path below `poses.traffic`."""
        found: list[str] = []
        names: dict[str, str] = {}
        for path, section in self.drawing.items():
            name = path.partition(".")[2]
            if name in names:
                found.append(f"{path}: {names[name]} has this name too, and vessels are named by it")
            names.setdefault(name, path)
            for key, entries in (("kinds", section.kinds), ("speed_m_s", section.speed_m_s)):
                found += [
                    f"{path}.{key}.{kind}: no such kind ({nearest(kind, self.kinds)})"
                    for kind in entries
                    if kind not in self.kinds
                ]
        for name, meeting in self.encounters.items():
            if not self.own:
                found.append(f"encounters.{name}: with whom? `own` has no vessel")
            elif meeting.own is not None and meeting.own not in self.own:
                found.append(
                    f"encounters.{name}.own: no vessel '{meeting.own}' in `own` ({nearest(meeting.own, self.own)})"
                )
        if isinstance(self.labels, Mapping):
            known = {kind.label for kind in self.kinds.values()}
            found += [
                f"labels.{label}: no kind has this label ({nearest(label, known)})"
                for label in self.labels
                if label not in known
            ]
        return found
