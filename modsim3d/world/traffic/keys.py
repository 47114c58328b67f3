"""The keys of drawn traffic in a scene file."""

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
KindSpeeds = dict[str, SpeedRange]  # kind → speed or [least, greatest], where not as in the table of kinds
MetresRange = Annotated[
    tuple[Annotated[Number, Field(ge=0)], Annotated[Number, Field(ge=0)]],
    BeforeValidator(one_as_range),
    AfterValidator(rising),
]
SecondsRange = Annotated[tuple[Seconds, Seconds], BeforeValidator(one_as_range), AfterValidator(rising)]


class OwnKeys(Strict):
    """The route of a vessel of the scene file, such as own ship; she starts it at time 0."""

    waypoints_m: Route  # places [w1, w2] in order; corners are rounded with her turning circle
    speed_m_s: SpeedRange  # hers, or [least, greatest] to draw one from
    # Diameter of her turning circle in lengths.
    turning_lengths: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.5, le=20)] = 3.0


class LaneKeys(Strict):
    """A lane that vessels pass through from end to end: a fairway, a traffic lane or a ferry's crossing."""

    waypoints_m: Route  # middle of the lane, places [w1, w2] in order
    width_m: Width  # vessels keep within it unless they make way for others
    both_ways: bool = False  # whether vessels go in both directions; they keep to the starboard half
    # Vessels that enter the lane in an hour, both directions together, on average; they come at random.
    per_hour: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1000)]
    kinds: Mix
    speed_m_s: KindSpeeds = Field(default_factory=dict)


class LeisureKeys(Strict):
    """An area in which craft wander on smooth courses for the whole drive."""

    polygon_m: Polygon  # corners [w1, w2] of the area; craft keep within it
    # Craft for each square kilometre of water in it, on average.
    per_km2: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)]
    kinds: Mix
    speed_m_s: KindSpeeds = Field(default_factory=dict)


class EncounterKeys(Strict):
    """A vessel that meets own ship. She keeps course and speed through the closest approach. With the kind `overtaking`
    she overtakes own ship, with `overtaken` own ship overtakes her, as by the rules 13 to 15 of COLREG."""

    kind: Literal["head_on", "crossing", "crossing_from_starboard", "crossing_from_port", "overtaking", "overtaken"]
    closest_m: MetresRange  # distance of the centres at the closest approach, or [least, greatest] to draw it from
    time_s: SecondsRange  # of the closest approach, or [least, greatest]
    kinds: Mix
    speed_m_s: KindSpeeds = Field(default_factory=dict)
    own: str | None = None  # the vessel of `own` that is met; the first one by default
    count: Annotated[int, Field(strict=True, ge=0, le=100)] = 1  # of such vessels


Drawn = LaneKeys | LeisureKeys | EncounterKeys  # a section that draws vessels by kind


class TrafficSections(Strict):
    """The keys of `poses.traffic`."""

    own: dict[str, OwnKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)  # vessel of the scene → its route
    # By name; a lane has the right of way over those below it.
    lanes: dict[str, LaneKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    leisure: dict[str, LeisureKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    encounters: dict[str, EncounterKeys] = Field(default_factory=dict, max_length=MAX_SECTIONS)
    clearance_m: Clearance = 10.0  # least water between any two hulls, and between a hull and an obstacle
    # Time for which traffic is planned, if the scene is shorter: any part of it shows the same traffic.
    duration_s: Seconds = 0.0
    # Direction from which the wind blows, counter-clockwise from w1. With it, leisure craft that sail keep 43° away
    # from it; without it they go anywhere.
    wind_from_rad: Annotated[Number, Field(ge=-TURN_RAD, le=TURN_RAD)] | None = None
    kinds: dict[str, KindKeys] = Field(default_factory=dict)  # of your own, or other values of a shipped kind
    # Label of the shipped kinds → the label that takes its place, or one label for all vessels.
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
        sections: dict[str, Drawn] = {f"encounters.{name}": keys for name, keys in self.encounters.items()}
        sections |= {f"lanes.{name}": keys for name, keys in self.lanes.items()}
        return sections | {f"leisure.{name}": keys for name, keys in self.leisure.items()}

    def speed_range(self, section: Drawn, kind: str) -> tuple[float, float]:
        """Least and greatest speed of a kind in a section."""
        return section.speed_m_s.get(kind, self.kinds[kind].speed_m_s)

    def label(self, kind: str) -> str:
        """The label of a kind's vessels."""
        own = self.kinds[kind].label
        return self.labels if isinstance(self.labels, str) else self.labels.get(own, own)

    def problems(self) -> list[str]:
        """Problems between the keys, each with its path below `poses.traffic`."""
        problems: list[str] = []
        names: dict[str, str] = {}
        for path, section in self.drawing.items():
            name = path.partition(".")[2]
            if name in names:
                problems.append(f"{path}: {names[name]} has this name too, and vessels are named by it")
            names.setdefault(name, path)
            for key, entries in (("kinds", section.kinds), ("speed_m_s", section.speed_m_s)):
                problems += [
                    f"{path}.{key}.{kind}: no such kind ({nearest(kind, self.kinds)})"
                    for kind in entries
                    if kind not in self.kinds
                ]
        for name, meeting in self.encounters.items():
            if not self.own:
                problems.append(f"encounters.{name}: with whom? `own` has no vessel")
            elif meeting.own is not None and meeting.own not in self.own:
                hint = nearest(meeting.own, self.own)
                problems.append(f"encounters.{name}.own: no vessel '{meeting.own}' in `own` ({hint})")
        if isinstance(self.labels, Mapping):
            kind_labels = {kind.label for kind in self.kinds.values()}
            problems += [
                f"labels.{label}: no kind has this label ({nearest(label, kind_labels)})"
                for label in self.labels
                if label not in kind_labels
            ]
        return problems
