"""All scores of tracks in the world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from modsim3d.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracking.scores.point_sets import GospaParts, mean_gospa
from modsim3d.tracking.scores.rules import SetDistance
from modsim3d.tracking.world.continuity import WorldContinuity, world_continuity
from modsim3d.tracking.world.encounters import ENCOUNTER_M, MetVessel, met_vessels, quartiles
from modsim3d.tracking.world.errors import OverVessels, WorldErrors, world_errors
from modsim3d.tracking.world.following import follow_in_world
from modsim3d.tracking.world.truth import WorldTruth
from modsim3d.tracks.world_tracks import WorldTracks

DEFAULT_GATE_M = 50.0
"""A track farther from a vessel than that does not follow it."""
IN_METRES = SetDistance(cutoff=50.0)
"""GOSPA's c and p by default."""
_DIMENSIONS = {"nees": 2, "nees_velocity": 2, "nees_state": 4}


@dataclass(frozen=True)
class WorldScores:
    """Scores of tracks in the world.

    Attributes:
        gate_m: A track farther from a vessel than that does not follow it.
        set_distance: c in metres and p of GOSPA.
        errors: Of tracks that follow a vessel.
        gospa: Mean over the run's steps, in metres, and its parts; None without steps.
        continuity: How much is followed, and tracks of nothing.
        encounters: The vessels that met own ship, in the order of the vessels.
    """

    gate_m: float
    set_distance: SetDistance
    errors: WorldErrors
    gospa: GospaParts | None
    continuity: WorldContinuity
    encounters: tuple[MetVessel, ...]

    def flat(self) -> dict[str, float | int | None]:
        """All numbers by their names, flat, as JSON has them. docs/world_tracks.md says what they mean."""
        errors, continuity = self.errors, self.continuity
        nees = {"nees": errors.nees, "nees_velocity": errors.nees_velocity, "nees_state": errors.nees_state}
        return {
            **_mean_keys("rmse_m", errors.rmse_m),
            **_mean_keys("rmse_m_s", errors.rmse_m_s),
            **{key: value for name, each in nees.items() for key, value in _mean_keys(name, each).items()},
            **{f"a{name}": _over(each.mean, _DIMENSIONS[name]) for name, each in nees.items()},
            "pairs": errors.pairs,
            **_gospa_keys(self.gospa),
            "vessels": continuity.vessels,
            "established": continuity.established,
            **_mean_keys("followed_share", continuity.followed_share),
            "id_switches": continuity.id_switches,
            "track_breaks": continuity.track_breaks,
            "false_tracks": continuity.false_tracks,
            "false_track_s": continuity.false_track_s,
            **self._encounter_keys(),
        }

    def _encounter_keys(self) -> Mapping[str, float | int | None]:
        met = [each for each in self.encounters if each.expected]
        distance, left = (
            quartiles([getattr(each, name) if each.in_time else None for each in met])
            for name in ("established_m", "time_left_s")
        )
        return {
            "encounters": len(met),
            "encounters_established": sum(each.in_time for each in met),
            "established_m": distance.median,
            "established_m_lower": distance.lower,
            "established_m_upper": distance.upper,
            "time_left_s": left.median,
            "time_left_s_lower": left.lower,
            "time_left_s_upper": left.upper,
        }


def score_world(
    run: StoredRun | RunRows,
    world_tracks: WorldTracks,
    gate_m: float = DEFAULT_GATE_M,
    set_distance: SetDistance = IN_METRES,
    encounter_m: float = ENCOUNTER_M,
) -> WorldScores:
    """Score tracks in the world against the vessels of a run.

    Args:
        run: The run, or its rows.
        world_tracks: The tracks.
        gate_m: A track farther from a vessel than that does not follow it.
        set_distance: c in metres and p of GOSPA.
        encounter_m: A vessel whose closest approach to own ship is farther has not met her.

    Raises:
        ModsimError: A distance is out of range.
    """
    for name, value in (("--gate", gate_m), ("encounter_m", encounter_m)):
        if not 0 < value < np.inf:
            raise ModsimError(f"{name} must be above 0 metres (got {value:g})")
    rows = run if isinstance(run, RunRows) else RunRows.of(run)
    following = follow_in_world(WorldTruth.of(rows), world_tracks, gate_m)
    return WorldScores(
        gate_m=gate_m,
        set_distance=set_distance,
        errors=world_errors(following),
        gospa=mean_gospa(following.scored_distances(), set_distance.cutoff, set_distance.power),
        continuity=world_continuity(following),
        encounters=met_vessels(following, encounter_m),
    )


def _mean_keys(name: str, value: OverVessels) -> Mapping[str, float | None]:
    return {name: value.mean, f"{name}_low": value.low, f"{name}_high": value.high}


def _gospa_keys(parts: GospaParts | None) -> Mapping[str, float | None]:
    """GOSPA in metres, and its parts in metres to the power p."""
    values = parts or (None, None, None, None)
    names = ("gospa_m", "gospa_localisation_m", "gospa_missed_m", "gospa_false_m")
    return dict(zip(names, values, strict=True))


def _over(value: float | None, dimensions: int) -> float | None:
    return None if value is None else value / dimensions
