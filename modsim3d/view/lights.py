"""Lights of vessels: COLREG 1972, Rules 21 to 26 and 30, with places by Annex I.
Nobody is towing, restricted, constrained by draught, not under command or on pilotage duty: no scene says so."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.geometry.kinematics import KNOT_M_S, NAUTICAL_MILE_M, velocities
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.view.pictures.plain import Solids
from modsim3d.world.vessels import Vessel

# ---- A light of a vessel ----

THRESHOLD_LUX = 2e-7  # the faintest light that an eye sees at sea by night (COLREG, Annex I, section 8)
CLEAR_AIR = 0.8  # share of the light that a nautical mile of clear air leaves, the same section's K
CLEAR_EXTINCTION_PER_M = -math.log(CLEAR_AIR) / NAUTICAL_MILE_M
AHEAD_DEG = 1.0  # sidelights shine this far across the bow (Annex I, section 9: between 1° and 3°)


class Colour(Enum):
    """Colours of lights, sRGB from 0 to 1."""

    WHITE = (1.0, 0.96, 0.85)
    RED = (1.0, 0.12, 0.08)
    GREEN = (0.1, 1.0, 0.45)


class Sector(Enum):
    """Bearings between which a light is seen, in degrees from right ahead, to port positive (Rule 21)."""

    MASTHEAD = (-112.5, 112.5)
    PORT = (-AHEAD_DEG, 112.5)
    STARBOARD = (-112.5, AHEAD_DEG)
    STERN = (112.5, 247.5)
    ALL_ROUND = (-180.0, 180.0)

    def holds(self, bearing_deg: float) -> bool:
        """Whether a light is seen at a bearing from the bow, to port positive, in degrees."""
        first, last = self.value
        return (bearing_deg - first) % 360.0 <= last - first


@dataclass(frozen=True)
class Lantern:
    """A light of a vessel."""

    name: str  # as in the rules
    colour: Colour
    sector: Sector
    range_nm: float  # from how far it is seen in clear air, in nautical miles (Rule 22)
    place: tuple[float, float, float]  # in units of the vessel's length, beam and air draft, as a vertex of a solid

    @property
    def intensity_cd(self) -> float:
        """Luminous intensity in candela, I = 3.43 · 10⁶ T D² K^−D (COLREG, Annex I, section 8)."""
        return THRESHOLD_LUX * (NAUTICAL_MILE_M * self.range_nm) ** 2 * math.pow(CLEAR_AIR, -self.range_nm)

    def illuminance_lux(self, distance_m: float, extinction_per_m: float = CLEAR_EXTINCTION_PER_M) -> float:
        """Light that arrives at a distance in metres through air that takes a share of it in each metre."""
        return self.intensity_cd / distance_m**2 * math.exp(-extinction_per_m * distance_m)


# ---- What kind of vessel the rules take a vessel for ----


class Kind(Enum):
    """Kinds of vessels that have rules of their own."""

    POWER = auto()
    SAIL = auto()
    OARS = auto()
    TRAWLING = auto()
    FISHING = auto()


ACTIVITIES = {Kind.TRAWLING: {"trawling"}, Kind.FISHING: {"netting", "longlining"}}
"""Words for what a vessel does. A ship type, such as trawler or fishing vessel, does not say that she fishes."""
BUILDS = (  # words for what a vessel is. If a text has several, the first line that has one of them counts
    (Kind.POWER, {"motor", "motorboat", "motoryacht", "motorsailer", "power", "powerboat", "speedboat"}),
    (Kind.OARS, {"kayak", "canoe", "rowing", "rowboat", "paddle", "paddleboard"}),
    (Kind.SAIL, {"sail", "sails", "sailing", "sailboat", "sailer", "yacht", "ketch", "sloop", "schooner", "yawl"}),
    (Kind.POWER, {"ship", "ferry", "tug", "cargo", "tanker", "barge"}),
)


def kind_of(vessel: Vessel) -> Kind:
    """The kind of a vessel: what it does, else what it is by its mesh, its label or its ID, else power-driven."""
    texts = [_words(text) for text in (vessel.shape, vessel.label, vessel.name)]
    for kind, words in ACTIVITIES.items():
        if any(words & text for text in texts):
            return kind
    for text in texts:
        for kind, words in BUILDS:
            if words & text:
                return kind
    return Kind.POWER


def _words(text: str) -> set[str]:
    """The words of a text in small letters; `SailingYacht_2` has two."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)}


STANDS_M_S = 0.5 * KNOT_M_S  # a slower vessel is taken to be at anchor, or to make no way if she fishes
SLOW_M_S = 7 * KNOT_M_S  # Rule 23 d (ii): below 7 m and 7 knots a white light is enough
CENTRE_LINE = 0.0  # across the vessel


def lanterns(vessel: Vessel, speed_m_s: float) -> tuple[Lantern, ...]:
    """The lights of a vessel at a speed over ground in metres per second; NaN if it is not known."""
    rig = _Rig(vessel)
    kind, stands = kind_of(vessel), speed_m_s < STANDS_M_S
    if kind is Kind.OARS:
        return (rig.all_round("torch", Colour.WHITE, vessel.air_draft_m),)
    if kind in (Kind.TRAWLING, Kind.FISHING):
        return _fishing(rig, kind, makes_way=not stands)
    if stands:
        return _anchored(rig)
    return _sailing(rig) if kind is Kind.SAIL else _power_driven(rig, speed_m_s)


def _power_driven(rig: _Rig, speed_m_s: float) -> tuple[Lantern, ...]:
    """Rule 23; Rule 24 too, as long as nothing is towed."""
    if rig.vessel.length_m >= 50:
        return (rig.masthead(rig.fore), rig.masthead(rig.after), *rig.sides(), rig.stern())
    if rig.vessel.length_m >= 12:
        return (rig.masthead(rig.fore), *rig.sides(), rig.stern())
    white = rig.all_round("all-round", Colour.WHITE, rig.vessel.air_draft_m)
    if rig.vessel.length_m < 7 and not speed_m_s > SLOW_M_S:
        return (white,)
    return (white, *rig.sides())


def _sailing(rig: _Rig) -> tuple[Lantern, ...]:
    """Rule 25: the three lights of a vessel below 20 m are in one lantern at the top of the mast."""
    if rig.vessel.length_m < 7:
        return (rig.all_round("torch", Colour.WHITE, rig.deck_m + 1.0),)
    if rig.vessel.length_m < 20:
        return (*rig.sides(rig.top), rig.stern(rig.top))
    return (*rig.sides(), rig.stern())


def _fishing(rig: _Rig, kind: Kind, *, makes_way: bool) -> tuple[Lantern, ...]:
    """Rule 26: trawlers green over white, others red over white; a long trawler also a masthead light above them."""
    trawls = kind is Kind.TRAWLING
    shown = [
        rig.all_round("upper", Colour.GREEN if trawls else Colour.RED, rig.upper_m),
        rig.all_round("lower", Colour.WHITE, rig.upper_m - rig.apart_m),
    ]
    if trawls and rig.vessel.length_m >= 50:
        shown.append(rig.masthead(rig.after))
    return (*shown, *rig.sides(), rig.stern()) if makes_way else tuple(shown)


def _anchored(rig: _Rig) -> tuple[Lantern, ...]:
    """Rule 30: one white light, and below 50 m no more; else one in the fore part and a lower one at the stern."""
    if rig.vessel.length_m < 50:
        return (rig.all_round("anchor", Colour.WHITE, rig.vessel.air_draft_m),)
    fore_m = min(rig.deck_m + 10.5, rig.vessel.air_draft_m)
    aft_m = max(fore_m - 4.5, 0.5 * fore_m)
    fore = rig.all_round("anchor", Colour.WHITE, fore_m, 0.4)
    return (fore, rig.all_round("anchor aft", Colour.WHITE, aft_m, -0.45))


@dataclass(frozen=True)
class _Rig:
    """A vessel, and where its lights are."""

    vessel: Vessel

    @property
    def deck_m(self) -> float:
        """Height of the uppermost continuous deck, from which Annex I counts; as in the shipped meshes, roughly."""
        return min(0.25 * self.vessel.air_draft_m, 0.1 * self.vessel.length_m)

    @property
    def apart_m(self) -> float:
        """Distance between two lights, one above the other (Annex I, section 2 i)."""
        return 2.0 if self.vessel.length_m >= 20 else 1.0

    @property
    def upper_m(self) -> float:
        """Height of the upper light of a vessel that fishes; a long trawler has her masthead light above it."""
        long_trawler = kind_of(self.vessel) is Kind.TRAWLING and self.vessel.length_m >= 50
        return self.fore[2] * self.vessel.air_draft_m if long_trawler else self.vessel.air_draft_m

    @cached_property
    def top(self) -> tuple[float, float, float]:
        """The highest point, moved to the centre line: the top of a mast if the mesh has one."""
        return self._highest(-0.5)

    def _highest(self, from_v1: float) -> tuple[float, float, float]:
        vertices = self.vessel.solid.vertices
        ahead = vertices[vertices[:, 0] >= from_v1]
        highest = ahead[ahead[:, 2] >= ahead[:, 2].max() - 1e-6]
        return float(highest[:, 0].mean()), CENTRE_LINE, float(highest[0, 2])

    @cached_property
    def fore(self) -> tuple[float, float, float]:
        """Place of the forward masthead light, or the only one (Annex I, sections 2 and 3).
        A vessel of 20 m or more has it before midships. One of 50 m or more has it in the foremost quarter, as high
        above the deck as she is broad, but 6 to 12 m, and 4.5 m lower than the one abaft if her height allows that.
        If she has a foremast of at least this height there, it is at the top of the foremast."""
        if self.vessel.length_m < 50:
            return self.top if self.vessel.length_m < 20 or self.top[0] > 0 else (0.1, CENTRE_LINE, 1.0)
        wanted_m = self.deck_m + float(np.clip(self.vessel.beam_m, 6.0, 12.0))
        most_m = max(self.vessel.air_draft_m - 4.5, 0.6 * self.vessel.air_draft_m)
        mast = self._highest(0.25)
        if wanted_m <= mast[2] * self.vessel.air_draft_m <= most_m:
            return mast
        return 0.3, CENTRE_LINE, min(wanted_m, most_m) / self.vessel.air_draft_m

    @cached_property
    def after(self) -> tuple[float, float, float]:
        """Place of the after masthead light: at the full height, half the length behind the other, or 100 m."""
        behind = min(0.5, 100.0 / self.vessel.length_m)
        return min(self.top[0], self.fore[0] - behind), CENTRE_LINE, 1.0

    def all_round(self, name: str, colour: Colour, height_m: float, v1: float | None = None) -> Lantern:
        """A light that is seen from everywhere, above the highest point unless `v1` says where."""
        place = (self.top[0] if v1 is None else v1, CENTRE_LINE, height_m / self.vessel.air_draft_m)
        return Lantern(name, colour, Sector.ALL_ROUND, 2.0 if self.vessel.length_m < 50 else 3.0, place)

    def masthead(self, place: tuple[float, float, float]) -> Lantern:
        miles = {12.0: 2.0, 20.0: 3.0, 50.0: 5.0}
        seen_nm = next((miles[below] for below in miles if self.vessel.length_m < below), 6.0)
        return Lantern("masthead", Colour.WHITE, Sector.MASTHEAD, seen_nm, place)

    def sides(self, place: tuple[float, float, float] | None = None) -> tuple[Lantern, Lantern]:
        """Sidelights, both at one place if it is given; else at the sides, below three quarters of the masthead."""
        seen_nm = 1.0 if self.vessel.length_m < 12 else 2.0 if self.vessel.length_m < 50 else 3.0
        v1, v3 = self._side_place()
        port, starboard = (place, place) if place else ((v1, 0.5, v3), (v1, -0.5, v3))
        return (
            Lantern("port side", Colour.RED, Sector.PORT, seen_nm, port),
            Lantern("starboard side", Colour.GREEN, Sector.STARBOARD, seen_nm, starboard),
        )

    def stern(self, place: tuple[float, float, float] | None = None) -> Lantern:
        low_m = self.deck_m + 0.1 * (self.vessel.air_draft_m - self.deck_m)
        low = -0.5, CENTRE_LINE, low_m / self.vessel.air_draft_m
        return Lantern("stern", Colour.WHITE, Sector.STERN, 2.0 if self.vessel.length_m < 50 else 3.0, place or low)

    def _side_place(self) -> tuple[float, float]:
        """v1 and v3 of sidelights at the side of the hull (Annex I, sections 2 g, 2 j and 3 b)."""
        kind, mast_m = kind_of(self.vessel), self.fore[2] * self.vessel.air_draft_m
        if kind is Kind.SAIL:
            return 0.1, min(self.deck_m + 1.0, self.vessel.air_draft_m) / self.vessel.air_draft_m
        height_m = self.deck_m + 0.6 * (mast_m - self.deck_m)
        if kind in (Kind.TRAWLING, Kind.FISHING):  # twice as far below the lower light as that is below the upper one
            height_m = min(height_m, self.upper_m - 3 * self.apart_m)
        if self.vessel.length_m < 20:
            height_m = min(height_m, mast_m - 1.0)
        v1 = 0.2 if self.vessel.length_m < 20 else min(self.top[0], self.fore[0])
        return v1, max(height_m, 0.3 * mast_m) / self.vessel.air_draft_m


# ---- Which lights a camera sees, where, and how strong ----


@dataclass(frozen=True, eq=False)
class SeenLight:
    """A light that is turned to a camera."""

    vessel: int  # index
    lantern: Lantern
    place_m: Array  # in WCF, shape (3,)
    decades: float  # logarithm to base 10 of its light over the faintest that an eye sees


def ground_velocities(scene: Scene, step: int) -> Array:
    """Velocities over ground of the V vessels at a step in m/s, shape (V, 2); NaN where a neighbouring pose is
    needed."""
    first, stop = scene.motion.with_neighbours(np.array([step]))
    poses = scene.poses.poses(first, stop)
    calm_m = poses.positions_m * (1.0, 1.0, 0.0)
    vectors = velocities(scene.times_s(first, stop), calm_m, poses.present)[step - first, :, :2]
    valid = poses.present[step - first] & (poses.present.sum(axis=0) > 1)
    return np.where(valid[:, None], vectors, np.nan)


def ground_speeds(scene: Scene, step: int) -> Array:
    """Speeds over ground of the V vessels at a step in m/s, shape (V,); NaN where a neighbouring pose is needed."""
    speeds: Array = np.linalg.norm(ground_velocities(scene, step), axis=-1)
    return speeds


def lights_towards(sight: Sight, speeds_m_s: Array, extinction_per_m: float = 0.0) -> Iterator[SeenLight]:
    """The lights of other vessels that are turned to a camera at its first step, and strong enough.
    Speeds over ground have the shape (V,), NaN where they are not known. The extinction is the share of the light that
    a metre of air takes, that of clear air if 0."""
    camera_m = sight.camera_poses.positions_m[0]
    for index in np.flatnonzero(sight.others[0]).tolist():
        vessel, world_R_vessel = sight.vessels[index], sight.world_R_vessel[0, index]
        origin_m = sight.poses.positions_m[0, index]
        ahead, port, _ = ((camera_m - origin_m) @ world_R_vessel).tolist()
        for lantern in lanterns(vessel, float(speeds_m_s[index])):
            # From the centreline, so that a broad ship shows both sidelights to what is right ahead.
            bearing = math.atan2(port, ahead - lantern.place[0] * vessel.length_m)
            if not lantern.sector.holds(math.degrees(bearing)):
                continue
            place_m = world_R_vessel @ (np.array(lantern.place) * vessel.extents_m) + origin_m
            distance_m = max(float(np.linalg.norm(place_m - camera_m)), 1.0)
            light = lantern.illuminance_lux(distance_m, extinction_per_m or CLEAR_EXTINCTION_PER_M)
            if light >= THRESHOLD_LUX:
                yield SeenLight(index, lantern, place_m, math.log10(light / THRESHOLD_LUX))


def is_hidden(solids: Solids, vessel: int, place_px: Array, inverse_depth: float) -> bool:
    """Whether another vessel, an obstacle or own ship stands before a light at a column and row of the image, shape
    (2,), and at an inverse depth near / c3, as in `Triangles`.
    A vessel's own hull does not hide her lights: where they hang they are clear of it."""
    triangles = solids.triangles
    low, high = triangles.corners_px.min(axis=1), triangles.corners_px.max(axis=1)
    near = ((low <= place_px) & (place_px <= high)).all(axis=1) & (solids.occluders[triangles.row] != vessel)
    corners, depths = triangles.corners_px[near] - place_px, triangles.inverse_depth[near]
    # Barycentric coordinates: the areas that the place spans with two corners each.
    after, last = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    areas = after[..., 0] * last[..., 1] - after[..., 1] * last[..., 0]
    whole = areas.sum(axis=1)
    inside = ((areas * np.sign(whole)[:, None] >= 0).all(axis=1)) & (whole != 0)
    before = (areas[inside] * depths[inside]).sum(axis=1) / whole[inside] > inverse_depth
    return bool(before.any())
