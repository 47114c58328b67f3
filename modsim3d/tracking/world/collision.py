"""Vessels that met own ship: how near they came, when a camera saw them and a track followed them; and closest
approaches as tracks predict them: errors of CPA and TCPA, and alarms that were missed or false."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.kinematics import closest_approach
from modsim3d.io.validation import nearest, shown
from modsim3d.tracking.world.following import WorldMatching, WorldTruth
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


def met_vessels(following: WorldMatching, within_m: float = ENCOUNTER_M) -> tuple[MetVessel, ...]:
    """All encounters of own ships, in the order of own ships and vessels. A vessel that only draws away from own ship,
    since both are there, has not met her."""
    own_ships = following.truth.own_ships
    vessels = [index for index in range(len(following.truth.names)) if index not in own_ships]
    return tuple(met for own in own_ships for vessel in vessels for met in _meetings(following, own, vessel, within_m))


def _meetings(following: WorldMatching, own: int, vessel: int, within_m: float) -> Iterator[MetVessel]:
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


def _established_s(following: WorldMatching, vessel: int) -> float | None:
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


TIMES_LEFT_S = (15.0, 30.0, 60.0, 120.0, 240.0)
RANGE_EDGES_M = (0.0, 200.0, 500.0, 1000.0, 2000.0, np.inf)


@dataclass(frozen=True)
class CpaRules:
    """Limits of what is said of predicted closest approaches."""

    right_m: float = 100.0  # a predicted distance is right if it is off by no more than that
    before_s: float = 60.0  # so long before the closest approach the keys of the scores are taken
    alarm_m: float = 200.0  # a predicted distance below that is an alarm

    def __post_init__(self) -> None:
        """Raise ModsimError if a limit is out of range."""
        for name, value in vars(self).items():
            if not 0 < value < np.inf:
                raise ModsimError(f"cpa: {name} must be above 0 (got {value:g})")

    @classmethod
    def of(cls, limits: Mapping[str, float]) -> CpaRules:
        """Limits by their names, the others as usual. Raises ModsimError for another name."""
        names = [field.name for field in fields(cls)]
        for name in limits:
            if name not in names:
                raise ModsimError(f"cpa: unknown key {shown(name)} ({nearest(str(name), names)})")
        return cls(**limits)


@dataclass(frozen=True)
class CpaErrors:
    """Median absolute errors over encounters, each with its own median; None without any. A perfect track has the
    vessel's true position and velocity at the same times: it is off as far as one of both alters course or speed."""

    place: float  # seconds left until the closest approach, or the least distance from own ship
    predicted: int  # encounters with a prediction there
    cpa_error_m: float | None  # of the predicted distance at the closest approach
    tcpa_error_s: float | None  # of its predicted time
    perfect_cpa_error_m: float | None


@dataclass(frozen=True)
class CpaAtTime(CpaErrors):
    """Predictions of the last step that is so long before the closest approach."""

    in_view: int  # encounters of which a camera had seen the vessel by then: those that are counted here
    right: int  # those with a right distance
    alarms_due: int  # those whose true distance is below that of an alarm
    missed_alarms: int  # of these, those without an alarm: predicted too far, or not at all
    false_alarms: int  # alarms on vessels that passed farther away


@dataclass(frozen=True)
class PredictedApproaches:
    """Closest approaches as tracks predict them. The truth is what really happened: the least distance of the centres
    in the run, and its time, after all that own ship and the vessel did in between."""

    rules: CpaRules
    by_time_left: tuple[CpaAtTime, ...]  # that of the rules among them, ascending
    by_range: tuple[CpaErrors, ...]  # from each distance to the next, at all steps before the closest approach
    ghost_alarms: int  # tracks that never follow a vessel, with an alarm that is less than `before_s` away

    def flat(self) -> dict[str, float | int | None]:
        """Keys of the scores: at `before_s` before the closest approach."""
        at = next(cpa for cpa in self.by_time_left if cpa.place == self.rules.before_s)
        names = ("in_view", "predicted", "alarms_due", "missed_alarms", "false_alarms")
        return {
            "cpa_right_share": at.right / at.in_view if at.in_view else None,
            "cpa_error_m": at.cpa_error_m,
            "tcpa_error_s": at.tcpa_error_s,
            **{f"cpa_{name}": getattr(at, name) for name in names},
            "cpa_ghost_alarms": self.ghost_alarms,
        }


def predicted_approach(place_m: Array, velocity_m_s: Array) -> tuple[Array, Array]:
    """CPA in metres and TCPA in seconds of vessels that keep course and speed, from their places and velocities
    relative to own ship, shapes (n, 2) to (n,). Those that draw away, or keep their distance, are nearest now."""
    speed2, closing = (velocity_m_s**2).sum(axis=1), -(place_m * velocity_m_s).sum(axis=1)
    tcpa_s = np.maximum(closing / np.where(speed2 > 0, speed2, 1.0), 0.0)
    return np.hypot(*(place_m + tcpa_s[:, None] * velocity_m_s).T), np.where(np.isnan(speed2), np.nan, tcpa_s)


@dataclass(frozen=True, eq=False)
class _Predictions:
    """Predictions for n pairs of an encounter and a step at which a track with a velocity follows the vessel; (n,)."""

    encounter: Indices
    step: Indices
    range_m: Array  # true distance
    cpa_m: Array  # predicted
    errors: Array  # absolute errors of CPA and TCPA, and that of the CPA of a perfect track, (n, 3)

    def errors_of(self, place: float, chosen: Mask) -> tuple[float | int | None, ...]:
        names, errors = self.encounter[chosen], self.errors[chosen]
        medians = [np.median(errors[names == name], axis=0) for name in np.unique(names)]
        return place, len(medians), *(np.median(medians, axis=0).tolist() if medians else [None] * errors.shape[1])


def predicted_approaches(
    following: WorldMatching, encounters: Sequence[MetVessel], rules: CpaRules
) -> PredictedApproaches:
    """Closest approaches as tracks predict them, of the vessels that passed and that a camera saw before."""
    met = [event for event in encounters if event.expected]
    cpas = _predictions(following, met)
    times_left_s = sorted({*TIMES_LEFT_S, rules.before_s})
    return PredictedApproaches(
        rules,
        tuple(_at_time(following, met, cpas, left_s, rules) for left_s in times_left_s),
        tuple(
            CpaErrors(*cpas.errors_of(low, (cpas.range_m >= low) & (cpas.range_m < high)))  # type: ignore[arg-type]
            for low, high in pairwise(RANGE_EDGES_M)
        ),
        _ghost_alarms(following, rules),
    )


def _predictions(following: WorldMatching, met: Sequence[MetVessel]) -> _Predictions:
    truth, tracks, names = following.truth, following.tracks, following.truth.names
    parts = [(np.zeros(0, dtype=np.int64),) * 2 + (np.zeros(0),) * 2 + (np.zeros((0, 3)),)]
    for index, event in enumerate(met):
        own, vessel = names.index(event.own_ship), names.index(event.vessel)
        step = np.flatnonzero(following.found[:, vessel] & (truth.times_s < event.closest_s))
        row = following.followed_by[step, vessel]
        finite = np.isfinite(tracks.velocity_m_s[row]).all(axis=1)
        step, row = step[finite], row[finite]
        times_s = tracks.time_s[row]
        (own_m, own_m_s), true = (_true(following, times_s, one) for one in (own, vessel))
        cpa_m, tcpa_s = predicted_approach(tracks.position_m[row] - own_m, tracks.velocity_m_s[row] - own_m_s)
        perfect_m, _ = predicted_approach(true[0] - own_m, true[1] - own_m_s)
        errors = (cpa_m - event.closest_m, times_s + tcpa_s - event.closest_s, perfect_m - event.closest_m)
        range_m = np.hypot(*(true[0] - own_m).T)
        parts.append((np.full(len(row), index), step, range_m, cpa_m, np.abs(np.column_stack(errors))))
    return _Predictions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _true(following: WorldMatching, times_s: Array, vessel: int) -> tuple[Array, Array]:
    """True places and velocities of a vessel at n times, shape (n, 2) each."""
    every = np.full(len(times_s), vessel)
    return following.truth.positions_at(times_s, every), following.truth.velocities_at(times_s, every)


def _at_time(
    following: WorldMatching, met: Sequence[MetVessel], cpas: _Predictions, left_s: float, rules: CpaRules
) -> CpaAtTime:
    numbers = np.array([(event.closest_m, event.seen_s, event.closest_s - left_s) for event in met], dtype=np.float64)
    closest_m, seen_s, wanted_s = numbers.reshape(-1, 3).T
    in_view = seen_s <= wanted_s
    step = np.searchsorted(following.truth.times_s, wanted_s, side="right") - 1
    here = in_view[cpas.encounter] & (cpas.step == step[cpas.encounter])
    cpa_m = np.full(len(met), np.nan)
    cpa_m[cpas.encounter[here]] = cpas.cpa_m[here]
    due, alarm = in_view & (closest_m < rules.alarm_m), cpa_m < rules.alarm_m
    right = np.abs(cpa_m - closest_m) <= rules.right_m
    counts = (in_view, right, due, due & ~alarm, alarm & ~due)
    return CpaAtTime(*cpas.errors_of(left_s, here), *(int(mask.sum()) for mask in counts))  # type: ignore[arg-type]


def _ghost_alarms(following: WorldMatching, rules: CpaRules) -> int:
    """Number of tracks that never follow a vessel and predict an alarm for some own ship."""
    tracks, row = following.tracks, following.estimates.row
    row = row[~np.isin(tracks.track[row], tracks.track[row[following.vessel != NOBODY]])]
    alarm = np.zeros(len(row), dtype=bool)
    for own in following.truth.own_ships:
        own_m, own_m_s = _true(following, tracks.time_s[row], own)
        cpa_m, tcpa_s = predicted_approach(tracks.position_m[row] - own_m, tracks.velocity_m_s[row] - own_m_s)
        alarm |= (cpa_m < rules.alarm_m) & (tcpa_s < rules.before_s)
    return len(np.unique(tracks.track[row[alarm]]))
