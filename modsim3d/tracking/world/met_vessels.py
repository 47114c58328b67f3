"""Vessels that met own ship: how near they came, when a camera saw them, and when a track followed them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.geometry.kinematics import closest_approach
from modsim3d.tracking.world.following import WorldFollowing, WorldTruth
from modsim3d.world.encounters import encounter

ENCOUNTER_M = 1852.0  # one nautical mile: vessels that do not come nearer have not met own ship


@dataclass(frozen=True)
class MetVessel:
    """A vessel that came nearer to own ship, and how near: times in seconds since the scene's first step, distances
    of the centres."""

    own_ship: str  # ID
    vessel: str  # ID
    # What own ship has to do by COLREG when the vessel is first seen, or when both are first there if no camera sees it
    # before the closest approach: a name of `world.encounters.Encounter` in small letters.
    kind: str
    closest_m: float  # at the closest approach
    closest_s: float
    passed: bool  # whether both draw away again; otherwise the run ends, or one leaves, while they come nearer
    seen_s: float | None  # first step at which a camera sees the vessel; None if never
    seen_m: float | None  # distance from own ship then
    established_s: float | None  # first time at which a track follows it while a camera sees it; None if never
    established_m: float | None  # distance from own ship then
    time_left_s: float | None  # from then to the closest approach, negative after it

    @property
    def expected(self) -> bool:
        """Whether a tracker could have followed it in time: it passed, and a camera saw it before."""
        return self.passed and self.seen_s is not None and self.seen_s < self.closest_s

    @property
    def in_time(self) -> bool:
        """Whether a track followed it before the closest approach."""
        return self.time_left_s is not None and self.time_left_s > 0


def met_vessels(following: WorldFollowing, within_m: float = ENCOUNTER_M) -> tuple[MetVessel, ...]:
    """All encounters of own ships, in the order of own ships and vessels. A vessel that only draws away from own ship,
    since both are there, has not met her."""
    own_ships = following.truth.own_ships
    vessels = [index for index in range(len(following.truth.names)) if index not in own_ships]
    return tuple(met for own in own_ships for vessel in vessels for met in _met(following, own, vessel, within_m))


def _met(following: WorldFollowing, own: int, vessel: int, within_m: float) -> Iterator[MetVessel]:
    truth = following.truth
    centres_m, times_s = truth.hulls.centres_m, truth.times_s
    closest_m, closest_s = closest_approach(times_s, centres_m[:, own], centres_m[:, vessel])
    together = np.flatnonzero(np.isfinite(centres_m[:, [own, vessel]]).all(axis=(1, 2)))
    if not len(together) or closest_m > within_m or closest_s <= times_s[together[0]]:
        return
    seen = np.flatnonzero(truth.scored[:, vessel])
    first = seen[0] if len(seen) and times_s[seen[0]] < closest_s else together[0]
    established_s = _established_s(following, vessel)
    own_rad, vessel_rad = truth.hulls.headings_rad[first, [own, vessel]].tolist()
    kind = encounter(centres_m[first, own], own_rad, centres_m[first, vessel], vessel_rad)
    yield MetVessel(
        own_ship=truth.names[own],
        vessel=truth.names[vessel],
        kind=kind.name.lower(),
        closest_m=closest_m,
        closest_s=closest_s,
        passed=bool(closest_s < times_s[together[-1]]),
        seen_s=float(times_s[seen[0]]) if len(seen) else None,
        seen_m=_apart_m(truth, float(times_s[seen[0]]), own, vessel) if len(seen) else None,
        established_s=established_s,
        established_m=None if established_s is None else _apart_m(truth, established_s, own, vessel),
        time_left_s=None if established_s is None else closest_s - established_s,
    )


def _established_s(following: WorldFollowing, vessel: int) -> float | None:
    """Time at which a track is first on the vessel: that of its estimate, which may be later than the step."""
    steps = np.flatnonzero(following.found[:, vessel])
    if not len(steps):
        return None
    step = int(steps[0])
    row = following.followed_by[step, vessel]
    return float(max(following.truth.times_s[step], following.tracks.time_s[row]))


def _apart_m(truth: WorldTruth, time_s: float, own: int, vessel: int) -> float | None:
    """Distance of a vessel from own ship; None if one of them is not there."""
    one, other = truth.positions_at(np.full(2, time_s), np.array([own, vessel]))
    apart = float(np.hypot(*(other - one)))
    return apart if np.isfinite(apart) else None
