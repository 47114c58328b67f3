"""Scores of tracks in the world, and of meetings with own ship."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.core.arrays import NOBODY, Array
from modsim3d.core.errors import ModsimError
from modsim3d.core.statistics import t_bounds
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracking.detector_seeds import LEVEL
from modsim3d.tracking.scores.errors import GospaParts, mean_gospa, nees_or_infinity
from modsim3d.tracking.scores.scored_run import SetDistance
from modsim3d.tracking.scores.trajectories import TGospaParts, TrajectorySets, ospa2, t_gospa
from modsim3d.tracking.world.collision import (
    ENCOUNTER_M,
    CpaRules,
    MetVessel,
    PredictedApproaches,
    met_vessels,
    predicted_approaches,
)
from modsim3d.tracking.world.following import WorldMatching, WorldTruth, follow_in_world
from modsim3d.tracks.tracks import DEFAULT_GATE_M, WorldTracks


@dataclass(frozen=True)
class Quartiles:
    """Quartiles over encounters: a quarter of them is worse than `lower`, half than `median`, three quarters than
    `upper`. A vessel that is not established in time is worse than all others; None for a quartile at such a vessel."""

    lower: float | None
    median: float | None
    upper: float | None


def quartiles(values: list[float | None]) -> Quartiles:
    """Quartiles of values, None for never; of n values each is one of them, the lower of two."""
    if not values:
        return Quartiles(None, None, None)
    numbers: Array = np.array([-np.inf if value is None else value for value in values])
    cuts = np.quantile(numbers, (0.25, 0.5, 0.75), method="inverted_cdf").tolist()
    return Quartiles(*(value if np.isfinite(value) else None for value in cuts))


@dataclass(frozen=True)
class VesselMean:
    """A mean over vessels, each with one value, however long it was followed."""

    mean: float | None  # None without vessels
    low: float | None  # of the 95 % t-interval of the mean; None with fewer than two vessels, or if all have one value
    high: float | None
    vessels: int

    @classmethod
    def of(cls, values: Array) -> Self:
        """The mean of the values of n vessels, shape (n,); NaN for a vessel that has none."""
        values = values[~np.isnan(values)]
        low, high = t_bounds(values, (1 - LEVEL) / 2) or (None, None)
        return cls(float(values.mean()) if len(values) else None, low, high, len(values))


@dataclass(frozen=True)
class WorldErrors:
    """Errors of the tracks that follow a scored vessel, as means over vessels."""

    rmse_m: VesselMean  # root of a vessel's mean squared error of position
    rmse_m_s: VesselMean  # of velocity, where tracks have one
    nees: VesselMean  # mean squared error of position over its covariance, e' P⁻¹ e: 2 if the covariance is right
    nees_velocity: VesselMean  # of velocity: 2
    nees_state: VesselMean  # of position and velocity together, where tracks have the whole covariance: 4
    pairs: int  # estimates that are compared, over all vessels and steps


def world_errors(following: WorldMatching) -> WorldErrors:
    """The errors of all pairs."""
    truth, tracks = following.truth, following.tracks
    step, vessel = np.nonzero(following.found)
    row = following.followed_by[step, vessel]
    times_s = tracks.time_s[row]
    position = tracks.position_m[row] - truth.positions_at(times_s, vessel)
    velocity = tracks.velocity_m_s[row] - truth.velocities_at(times_s, vessel)
    covariance = tracks.covariance[row]

    def by_vessel(values: Array) -> Array:
        """Mean of each vessel's values that are not NaN, NaN for none, shape (V,)."""
        valid = ~np.isnan(values)
        count = np.bincount(vessel[valid], minlength=len(truth.names))
        total = np.bincount(vessel[valid], values[valid], minlength=len(truth.names))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    whole = nees_or_infinity(np.concatenate([position, velocity], axis=1), covariance)
    return WorldErrors(
        rmse_m=VesselMean.of(np.sqrt(by_vessel((position**2).sum(axis=1)))),
        rmse_m_s=VesselMean.of(np.sqrt(by_vessel((velocity**2).sum(axis=1)))),
        nees=VesselMean.of(by_vessel(nees_or_infinity(position, covariance[:, :2, :2]))),
        nees_velocity=VesselMean.of(by_vessel(nees_or_infinity(velocity, covariance[:, 2:, 2:]))),
        nees_state=VesselMean.of(by_vessel(whole)),
        pairs=len(row),
    )


@dataclass(frozen=True)
class WorldContinuity:
    """Continuity over the steps at which vessels are scored."""

    vessels: int  # scored at some step
    established: int  # those that are followed at one of these steps
    followed_share: VesselMean  # share of a vessel's scored steps at which it is followed
    id_switches: int  # times at which a vessel is followed by another track than when it was followed last
    track_breaks: int  # stretches of scored steps without a track, between two with one
    false_tracks: int  # tracks that never follow a vessel, scored or not
    false_track_s: float  # their time, that of the steps at which they are there


def world_continuity(following: WorldMatching) -> WorldContinuity:
    """Continuity of all vessels, and false tracks."""
    scored, matches = following.truth.scored, following.found
    steps, followed = scored.sum(axis=0), matches.sum(axis=0)
    share = np.where(steps > 0, followed / np.maximum(steps, 1), np.nan)
    tracks = following.tracks.track[following.estimates.row]
    false = ~np.isin(tracks, tracks[following.vessel != NOBODY])
    gaps_s = np.diff(following.truth.times_s)  # the last step is taken to be as long as the one before it
    length_s = np.append(gaps_s, gaps_s[-1]) if len(gaps_s) else np.zeros(len(following.truth.times_s))
    pairs = [_switches_and_breaks(following, vessel) for vessel in np.flatnonzero(followed).tolist()]
    return WorldContinuity(
        vessels=int((steps > 0).sum()),
        established=int((followed > 0).sum()),
        followed_share=VesselMean.of(share),
        id_switches=sum(switches for switches, _ in pairs),
        track_breaks=sum(breaks for _, breaks in pairs),
        false_tracks=len(np.unique(tracks[false])),
        false_track_s=float(length_s[following.estimates.step[false]].sum()),
    )


def _switches_and_breaks(following: WorldMatching, vessel: int) -> tuple[int, int]:
    """Switches and breaks of a vessel that is followed at some step."""
    row = following.followed_by[following.truth.scored[:, vessel], vessel]
    on = row != NOBODY
    switches = int((np.diff(following.tracks.track[row[on]]) != 0).sum())
    begins = int((np.diff(on.astype(np.int64)) == 1).sum())  # each but one that ends the wait before the first
    return switches, begins - int(not on[0])


IN_METRES = SetDistance(cutoff=50.0)  # GOSPA's c and p by default
OSPA2_WINDOW_S = 30.0  # so long are the windows of OSPA(2)
_DIMENSIONS = {"nees": 2, "nees_velocity": 2, "nees_state": 4}


@dataclass(frozen=True)
class WorldScores:
    """Scores of tracks in the world."""

    gate_m: float  # a track farther from a vessel than that does not follow it
    set_distance: SetDistance  # c in metres and p of GOSPA
    errors: WorldErrors  # of tracks that follow a vessel
    gospa: GospaParts | None  # mean over steps, in metres, its parts in metres to the power p; None without steps
    t_gospa: TGospaParts | None  # for each step, in the same units; None without steps
    ospa2: float | None  # mean over windows, in metres; None without steps
    continuity: WorldContinuity
    encounters: tuple[MetVessel, ...]  # the vessels that met own ship, in the order of the vessels
    approaches: PredictedApproaches  # theirs, as tracks predict them

    def flat(self) -> dict[str, float | int | None]:
        """All numbers by their names, flat, as JSON has them. docs/world_tracks.md says what they mean."""
        errors, continuity = self.errors, self.continuity
        nees = {"nees": errors.nees, "nees_velocity": errors.nees_velocity, "nees_state": errors.nees_state}
        gospa = ("gospa_m", "gospa_localisation_m", "gospa_missed_m", "gospa_false_m")
        of_tracks = (*(f"t_{name}" for name in gospa), "t_gospa_switch_m")
        return {
            **_mean_keys("rmse_m", errors.rmse_m),
            **_mean_keys("rmse_m_s", errors.rmse_m_s),
            **{key: value for name, stat in nees.items() for key, value in _mean_keys(name, stat).items()},
            **{f"a{name}": None if stat.mean is None else stat.mean / _DIMENSIONS[name] for name, stat in nees.items()},
            "pairs": errors.pairs,
            **dict(zip(gospa, self.gospa or (None,) * len(gospa), strict=True)),
            **dict(zip(of_tracks, self.t_gospa or (None,) * len(of_tracks), strict=True)),
            "ospa2_m": self.ospa2,
            "vessels": continuity.vessels,
            "established": continuity.established,
            **_mean_keys("followed_share", continuity.followed_share),
            **{name: getattr(continuity, name) for name in ("id_switches", "track_breaks", "false_tracks")},
            "false_track_s": continuity.false_track_s,
            **self._encounter_keys(),
            **self.approaches.flat(),
        }

    def _encounter_keys(self) -> Mapping[str, float | int | None]:
        met = [encounter for encounter in self.encounters if encounter.expected]
        keys: dict[str, float | int | None] = {"encounters": len(met)}
        keys["encounters_established"] = sum(encounter.in_time for encounter in met)
        for name in ("established_m", "time_left_s"):
            spread = quartiles([getattr(encounter, name) if encounter.in_time else None for encounter in met])
            keys |= {name: spread.median, f"{name}_lower": spread.lower, f"{name}_upper": spread.upper}
        return keys


def score_world(
    run: StoredRun | RunRows,
    world_tracks: WorldTracks,
    gate_m: float = DEFAULT_GATE_M,
    set_distance: SetDistance = IN_METRES,
    encounter_m: float = ENCOUNTER_M,
    cpa: Mapping[str, float] | None = None,
) -> WorldScores:
    """Score tracks in the world against the vessels of a run.

    Args:
        run: The run, or its rows.
        world_tracks: The tracks.
        gate_m: A track farther from a vessel than that does not follow it.
        set_distance: c in metres, p and γ of GOSPA, T-GOSPA and OSPA(2).
        encounter_m: A vessel whose closest approach to own ship is farther has not met her.
        cpa: Limits for closest approaches as tracks predict them: `right_m`, `before_s`, `alarm_m`, see `CpaRules`.

    Raises:
        ModsimError: A distance is out of range.
    """
    for name, value in (("--gate", gate_m), ("encounter_m", encounter_m)):
        if not 0 < value < np.inf:
            raise ModsimError(f"{name} must be above 0 metres (got {value:g})")
    rows = run if isinstance(run, RunRows) else RunRows.of(run)
    following = follow_in_world(WorldTruth.of(rows), world_tracks, gate_m)
    rule, frames, times_s = set_distance, [*following.scored_frames()], following.truth.times_s
    sets = TrajectorySets.of(frames, rule.cutoff)
    met = met_vessels(following, encounter_m)
    window = round(OSPA2_WINDOW_S / float(np.median(np.diff(times_s)))) if len(times_s) > 1 else 1
    return WorldScores(
        gate_m=gate_m,
        set_distance=rule,
        errors=world_errors(following),
        gospa=mean_gospa((apart for _, _, apart in frames), rule.cutoff, rule.power),
        t_gospa=t_gospa(sets, rule.power, rule.cutoff if rule.switch is None else rule.switch),
        ospa2=ospa2(sets, rule.power, max(window, 1)),
        continuity=world_continuity(following),
        encounters=met,
        approaches=predicted_approaches(following, met, CpaRules.of(cpa or {})),
    )


def _mean_keys(name: str, value: VesselMean) -> Mapping[str, float | None]:
    return {name: value.mean, f"{name}_low": value.low, f"{name}_high": value.high}
