"""Reactive agents: vessels that drive about in a basin, keep their speed and keep clear of walls and each other. The
method is the dynamic window approach (Fox, Burgard & Thrun (1997), "The dynamic window approach to collision
avoidance"). Each vessel compares arcs that it could drive in the next seconds, within the speeds and turn rates that it
can reach. An arc is admissible if it hits nothing, and is scored by progress towards a goal, clearance and speed.
Vessels move one after another and only to free places; a vessel that finds none stays. No two ever overlap."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.io.validation import MAX_COORDINATE_M, Strict
from modsim3d.world.poses.base import PoseRequest, Poses, SourceKeys, generated_timestamps
from modsim3d.world.poses.replay import RecordedPoses, check_pose_count
from modsim3d.world.vessels import Vessel

LOOK_AHEAD_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0)
SPEED_CHOICES, TURN_CHOICES = 5, 9
GOAL_REACHED_M = 6.0
PLACING_DRAWS = 2000
Above0 = Annotated[float, Field(strict=True, gt=0, le=MAX_COORDINATE_M)]


class AgentsKeys(SourceKeys, Strict):
    """A closed rectangle of water and how vessels drive in it."""

    size_m: tuple[Above0, Above0]  # extent along w1 and w2; one corner is the origin
    speed_m_s: tuple[Above0, Above0] = (2.0, 4.0)  # least and greatest that vessels try to keep
    acceleration_m_s2: Above0 = 1.0  # greatest change of speed
    turn_rate_rad_s: Above0 = 0.5  # greatest
    turn_acceleration_rad_s2: Above0 = 0.6  # greatest change of the rate of turn
    clearance_m: Above0 = 1.0  # distance that is kept between hulls, and between a hull and the wall

    @field_validator("speed_m_s")
    @classmethod
    def _ordered(cls, speed_m_s: tuple[float, float]) -> tuple[float, float]:
        if speed_m_s[0] > speed_m_s[1]:
            raise ValueError(f"is [least, greatest], but {speed_m_s[0]} > {speed_m_s[1]}")
        return speed_m_s

    def build(self, request: PoseRequest) -> RecordedPoses:
        """The whole drive."""
        return drive_agents(request.vessels, request.steps or 0, request.time_step_s or 0.0, self, request.seed)


@dataclass(eq=False)
class _Fleet:
    """State of V vessels: half sizes, places, headings, speeds, rates of turn, goals and wanted speeds."""

    half_m: Array
    place: Array
    heading: Array
    speed: Array
    turn: Array
    goal: Array
    wanted: Array


def drive_agents(
    vessels: Sequence[Vessel], steps: int, time_step_s: float, basin: AgentsKeys, seed: int
) -> RecordedPoses:
    """Let vessels drive about in a basin; the seed gives their starts, goals and speeds. Raises InputError if the
    vessels do not fit into the basin."""
    check_pose_count("poses.agents", steps, len(vessels))
    rng = Streams(seed).generator(Purpose.AGENTS, step=0)
    fleet = _placed(vessels, basin, rng)
    positions, headings = np.zeros((steps, len(vessels), 3)), np.zeros((steps, len(vessels)))
    for step in range(steps):
        positions[step, :, :2], headings[step] = fleet.place, fleet.heading
        for i in range(len(vessels)):
            _move(fleet, i, basin, time_step_s, rng)
    present = np.ones((steps, len(vessels)), dtype=bool)
    return RecordedPoses(generated_timestamps(steps, time_step_s), Poses(present, positions, headings))


def _placed(vessels: Sequence[Vessel], basin: AgentsKeys, rng: np.random.Generator) -> _Fleet:
    count = len(vessels)
    fleet = _Fleet(
        half_m=np.array([(vessel.length_m / 2, vessel.beam_m / 2) for vessel in vessels]),
        place=np.full((count, 2), np.inf),
        heading=np.zeros(count),
        speed=np.zeros(count),
        turn=np.zeros(count),
        goal=np.zeros((count, 2)),
        wanted=rng.uniform(*basin.speed_m_s, count),
    )
    for i, vessel in enumerate(vessels):
        for _ in range(PLACING_DRAWS):
            place, heading = rng.uniform((0, 0), basin.size_m)[None], rng.uniform(-math.pi, math.pi, 1)
            if _clearance(fleet, i, basin, place, heading, 0.0)[0] >= 2 * basin.clearance_m:
                break
        else:
            hull = f"vessel '{vessel.name}' ({vessel.length_m} m × {vessel.beam_m} m)"
            water = f"a basin of {basin.size_m[0]} m × {basin.size_m[1]} m in {PLACING_DRAWS} draws: use fewer vessels"
            raise InputError("poses.agents", [f"no free place for {hull} in {water}"])
        fleet.place[i], fleet.heading[i] = place[0], heading[0]
        fleet.speed[i] = fleet.wanted[i] / 2
        fleet.goal[i] = _new_goal(basin, rng)
    return fleet


def _new_goal(basin: AgentsKeys, rng: np.random.Generator) -> Array:
    margin = 0.12 * min(basin.size_m)
    return rng.uniform((margin, margin), (basin.size_m[0] - margin, basin.size_m[1] - margin))


def _move(fleet: _Fleet, i: int, basin: AgentsKeys, time_step_s: float, rng: np.random.Generator) -> None:
    """Choose an arc for a vessel and drive one step of it."""
    if np.hypot(*(fleet.goal[i] - fleet.place[i])) < GOAL_REACHED_M:
        fleet.goal[i] = _new_goal(basin, rng)
    speed_change = basin.acceleration_m_s2 * time_step_s
    turn_change = basin.turn_acceleration_rad_s2 * time_step_s
    speeds = np.clip(fleet.speed[i] + np.linspace(-speed_change, speed_change, SPEED_CHOICES), 0, fleet.wanted[i])
    # Arcs are scored with rates of turn that can be reached later; only the first step towards them is driven.
    turns = np.linspace(-basin.turn_rate_rad_s, basin.turn_rate_rad_s, TURN_CHOICES)
    speed, turn = (grid.ravel() for grid in np.meshgrid(speeds, turns))
    next_turn = np.clip(turn, fleet.turn[i] - turn_change, fleet.turn[i] + turn_change)
    score = _scores(fleet, i, basin, speed, turn)
    place, heading = _along(fleet, i, speed, next_turn, time_step_s)
    score[_clearance(fleet, i, basin, place, heading, 0.0) < basin.clearance_m] = -np.inf
    best = int(np.argmax(score))
    if score[best] == -np.inf:
        fleet.speed[i], fleet.turn[i] = 0.0, 0.0
        if rng.random() < 0.02:
            fleet.goal[i] = _new_goal(basin, rng)  # the way to another goal may be free
        return
    fleet.place[i], fleet.heading[i] = place[best], heading[best]
    fleet.speed[i], fleet.turn[i] = speed[best], next_turn[best]


def _scores(fleet: _Fleet, i: int, basin: AgentsKeys, speed: Array, turn: Array) -> Array:
    """Scores of n arcs by progress, clearance ahead and speed, shape (n,)."""
    ahead_s = np.array(LOOK_AHEAD_S)[:, None]
    place, heading = _along(fleet, i, speed, turn, ahead_s)
    clearance = _clearance(fleet, i, basin, place, heading, ahead_s).min(axis=0)
    place, heading = place[3], heading[3]
    to_goal = fleet.goal[i] - place
    bearing = np.arctan2(to_goal[:, 1], to_goal[:, 0])
    off = np.abs((bearing - heading + math.pi) % (2 * math.pi) - math.pi)
    safe = np.clip((clearance - basin.clearance_m) / 6.0, -1.0, 1.0)
    score: Array = 2.0 * safe + (1 - off / math.pi) + 0.8 * speed / fleet.wanted[i] - 0.2 * np.abs(turn - fleet.turn[i])
    return score


def _along(fleet: _Fleet, i: int, speed: Array, turn: Array, time_s: float | Array) -> tuple[Array, Array]:
    """Places and headings after driving n arcs of constant speed and rate of turn: (n, 2) and (n,), or (t, n, 2) and
    (t, n) for times of shape (t, 1)."""
    heading = fleet.heading[i] + turn * time_s
    half = turn * time_s / 2
    chord = speed * time_s * np.sinc(half / math.pi)
    direction = fleet.heading[i] + half
    place = fleet.place[i] + chord[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    return place, heading


def _clearance(fleet: _Fleet, i: int, basin: AgentsKeys, place: Array, heading: Array, time_s: float | Array) -> Array:
    """Least distance of a hull, by its index, to the wall and the others in metres; negative if they overlap. The
    others keep their course and speed. The distance of two rectangles is taken as the widest gap along the normals of
    their sides, which is never more. `place` is where the hull may be: (n, 2), or (t, n, 2) for times of shape (t, 1);
    its headings there have that shape without the last axis, as has the result."""
    axes = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    reach = np.abs(axes) * fleet.half_m[i, 0] + np.abs(axes[..., ::-1]) * fleet.half_m[i, 1]
    wall: Array = np.minimum(place - reach, np.array(basin.size_m) - place - reach).min(axis=-1)
    others = np.flatnonzero((np.arange(len(fleet.heading)) != i) & np.isfinite(fleet.place[:, 0]))
    if not len(others):
        return wall
    other_axes = np.stack([np.cos(fleet.heading[others]), np.sin(fleet.heading[others])], axis=1)
    centres = fleet.place[others] + other_axes * (fleet.speed[others] * time_s)[..., None]
    apart: Array = _gaps(place, axes, fleet.half_m[i], centres, other_axes, fleet.half_m[others]).min(axis=-1)
    return np.minimum(wall, apart)


def _gaps(place: Array, axis: Array, half: Array, others: Array, other_axis: Array, other_half: Array) -> Array:
    """Widest gap between n places of a rectangle and m others along the normals of their sides in metres: (n, m), or
    (t, n, m) if the others move. Rectangles are given by their centres (n, 2) or (t, n, 2), and (m, 2) or (t, m, 2);
    unit vectors along their lengths, as the places and (m, 2); and half lengths and half beams, (2,) and (m, 2)."""
    x, y = np.moveaxis(others[..., None, :, :] - place[..., :, None, :], -1, 0)
    (a, b), (c, d) = np.moveaxis(axis, -1, 0)[..., None], other_axis.T
    cosine = np.abs(axis @ other_axis.T)
    sine = np.abs(a * d - b * c)
    length, beam = other_half.T
    gaps = (
        np.abs(x * a + y * b) - half[0] - cosine * length - sine * beam,
        np.abs(x * -b + y * a) - half[1] - sine * length - cosine * beam,
        np.abs(x * c + y * d) - length - cosine * half[0] - sine * half[1],
        np.abs(x * -d + y * c) - beam - sine * half[0] - cosine * half[1],
    )
    widest: Array = np.maximum.reduce(gaps)
    return widest
