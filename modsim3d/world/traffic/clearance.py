"""The waters in which traffic is planned: land, and the tracks of the vessels that have the right of way so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Indices
from modsim3d.geometry.kinematics import union_of
from modsim3d.world.bodies import Obstacle, solid_footprint
from modsim3d.world.traffic.tracks import Sweep, Track

BETWEEN = np.array([-0.375, -0.125, 0.125, 0.375])
"""Times within an interval, around the step, at which hulls that are close are compared."""
STRIDE = 8  # one step in so many is looked at to find those at which two hulls are near each other
SWING = 1.4  # a bow in a turn moves at most so much faster than the hull's centre: no radius is below 3/4 length


def rectangle_gaps(
    offset: Array, axes: Array, half: tuple[float, float], other_axes: Array, other_half: tuple[float, float]
) -> Array:
    """Widest gap between n pairs of rectangles along the normals of their sides in metres, shape (..., n). It is never
    more than their distance, and negative if they overlap. `offset` leads from the centres of the first rectangles to
    those of the others: (..., n, 2); the axes are unit vectors along their lengths: (n, 2); the halves are half length
    and half beam."""
    cosine = np.abs(axes[:, 0] * other_axes[:, 0] + axes[:, 1] * other_axes[:, 1])
    sine = np.abs(axes[:, 0] * other_axes[:, 1] - axes[:, 1] * other_axes[:, 0])
    gaps = []
    for axis, mine, opposite in ((axes, half, other_half), (other_axes, other_half, half)):
        ahead = np.abs(offset[..., 0] * axis[:, 0] + offset[..., 1] * axis[:, 1])
        abeam = np.abs(offset[..., 0] * axis[:, 1] - offset[..., 1] * axis[:, 0])
        gaps += [
            ahead - mine[0] - cosine * opposite[0] - sine * opposite[1],
            abeam - mine[1] - sine * opposite[0] - cosine * opposite[1],
        ]
    widest: Array = np.maximum.reduce(gaps)
    return widest


def least_gaps(sweep: Sweep, other: Sweep, interval_s: float, within_m: float) -> tuple[Array, Indices]:
    """Least gap between each of C tracks and one other over all times, and the step of it, both (C,). A gap is a lower
    bound of the hulls' distance, between steps too. Those above `within_m` are infinite, with step 0."""
    speed = (sweep.speeds_m_s + other.speeds_m_s[0]) * SWING * interval_s
    reach = sweep.hull.reach_m + other.hull.reach_m + within_m
    least, step = np.full(len(sweep.tracks), np.inf), np.zeros(len(sweep.tracks), dtype=np.int64)
    rows, steps = _near_steps(sweep, other, reach, speed)
    if not len(rows):
        return least, step
    axes, other_axes = sweep.axes[rows, steps], other.axes[0, steps]
    drift = other_axes * other.speeds_m_s[0] - axes * sweep.speeds_m_s[rows, None]
    offsets = other.places_m[0, steps] - sweep.places_m[rows, steps] + (BETWEEN * interval_s)[:, None, None] * drift
    gaps = rectangle_gaps(offsets, axes, sweep.hull.half_m, other_axes, other.hull.half_m).min(axis=0)
    gaps -= speed[rows] / 8
    gaps[gaps > within_m] = np.inf
    order = np.lexsort((steps, gaps, rows))
    first = order[np.unique(rows[order], return_index=True)[1]]
    least[rows[first]], step[rows[first]] = gaps[first], steps[first]
    return least, step


def _near_steps(sweep: Sweep, other: Sweep, reach_m: float, speed_m: Array) -> tuple[Indices, Indices]:
    """Tracks and steps at which two hulls could come within reach during the interval around the step. `speed_m` is how
    far they can move against each other in an interval: (C,). Few steps are looked at first."""
    times = sweep.present.shape[1]
    middles = np.minimum(np.arange(STRIDE // 2, times + STRIDE // 2, STRIDE), times - 1)
    offset = sweep.places_m[:, middles] - other.places_m[:, middles]
    around = (reach_m + speed_m * (STRIDE + 1) / 2)[:, None] ** 2
    coarse = offset[..., 0] ** 2 + offset[..., 1] ** 2 < around
    if not coarse.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    near = np.repeat(coarse, STRIDE, axis=1)[:, :times]
    rows, steps = np.nonzero(near & sweep.present & other.present)
    offset = sweep.places_m[rows, steps] - other.places_m[0, steps]
    close = offset[:, 0] ** 2 + offset[:, 1] ** 2 < (reach_m + speed_m[rows] / 2) ** 2
    return rows[close], steps[close]


@dataclass(frozen=True, eq=False)
class Land:
    """Land that vessels must keep clear of on a map, by the height of its lower side: (height, footprint), rising."""

    levels: tuple[tuple[float, shapely.Geometry], ...]

    @classmethod
    def of(cls, obstacles: Sequence[Obstacle]) -> Land:
        """The footprints of all solids that reach above the sea."""
        areas: dict[float, list[shapely.Geometry]] = {}
        for obstacle in obstacles:
            for solid, vertices in obstacle.solids:
                if vertices[:, 2].max() > 0:
                    base = max(float(vertices[:, 2].min()), 0.0)
                    areas.setdefault(base, []).append(solid_footprint(solid, vertices))
        levels, so_far = [], shapely.Polygon()
        for base in sorted(areas):
            so_far = union_of([so_far, *areas[base]])
            shapely.prepare(so_far)
            levels.append((base, so_far))
        return cls(tuple(levels))

    def below(self, air_draft_m: float) -> shapely.Geometry:
        """Footprint of all that stands in the way of a vessel of an air draft; bridges above her mast do not."""
        return next((area for base, area in reversed(self.levels) if base < air_draft_m), shapely.Polygon())

    def gaps(self, sweep: Sweep, interval_s: float, within_m: float) -> Array:
        """Least distance of each of C tracks to land in metres, shape (C,); more than `within_m` is infinite."""
        area = self.below(sweep.hull.air_draft_m)
        least = np.full(len(sweep.tracks), np.inf)
        if area.is_empty:
            return least
        for row, (places, axes) in enumerate(zip(sweep.places_m, sweep.axes, strict=True)):
            present = sweep.present[row]
            margin = float(sweep.speeds_m_s[row]) * SWING * interval_s / 2
            limit = sweep.hull.reach_m + within_m + margin
            line = np.repeat(places[present], 2, axis=0)  # twice, so that one place alone is a line too
            if not present.any() or shapely.distance(shapely.LineString(line), area) > limit:
                continue
            close = np.flatnonzero(present)[shapely.dwithin(shapely.points(places[present]), area, limit)]
            hulls = shapely.polygons(corners(places[close], axes[close], sweep.hull.half_m))
            least[row] = shapely.distance(hulls, area).min(initial=np.inf) - margin
        least[least > within_m] = np.inf
        return least


def corners(places: Array, axes: Array, half: tuple[float, float]) -> Array:
    """Corners of n rectangles, shape (n, 4, 2)."""
    along, across = axes * half[0], np.stack([-axes[:, 1], axes[:, 0]], axis=-1) * half[1]
    return places[:, None] + np.stack([along + across, along - across, -along - across, across - along], axis=1)


COMFORT, LAND_COMFORT = 0.4, 0.5  # shares of both their lengths that vessels want between them, and to land
CROWDING = 3.0  # cost of touching, beside those of changes that avoid it; nothing at a comfortable distance
SMALL_CHANGE = 1.5  # cost up to which a changed track is taken without a look at larger changes
MAX_INTERVAL_S = 1.0
LAND_WORK, PAIR_WORK, MAX_WORK = 20, 2_000, 3_000_000_000
"""Comparing a place with land, as other vessels; comparing two vessels at all, as places; and the work that may be done
for a drive: about a minute."""


class CrowdedSea(Exception):
    """So many ways have been compared that the vessels cannot be meant to have room."""


@dataclass(frozen=True)
class TrackClearance:
    """Rating of the best of some tracks."""

    track: Track | None  # the best one; None if none keeps clear
    crowding: float  # what near misses add to its cost; 0 at comfortable distances
    conflict_s: float | None  # time of the least gap of the first track, if there is one


@dataclass(eq=False)
class Waters:
    """The map, the times and the vessels planned so far."""

    land: Land
    times_s: Array  # at which hulls are compared: (T,)
    interval_s: float
    clearance_m: float  # least water between hulls and to land
    fleet: list[Sweep] = field(default_factory=list)  # the vessels planned so far
    work: int = 0  # places that were compared with other vessels
    _places_m: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))

    @classmethod
    def during(cls, land: Land, duration_s: float, time_step_s: float, clearance_m: float) -> Waters:
        """Waters for a drive from time 0, compared at the scene's steps or at a few times a step, about a second apart.
        With steps of less than a second only some are compared: least distances hold at all times."""
        if time_step_s > MAX_INTERVAL_S:
            interval = time_step_s / math.ceil(time_step_s / MAX_INTERVAL_S)
        else:
            interval = time_step_s * math.floor(MAX_INTERVAL_S / time_step_s + 1e-9)
        count = math.ceil(duration_s / interval - 1e-9) + 2
        return cls(land, np.arange(count, dtype=np.float64) * interval, interval, clearance_m)

    @property
    def end_s(self) -> float:
        """End of the drive."""
        return float(self.times_s[-1])

    def add(self, track: Track) -> None:
        """Give a track the right of way over all that come later."""
        self.fleet.append(Sweep.of([track], self.times_s, self.interval_s))

    def judge(self, tracks: Sequence[Track]) -> TrackClearance:
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
        best, least, off_land = None, np.inf, self.clearance_m + LAND_COMFORT * sweep.hull.length_m
        for index in np.argsort(costs + crowding, kind="stable").tolist():
            if costs[index] + crowding[index] >= least:
                break  # land can only add to the cost
            gaps = self.land.gaps(sweep.row(index), self.interval_s, off_land)
            crowding[index] += _crowding(gaps, self.clearance_m, off_land)[0]
            if costs[index] + crowding[index] < least:
                best, least = index, costs[index] + crowding[index]
        if best is None:
            return TrackClearance(None, np.inf, conflict_s)
        return TrackClearance(tracks[best], float(crowding[best]), conflict_s)

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
        if self.work > MAX_WORK:
            raise CrowdedSea

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
        return np.flatnonzero(offset[:, 0] ** 2 + offset[:, 1] ** 2 < np.array(reach) ** 2).tolist()

    def best(self, first: Track, changes: Callable[[float | None], Iterable[Sequence[Track]]]) -> Track | None:
        """The first track, as drawn, if it keeps well clear, else the best of it and of the changed ones; None if none
        does. `changes` gives the changed tracks, small changes first, for the time of the first one's closest
        approach."""
        verdict = self.judge([first])
        if verdict.track is not None and verdict.crowding == 0:
            return first
        best, least = verdict.track, verdict.crowding
        for tracks in changes(verdict.conflict_s):
            trial = self.judge(tracks)
            if trial.track is not None and trial.track.cost + trial.crowding < least:
                best, least = trial.track, trial.track.cost + trial.crowding
            if least <= SMALL_CHANGE:
                break
        return best


def _crowding(gaps: Array, least_m: float, comfort_m: float) -> Array:
    """Cost of each of n least gaps; infinite below the least that is allowed."""
    near = np.clip((comfort_m - gaps) / max(comfort_m - least_m, 1e-9), 0.0, 1.0)
    return np.where(gaps < least_m, np.inf, CROWDING * near**2)
