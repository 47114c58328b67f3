"""Measurements of a vessel's satellite receiver and compass, once a second."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.random_streams import Purpose, Streams, grid_normals
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.io.strict_text import load_yaml
from modsim3d.scene.ais.messages import places, wrapped_deg
from modsim3d.scene.scene import Scene
from modsim3d.world.vessels import Vessel

TABLE = Path(__file__).with_name("carriage.yaml")
MIN_LENGTH_M = 5.0  # shorter craft carry no AIS unless the scene says so
MADE_UP_MMSI = 799_000_000  # 799 is nobody's: country codes go from 201 to 775 (ITU, maritime identification digits)
MADE_UP_NUMBERS = 1_000_000
_MMSI = re.compile(r"[2-7]\d{8}|98\d{7}", re.ASCII)
MAX_ENDS_M, MAX_SIDES_M = 511, 63  # largest distances from antenna to end and side in a message; they mean this or more
NO_CLASS = "none"


@dataclass(frozen=True, eq=False)
class Station:
    """The AIS equipment of a vessel."""

    vessel: int  # index in the scene
    name: str  # the vessel's ID, which is truth and is never sent
    mmsi: int
    ais_class: str  # `A` or `B`
    ship_type: int
    own: bool  # whether it is own ship's, whose receiver gives its reports as `VDO`
    length_m: float
    sides_m: tuple[int, int, int, int]  # from the antenna to bow, stern, port, starboard: A, B, C, D of the standard
    height_m: float

    @property
    def antenna_m(self) -> Array:
        """Place of the antenna in VCF, shape (3,): such that the reported sides give the centre of the hull."""
        bow, stern, port, starboard = self.sides_m
        return np.array([(stern - bow) / 2, (starboard - port) / 2, self.height_m])

    @property
    def call_sign(self) -> str:
        """A made-up call sign, of seven letters and digits at most."""
        return f"S{np.base_repr(self.mmsi, 36)}"


def stations(scene: Scene, own: Collection[int]) -> tuple[Station, ...]:
    """The stations of a scene's vessels, in the order of the vessels; `own` are the indices of own ships."""
    carriers = []
    numbers = mmsi_of([vessel.name for vessel in scene.vessels])
    for index, (vessel, mmsi) in enumerate(zip(scene.vessels, numbers, strict=True)):
        chosen, ship_type = usual(vessel, index in own)
        chosen = scene.ais.vessels.get(vessel.name, chosen)
        if chosen != NO_CLASS:
            sides, height_m = antenna_sides(vessel, chosen), vessel.air_draft_m / 2
            identity = (index, vessel.name, mmsi, chosen, ship_type, index in own)
            carriers.append(Station(*identity, vessel.length_m, sides, height_m))
    return tuple(carriers)


def usual(vessel: Vessel, own: bool) -> tuple[str, int]:
    """Class and ship type that fit a vessel's label and size. Own ships carry class A: they are craft at work."""
    label = vessel.label.lower()
    fitting = (kind for kind in _table()["kinds"] if any(word in label for word in kind["words"]))
    kind = next(fitting, _table()["others"])
    if own:
        return "A", kind.get("ship_type", 0)
    if kind.get("none") or vessel.length_m < MIN_LENGTH_M:
        return NO_CLASS, kind.get("ship_type", 0)
    return ("A" if vessel.length_m >= kind["class_a_from_m"] else "B"), kind["ship_type"]


@cache
def _table() -> dict[str, Any]:
    table: dict[str, Any] = load_yaml(TABLE, "table of AIS carriage")
    return table


def mmsi_of(names: list[str]) -> list[int]:
    """The number of each vessel: its ID if that is a ship's MMSI, else a made-up one that depends on the ID. If two IDs
    lead to the same number, the later one gets the next that is free."""
    taken = {int(name) for name in names if _MMSI.fullmatch(name)}
    numbers = []
    for name in names:
        if _MMSI.fullmatch(name):
            numbers.append(int(name))
            continue
        digest = hashlib.blake2b(name.encode("utf-8"), digest_size=8).digest()
        offset = int.from_bytes(digest, "little") % MADE_UP_NUMBERS
        while MADE_UP_MMSI + offset in taken:
            offset = (offset + 1) % MADE_UP_NUMBERS
        taken.add(MADE_UP_MMSI + offset)
        numbers.append(MADE_UP_MMSI + offset)
    return numbers


def antenna_sides(vessel: Vessel, ais_class: str) -> tuple[int, int, int, int]:
    """Whole metres from the antenna to bow, stern, port and starboard. The antenna is on the centre line: a quarter of
    the length from the stern on class A ships, whose bridge is mostly aft, else amidships."""
    length, beam = max(round(vessel.length_m), 1), max(round(vessel.beam_m), 1)
    stern = round(length / 4) if ais_class == "A" else length // 2
    ends = min(length - stern, MAX_ENDS_M), min(stern, MAX_ENDS_M)
    return *ends, min(beam - beam // 2, MAX_SIDES_M), min(beam // 2, MAX_SIDES_M)


BLOCK_STEPS = 1000  # whose poses are in memory together
NEAR_S = 1e-6
SPEED_WINDOW_S, TURN_WINDOW_S, REST_WINDOW_S = 5.0, 10.0, 30.0
"""Speed and course are means over the first, so that the roll of a mast does not look like speed; rate of turn over the
second; over the third it shows whether a vessel lies still."""
REST_M_S = 0.25  # half a knot: a slower vessel lies still


@dataclass(frozen=True, eq=False)
class Stay:
    """A vessel from when it comes into the scene until it leaves, at n whole seconds."""

    times_s: Indices  # since the first step, whole numbers: (n,)
    end_s: float  # of the last step at which it is there
    antenna_m: Array  # w1 and w2 of its antenna, waves included: (n, 2)
    velocity_m_s: Array  # of the antenna over ground: (n, 2); NaN if the vessel is there at one step only
    heading_rad: Array  # of the bow, waves included, counter-clockwise from w1 and not wrapped: (n,)
    turn_rad_s: Array  # rate of turn, counter-clockwise: (n,)
    at_rest: bool  # whether the vessel lies still all the time


def stays(scene: Scene, steps: int, carried: Sequence[Station]) -> list[list[Stay]]:
    """The stays of each station's vessel in the first steps, in order of time, of a whole second at least."""
    times_s = scene.times_s(0, steps)
    return [_stays_of(times_s, *rows) for rows in _antennas(scene, steps, carried)]


def _antennas(scene: Scene, steps: int, carried: Sequence[Station]) -> list[tuple[Indices, Array]]:
    """For each station the steps at which its vessel is there, shape (m,), and w1, w2 and heading, shape (m, 3)."""
    tracks: list[list[tuple[Indices, Array]]] = [[] for _ in carried]
    for first in range(0, steps, BLOCK_STEPS) if carried else ():
        block = np.arange(first, min(first + BLOCK_STEPS, steps))
        moved = scene.motion.at(block)
        for parts, station in zip(tracks, carried, strict=True):
            rows = np.flatnonzero(moved.poses.present[:, station.vessel])
            rotation = moved.world_R_vessel[rows, station.vessel]
            place = moved.poses.positions_m[rows, station.vessel] + rotation @ station.antenna_m
            heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
            parts.append((block[rows], np.column_stack([place[:, :2], heading])))
    return [(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])) for parts in tracks]


def _stays_of(times_s: Array, present: Indices, track: Array) -> list[Stay]:
    breaks = np.flatnonzero(np.diff(present) > 1) + 1
    parts = zip(np.split(times_s[present], breaks), np.split(track, breaks), strict=True)
    visits = (_stay(times, rows) for times, rows in parts if len(times))
    return [stay for stay in visits if len(stay.times_s)]


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


POSITION_KEPT = 0.99
"""Share of a position's error that is left after a second: errors of satellite receivers last for minutes, so the mean
of many reports is not much better than one."""
VELOCITY_NOISE_M_S = 0.05  # along each axis; 0.1 knots
COMPASS_OFFSET_DEG, COMPASS_NOISE_DEG = 0.5, 0.5
"""Standard deviations. Heading devices may be off by 1° at rest and 1.5° on the move (IMO resolution MSC.116(73))."""


@dataclass(frozen=True, eq=False)
class SensorReadings:
    """Measurements at n whole seconds, shape (n,) each."""

    times_s: Indices  # since the first step
    latitude_deg: Array  # of the antenna
    longitude_deg: Array
    speed_kn: Array  # over ground; NaN if it is not known
    course_deg: Array  # over ground, clockwise from true north; NaN if it is not known
    heading_deg: Array  # of the bow, clockwise from true north and not wrapped
    turn_deg_min: Array  # positive to starboard


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard normal errors of a vessel's sensors at each second of a run, from the first step on."""

    position: Array  # along w1 and w2; what is left of them lasts: (n, 2)
    velocity: Array  # along w1 and w2: (n, 2)
    heading: Array  # of the compass from second to second: (n,)
    heading_offset: float  # of the compass all the time

    @classmethod
    def of(cls, vessel: str, streams: Streams, seconds: int) -> Noise:
        """The errors of a vessel by its ID, for a number of seconds."""
        drawn = grid_normals(streams.uniforms(Purpose.AIS_SENSORS, vessel, first=0, count=seconds))
        offset = grid_normals(streams.uniforms(Purpose.AIS_COMPASS, vessel, first=0, count=1))
        lasting = np.sqrt(1 - POSITION_KEPT**2) * drawn[:, :2]  # a first-order process with the variance of white noise
        lasting[:1] = drawn[:1, :2]
        # What scipy.signal.lfilter gives, too; its import takes 0.5 s.
        steps = [accumulate(axis, lambda before, new: POSITION_KEPT * before + new) for axis in lasting.T.tolist()]
        lasting = np.array([list(axis) for axis in steps]).T
        return cls(lasting, drawn[:, 2:4], drawn[:, 4], float(offset[0, 0]))


def measured(stay: Stay, noise: Noise, origin: tuple[float, float], position_noise_m: float) -> SensorReadings:
    """Measurements of a vessel's sensors during a stay, which must not outlast their errors. `origin` has latitude and
    longitude of w1 = w2 = 0, and `position_noise_m` is the standard deviation of a position along each axis."""
    now = stay.times_s
    latitude, longitude = places(stay.antenna_m + position_noise_m * noise.position[now], origin)
    velocity = stay.velocity_m_s + VELOCITY_NOISE_M_S * noise.velocity[now]
    # True north differs from w2 by the convergence of the meridians.
    north = wrapped_deg(longitude - origin[1]) * np.sin(np.deg2rad(latitude))
    heading = 90 - np.rad2deg(stay.heading_rad) + north
    return SensorReadings(
        times_s=now,
        latitude_deg=latitude,
        longitude_deg=longitude,
        speed_kn=np.linalg.norm(velocity, axis=1) / KNOT_M_S,
        course_deg=np.rad2deg(np.arctan2(velocity[:, 0], velocity[:, 1])) + north,
        heading_deg=heading + COMPASS_OFFSET_DEG * noise.heading_offset + COMPASS_NOISE_DEG * noise.heading[now],
        turn_deg_min=-60 * np.rad2deg(stay.turn_rad_s),
    )
