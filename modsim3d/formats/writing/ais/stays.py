"""The tracks of vessels' antennas at whole seconds, from the poses at the steps of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.formats.writing.ais.stations import Station
from modsim3d.scene.scene import Scene

BLOCK_STEPS = 1000
"""Steps whose poses are in memory together."""
NEAR_S = 1e-6
SPEED_WINDOW_S, TURN_WINDOW_S, REST_WINDOW_S = 5.0, 10.0, 30.0
"""Speed and course are means over the first, so that the roll of a mast does not look like speed; rate of turn over the
second; over the third it shows whether a vessel lies still."""
REST_M_S = 0.25
"""Half a knot: a slower vessel lies still."""


@dataclass(frozen=True, eq=False)
class Stay:
    """A vessel from when it comes into the scene until it leaves, at n whole seconds.

    Attributes:
        times_s: Seconds since the first step, whole numbers, shape (n,).
        end_s: Time of the last step at which it is there.
        antenna_m: w1 and w2 of its antenna, waves included, shape (n, 2).
        velocity_m_s: Of the antenna over ground, shape (n, 2); NaN if the vessel is there at one step only.
        heading_rad: Of the bow, waves included, counter-clockwise from w1 and not wrapped, shape (n,).
        turn_rad_s: Rate of turn, counter-clockwise, shape (n,).
        at_rest: Whether the vessel lies still all the time.
    """

    times_s: Indices
    end_s: float
    antenna_m: Array
    velocity_m_s: Array
    heading_rad: Array
    turn_rad_s: Array
    at_rest: bool


def stays(scene: Scene, steps: int, carried: Sequence[Station]) -> list[list[Stay]]:
    """The stays of each station's vessel in the first steps of a scene, in order of time.

    A stay without a whole second is left out.
    """
    times_s = scene.times_s(0, steps)
    return [_stays_of(times_s, *rows) for rows in _antennas(scene, steps, carried)]


def _antennas(scene: Scene, steps: int, carried: Sequence[Station]) -> list[tuple[Indices, Array]]:
    """For each station the steps at which its vessel is there, shape (m,), and w1, w2 and heading, shape (m, 3)."""
    found: list[list[tuple[Indices, Array]]] = [[] for _ in carried]
    for first in range(0, steps, BLOCK_STEPS) if carried else ():
        block = np.arange(first, min(first + BLOCK_STEPS, steps))
        moved = scene.motion.at(block)
        for parts, station in zip(found, carried, strict=True):
            rows = np.flatnonzero(moved.poses.present[:, station.vessel])
            rotation = moved.world_R_vessel[rows, station.vessel]
            place = moved.poses.positions_m[rows, station.vessel] + rotation @ station.antenna_m
            heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
            parts.append((block[rows], np.column_stack([place[:, :2], heading])))
    return [(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])) for parts in found]


def _stays_of(times_s: Array, present: Indices, track: Array) -> list[Stay]:
    breaks = np.flatnonzero(np.diff(present) > 1) + 1
    parts = zip(np.split(times_s[present], breaks), np.split(track, breaks), strict=True)
    found = (_stay(times, rows) for times, rows in parts if len(times))
    return [stay for stay in found if len(stay.times_s)]


def _stay(times_s: Array, track: Array) -> Stay:
    """One stay, from its times, shape (m,), and w1, w2 and heading at these, shape (m, 3)."""
    begin, end = float(times_s[0]), float(times_s[-1])
    whole = np.arange(int(np.ceil(begin - NEAR_S)), int(np.floor(end + NEAR_S)) + 1)
    rows = np.column_stack([track[:, :2], np.unwrap(track[:, 2])])

    def at(seconds: Array) -> Array:
        return np.stack([np.interp(seconds, times_s, column) for column in rows.T], axis=-1)

    def change(window_s: float) -> Array:
        """Change per second over a window around each whole second, cut at the ends of the stay, shape (n, 3)."""
        before, after = np.maximum(whole - window_s / 2, begin), np.minimum(whole + window_s / 2, end)
        span = np.where(after > before, after - before, np.nan)
        return np.asarray((at(after) - at(before)) / span[:, None])

    values, slow = at(whole.astype(np.float64)), change(REST_WINDOW_S)[:, :2]
    return Stay(
        times_s=whole,
        end_s=end,
        antenna_m=values[:, :2],
        velocity_m_s=change(SPEED_WINDOW_S)[:, :2],
        heading_rad=values[:, 2],
        turn_rad_s=np.nan_to_num(change(TURN_WINDOW_S)[:, 2]),
        at_rest=bool((np.linalg.norm(slow, axis=1) < REST_M_S).all()),  # false where it is not known
    )
