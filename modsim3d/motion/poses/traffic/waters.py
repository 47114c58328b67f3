"""The waters in which traffic is planned: land, and the tracks of the vessels that have the right of way so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from modsim3d.arrays import Array
from modsim3d.motion.poses.traffic.gaps import SWING, Land, least_gaps
from modsim3d.motion.poses.traffic.tracks import Sweep, Track

COMFORT = 0.4
"""Vessels want this share of their lengths, taken together, of water between them."""
LAND_COMFORT = 0.5
"""And this share of a length to land."""
CROWDING = 3.0
"""Cost of touching, beside the costs of the changes that avoid it; it falls to nothing at a comfortable distance."""
SMALL_CHANGE = 1.5
"""Cost up to which a changed track is taken without a look at larger changes."""
LONGEST_INTERVAL_S = 1.0
LAND_WORK, PAIR_WORK, MOST_WORK = 20, 2_000, 3_000_000_000
"""Comparing a place with land, as other vessels; comparing two vessels at all, as places; and the work that may be done
for a drive: about a minute."""


class TooCrowded(Exception):
    """So many ways have been compared that the vessels cannot be meant to have room."""


@dataclass(frozen=True)
class Verdict:
    """How good the best of some tracks is.

    Attributes:
        track: The best track; None if none keeps clear.
        crowding: What near misses add to its cost; 0 at comfortable distances.
        conflict_s: Time of the least gap of the first track, if there is one.
    """

    track: Track | None
    crowding: float
    conflict_s: float | None


@dataclass(eq=False)
class Waters:
    """The map, the times and the vessels planned so far.

    Attributes:
        land: What stands in the way.
        times_s: Times at which hulls are compared, shape (T,).
        interval_s: Interval between them.
        clearance_m: Least water between hulls and to land.
        fleet: The vessels planned so far.
        work: Places that were compared with other vessels.
    """

    land: Land
    times_s: Array
    interval_s: float
    clearance_m: float
    fleet: list[Sweep] = field(default_factory=list)
    work: int = 0
    _places_m: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))

    @classmethod
    def during(cls, land: Land, duration_s: float, time_step_s: float, clearance_m: float) -> Waters:
        """Waters for a drive from time 0, compared at the scene's steps or at a few times a step, about a second apart.

        With steps of less than a second only some are compared: least distances hold at all times.
        """
        if time_step_s > LONGEST_INTERVAL_S:
            interval = time_step_s / math.ceil(time_step_s / LONGEST_INTERVAL_S)
        else:
            interval = time_step_s * math.floor(LONGEST_INTERVAL_S / time_step_s + 1e-9)
        count = math.ceil(duration_s / interval - 1e-9) + 2
        return cls(land, np.arange(count, dtype=np.float64) * interval, interval, clearance_m)

    @property
    def end_s(self) -> float:
        """End of the drive."""
        return float(self.times_s[-1])

    def add(self, track: Track) -> None:
        """Give a track the right of way over all that come later."""
        self.fleet.append(Sweep.of([track], self.times_s, self.interval_s))

    def judge(self, tracks: Sequence[Track]) -> Verdict:
        """The best of some tracks of one hull: the least cost among those that keep clear at all times."""
        self._count(len(tracks) * len(self.times_s) * (len(self.fleet) + LAND_WORK) + PAIR_WORK * len(self.fleet))
        sweep = Sweep.of(tracks, self.times_s, self.interval_s)
        crowding, conflict_s, closest = np.zeros(len(tracks)), None, np.inf
        for other in self.fleet:
            comfort = self.clearance_m + COMFORT * (sweep.hull.length_m + other.hull.length_m)
            gaps, steps = least_gaps(sweep, other, self.interval_s, comfort)
            crowding += _crowding(gaps, self.clearance_m, comfort)
            if gaps[0] < closest:
                closest, conflict_s = gaps[0], float(self.times_s[steps[0]])
        costs = np.array([track.cost for track in tracks])
        best, least = None, np.inf
        for index in np.argsort(costs + crowding, kind="stable").tolist():
            if costs[index] + crowding[index] >= least:
                break  # land can only add to the cost
            crowding[index] += self._near_land(sweep.row(index))
            if costs[index] + crowding[index] < least:
                best, least = index, costs[index] + crowding[index]
        if best is None:
            return Verdict(None, np.inf, conflict_s)
        return Verdict(tracks[best], float(crowding[best]), conflict_s)

    def is_clear(self, track: Track, first_s: float, last_s: float) -> bool:
        """Whether a track keeps clear of all vessels from one time to another."""
        steps = slice(*np.searchsorted(self.times_s, (first_s, last_s)).tolist())
        if steps.start == steps.stop:
            return True
        sweep = Sweep.of([track], self.times_s[steps], self.interval_s)
        near = self._around(sweep, steps)
        self._count((steps.stop - steps.start) * len(self.fleet) + PAIR_WORK * len(near))
        for index in near:
            other = self.fleet[index].during(steps)
            if least_gaps(sweep, other, self.interval_s, self.clearance_m)[0][0] < self.clearance_m:
                return False
        return True

    def _count(self, work: int) -> None:
        self.work += work
        if self.work > MOST_WORK:
            raise TooCrowded

    def _around(self, sweep: Sweep, steps: slice) -> list[int]:
        """Vessels that a short track could come near, by the distance at its middle."""
        middle = (steps.start + steps.stop) // 2
        if len(self._places_m) != len(self.fleet):
            self._places_m = np.stack([other.places_m[0] for other in self.fleet])
        offset = self._places_m[:, middle] - sweep.places_m[0, middle - steps.start]
        time_s = (steps.stop - steps.start + 2) * self.interval_s / 2
        reach = [
            self.clearance_m
            + sweep.hull.reach_m
            + other.hull.reach_m
            + SWING * time_s * float(sweep.speeds_m_s[0] + other.speeds_m_s[0])
            for other in self.fleet
        ]
        near: list[int] = np.flatnonzero(offset[:, 0] ** 2 + offset[:, 1] ** 2 < np.array(reach) ** 2).tolist()
        return near

    def _near_land(self, sweep: Sweep) -> float:
        comfort = self.clearance_m + LAND_COMFORT * sweep.hull.length_m
        gaps = self.land.gaps(sweep, self.interval_s, comfort)
        return float(_crowding(gaps, self.clearance_m, comfort)[0])

    def best(self, first: Track, changes: Callable[[float | None], Iterable[Sequence[Track]]]) -> Track | None:
        """The first track if it keeps well clear, else the best of it and of the changed ones; None if none does.

        Args:
            first: The track as drawn.
            changes: Gives the changed tracks, small changes first, for the time of the first one's closest approach.
        """
        verdict = self.judge([first])
        if verdict.track is not None and verdict.crowding == 0:
            return first
        best, least = verdict.track, verdict.crowding
        for tracks in changes(verdict.conflict_s):
            found = self.judge(tracks)
            if found.track is not None and found.track.cost + found.crowding < least:
                best, least = found.track, found.track.cost + found.crowding
            if least <= SMALL_CHANGE:
                break
        return best


def _crowding(gaps: Array, least_m: float, comfort_m: float) -> Array:
    """Cost of each of n least gaps; infinite below the least that is allowed."""
    near = np.clip((comfort_m - gaps) / max(comfort_m - least_m, 1e-9), 0.0, 1.0)
    cost: Array = np.where(gaps < least_m, np.inf, CROWDING * near**2)
    return cost
