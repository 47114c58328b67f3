"""Closest approaches as tracks predict them: errors of CPA and TCPA, and alarms that were missed or false."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.io.validation import nearest, shown
from modsim3d.tracking.world.following import WorldFollowing
from modsim3d.tracking.world.met_vessels import MetVessel

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
        known = [field.name for field in fields(cls)]
        for name in limits:
            if name not in known:
                raise ModsimError(f"cpa: unknown key {shown(name)} ({nearest(str(name), known)})")
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
        at = next(each for each in self.by_time_left if each.place == self.rules.before_s)
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
        each = [np.median(errors[names == name], axis=0) for name in np.unique(names)]
        return place, len(each), *(np.median(each, axis=0).tolist() if each else [None] * errors.shape[1])


def predicted_approaches(
    following: WorldFollowing, encounters: Sequence[MetVessel], rules: CpaRules
) -> PredictedApproaches:
    """Closest approaches as tracks predict them, of the vessels that passed and that a camera saw before."""
    met = [each for each in encounters if each.expected]
    found = _predictions(following, met)
    times_left_s = sorted({*TIMES_LEFT_S, rules.before_s})
    return PredictedApproaches(
        rules,
        tuple(_at_time(following, met, found, left_s, rules) for left_s in times_left_s),
        tuple(
            CpaErrors(*found.errors_of(low, (found.range_m >= low) & (found.range_m < high)))  # type: ignore[arg-type]
            for low, high in pairwise(RANGE_EDGES_M)
        ),
        _ghost_alarms(following, rules),
    )


def _predictions(following: WorldFollowing, met: Sequence[MetVessel]) -> _Predictions:
    truth, tracks, names = following.truth, following.tracks, following.truth.names
    parts = [(np.zeros(0, dtype=np.int64),) * 2 + (np.zeros(0),) * 2 + (np.zeros((0, 3)),)]
    for index, each in enumerate(met):
        own, vessel = names.index(each.own_ship), names.index(each.vessel)
        step = np.flatnonzero(following.found[:, vessel] & (truth.times_s < each.closest_s))
        row = following.followed_by[step, vessel]
        known = np.isfinite(tracks.velocity_m_s[row]).all(axis=1)
        step, row = step[known], row[known]
        times_s = tracks.time_s[row]
        (own_m, own_m_s), true = (_true(following, times_s, one) for one in (own, vessel))
        cpa_m, tcpa_s = predicted_approach(tracks.position_m[row] - own_m, tracks.velocity_m_s[row] - own_m_s)
        perfect_m, _ = predicted_approach(true[0] - own_m, true[1] - own_m_s)
        errors = (cpa_m - each.closest_m, times_s + tcpa_s - each.closest_s, perfect_m - each.closest_m)
        range_m = np.hypot(*(true[0] - own_m).T)
        parts.append((np.full(len(row), index), step, range_m, cpa_m, np.abs(np.column_stack(errors))))
    return _Predictions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _true(following: WorldFollowing, times_s: Array, vessel: int) -> tuple[Array, Array]:
    """True places and velocities of a vessel at n times, shape (n, 2) each."""
    every = np.full(len(times_s), vessel)
    return following.truth.positions_at(times_s, every), following.truth.velocities_at(times_s, every)


def _at_time(
    following: WorldFollowing, met: Sequence[MetVessel], found: _Predictions, left_s: float, rules: CpaRules
) -> CpaAtTime:
    numbers = np.array([(each.closest_m, each.seen_s, each.closest_s - left_s) for each in met], dtype=np.float64)
    closest_m, seen_s, wanted_s = numbers.reshape(-1, 3).T
    in_view = seen_s <= wanted_s
    step = np.searchsorted(following.truth.times_s, wanted_s, side="right") - 1
    here = in_view[found.encounter] & (found.step == step[found.encounter])
    cpa_m = np.full(len(met), np.nan)
    cpa_m[found.encounter[here]] = found.cpa_m[here]
    due, alarm = in_view & (closest_m < rules.alarm_m), cpa_m < rules.alarm_m
    right = np.abs(cpa_m - closest_m) <= rules.right_m
    counts = (in_view, right, due, due & ~alarm, alarm & ~due)
    return CpaAtTime(*found.errors_of(left_s, here), *(int(each.sum()) for each in counts))  # type: ignore[arg-type]


def _ghost_alarms(following: WorldFollowing, rules: CpaRules) -> int:
    """Number of tracks that never follow a vessel and predict an alarm for some own ship."""
    tracks, row = following.tracks, following.estimates.row
    row = row[~np.isin(tracks.track[row], tracks.track[row[following.vessel != NOBODY]])]
    alarm = np.zeros(len(row), dtype=bool)
    for own in following.truth.own_ships:
        own_m, own_m_s = _true(following, tracks.time_s[row], own)
        cpa_m, tcpa_s = predicted_approach(tracks.position_m[row] - own_m, tracks.velocity_m_s[row] - own_m_s)
        alarm |= (cpa_m < rules.alarm_m) & (tcpa_s < rules.before_s)
    return len(np.unique(tracks.track[row[alarm]]))
