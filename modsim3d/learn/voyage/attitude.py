"""Own ship's attitude as instruments on board have measured it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.errors import InputError
from modsim3d.core.text import in_percent
from modsim3d.geometry.camera_poses import vehicle_R_nominal, world_R_vehicle
from modsim3d.io.misreadings import other_unit
from modsim3d.io.text_table import TextTable
from modsim3d.io.validation import nearest
from modsim3d.learn.voyage.clock import SceneClock, on_scene_clock
from modsim3d.learn.voyage.logs.reading import times_of
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.vessel_motion import PosesInWaves

COLUMNS = ("roll_rad", "pitch_rad", "heading_rad")
MAX_APART_S = 2.0  # angles are linear between rows that are no further apart; in a longer gap they are not known
_NEAR_S = 1e-6
_UNDER_WAY, _MAX_OFF = 1.0, np.pi / 4  # m/s above which the scene knows a heading, and how far headings may be off it
_FOUR_TURNS = 8 * np.pi  # headings may go on counting where a vessel turns round. Larger ones do so, or are degrees
_MAX_TURN = 1.0  # a larger heading that changes by more radians between two rows, and in a second, is in degrees


@dataclass(frozen=True, eq=False)
class Attitude:
    """Attitude of the vessel that carries a camera, as in `ownship.csv`: port side down, bow down, counter-clockwise
    from w1; the heading does not jump from π to −π."""

    vessel: str  # its ID
    time_s: Array  # since the scene's first step, ascending, (n,)
    angles_rad: Array  # (n, 3)

    def known(self, times_s: Array) -> Mask:
        """Whether the attitude is known at some times, shape (k,)."""
        after = np.clip(np.searchsorted(self.time_s, times_s), 1, len(self.time_s) - 1)
        last, first = self.time_s[after - 1], self.time_s[after]
        inside = (times_s >= last) & (times_s <= first) & (first - last <= MAX_APART_S)
        return inside | (np.minimum(np.abs(times_s - last), np.abs(times_s - first)) <= _NEAR_S)

    def at(self, times_s: Array, headings_rad: Array) -> Array:
        """Roll, pitch, and what the heading differs from that of the scene, at some times, shapes (k,), (k, 3)."""
        roll, pitch, heading = (np.interp(times_s, self.time_s, angle) for angle in self.angles_rad.T)
        off = heading - headings_rad
        return np.column_stack([roll, pitch, np.arctan2(np.sin(off), np.cos(off))])


def _check(time_s: Array, angles_rad: Array, source: str, where: Sequence[str]) -> None:
    """Refuse rows (n,) out of order, and angles (n, 3 or 4) that cannot be radians."""
    if len(time_s) < 2:
        raise InputError(source, [f"at least two rows are needed (got {len(time_s)})"])
    if len(late := np.flatnonzero(np.diff(time_s) <= 0)):
        raise InputError(source, [f"{where[late[0] + 1]}: its time must be later than that of the row before"])
    headings = angles_rad[:, 2]
    turns, gaps_s = (np.abs(np.diff(column, prepend=column[:1])) for column in (headings, time_s))
    turns_as_degrees = (np.abs(headings) > _FOUR_TURNS) & (turns > _MAX_TURN * np.maximum(gaps_s, 1.0))
    wrong = (np.abs(angles_rad[:, :2]) > np.pi / 2).any(axis=1) | turns_as_degrees
    if wrong.any():
        first = int(np.argmax(wrong))
        got = ", ".join(f"{angle:g}" for angle in angles_rad[first, :3])
        problem = f"{where[first]}: roll, pitch and heading must be in radians (got {got}): are these degrees?"
        raise InputError(source, [problem])


def read_attitude(path: Path, scene: Scene) -> Attitude:
    """The attitude in a table, CSV or Parquet, such as the `ownship.csv` of `modsim3d export --format csv`. Columns are
    a time, as in logs of detections, `roll_rad`, `pitch_rad`, `heading_rad`, plus `yaw_rad` if there is one, and
    `vessel` if there are several. Raises InputError if one is wrong, or no camera is on board a vessel of it."""
    source = f"attitude {path}"
    carriers = [scene.vessel_names[index] for index in scene.own_ships]
    if not carriers:
        raise InputError(source, [f"no camera of {scene.title} is on board a vessel"])
    if not path.exists():
        raise InputError(source, ["no such file"])
    table = TextTable.read(path, "attitude")
    if missing := [name for name in COLUMNS if not table.has(name)]:
        got = ", ".join(list(table.columns)[:8])
        raise InputError(source, [f"line 1: the columns {', '.join(missing)} are missing (got {got})"])
    time_s, kind = times_of(table, source)
    names = (*COLUMNS, "yaw_rad") if table.has("yaw_rad") else COLUMNS
    angles = np.column_stack([table.numbers(name) for name in names])
    table.problems.settle()
    mine = np.ones(len(time_s), dtype=bool)
    if table.has("vessel"):
        vessels = np.array(table.columns["vessel"].to_pylist(), dtype=object)
        matches = [name for name in carriers if (vessels == name).any()]
        if not matches:
            hint = nearest(str(vessels[0]) if len(vessels) else "", carriers)
            raise InputError(source, [f"has no row of {', '.join(carriers)}, which carries a camera ({hint})"])
        carriers, mine = matches, vessels == matches[0]
    if len(carriers) > 1:
        problem = f"give a file of one vessel: several carry cameras ({', '.join(carriers)})"
        raise InputError(source, [problem])
    time_s, angles = time_s[mine], angles[mine]
    _check(time_s, angles, source, [f"{table.problems.word} {line}" for line in table.problems.line[mine].tolist()])
    heading = np.unwrap(angles[:, 2:].sum(axis=1))
    clock = SceneClock.of(scene)
    times = on_scene_clock(time_s, kind, source, scene, clock)
    if times[0] > clock.length_s or times[-1] < 0:
        spans = f"from {times[0]:.12g} s to {times[-1]:.12g} s", f"from 0 s to {clock.length_s:.12g} s"
        problem = f"its rows are {spans[0]} after the scene's first step, and {scene.title} is {spans[1]}"
        raise InputError(source, [problem])
    outside = ((times < 0) | (times > clock.length_s)).mean()
    if outside > 0.5 and np.median(np.diff(times)) > MAX_APART_S and (unit := other_unit(times, clock.length_s)):
        share = f"{in_percent(outside)} of its rows"
        raise InputError(source, [f"{share} are after {scene.title}, of {clock.length_s:g} s{unit}"])
    _check_headings(times, heading, scene, carriers[0], source)
    return Attitude(carriers[0], times, np.column_stack([angles[:, :2], heading]))


def _check_headings(times_s: Array, headings_rad: Array, scene: Scene, vessel: str, source: str) -> None:
    """Refuse headings (n,) that are not those of the scene where the vessel is under way, such as a compass has."""
    column, poses = scene.vessel_names.index(vessel), scene.poses.poses(0, scene.steps)
    steps = np.flatnonzero(poses.present[:, column])
    if len(steps) < 2:
        return
    every_s, places_m = scene.times_s(0, scene.steps)[steps], poses.positions_m[steps, column]
    speeds = np.linalg.norm(np.gradient(places_m, every_s, axis=0), axis=1)
    under_way = (times_s >= every_s[0]) & (times_s <= every_s[-1]) & (np.interp(times_s, every_s, speeds) > _UNDER_WAY)
    scene_rad = np.interp(times_s, every_s, np.unwrap(poses.headings_rad[steps, column]))
    off = np.abs(np.angle(np.exp(1j * (headings_rad - scene_rad))))[under_way]
    if len(off) and np.median(off) > _MAX_OFF:
        degrees = ", in radians: are these degrees?" if np.abs(headings_rad).max() > 2 * np.pi else ""
        problem = (
            f"its headings are {np.degrees(np.median(off)):.0f}° off those of '{vessel}' in {scene.title}: heading_rad "
            "counts counter-clockwise from w1, which is east in scenes from AIS, so it is π/2 less the compass heading"
            f"{degrees}"
        )
        raise InputError(source, [problem])


# ---- Where the vessels of a scene are at any time ----

NEAR_S = 1e-6  # a time nearer than this to a step is that of the step


class Sampler:
    """The poses of a scene at any time."""

    def __init__(self, scene: Scene, attitude: Attitude | None = None) -> None:
        """Take a scene, and perhaps the attitude of a vessel as it was measured, in place of the scene's waves."""
        self._scene, self._attitude = scene, attitude
        self._every_s = scene.times_s(0, scene.steps)

    def at(self, times_s: Array) -> PosesInWaves:
        """Poses of the V vessels, waves included, at ascending times of the scene (n,). Places, heave and angles are
        linear between two steps, headings turn along the shorter arc, and a vessel is there if it is there at both. At
        the time of a step they are those of the step, to the last bit."""
        scene, every = self._scene, self._every_s
        before = np.clip(np.searchsorted(every, times_s + NEAR_S, side="right") - 1, 0, scene.steps - 1)
        after = np.minimum(before + 1, scene.steps - 1)
        share = (times_s - every[before]) / np.where(after > before, every[after] - every[before], 1.0)
        share = np.where(times_s - every[before] <= NEAR_S, 0.0, np.clip(share, 0, 1))
        after = np.where(share > 0, after, before)
        steps, places = np.unique(np.concatenate([before, after]), return_inverse=True)
        motion = scene.motion.at(steps)
        first, second = motion.rows(places[: len(times_s)]), motion.rows(places[len(times_s) :])
        u = share[:, None]
        turn = second.poses.headings_rad - first.poses.headings_rad
        poses = Poses(
            present=first.poses.present & second.poses.present,
            positions_m=_between(first.poses.positions_m, second.poses.positions_m, u[..., None]),
            headings_rad=first.poses.headings_rad + u * np.arctan2(np.sin(turn), np.cos(turn)),
        )
        angles = _between(first.angles_rad, second.angles_rad, u[..., None])
        return PosesInWaves(poses, *self._turned(poses, angles, times_s))

    def _turned(self, poses: Poses, angles_rad: Array, times_s: Array) -> tuple[Array, Array]:
        """Roll, pitch and yaw with what was measured, (n, V, 3), and the rotations that follow."""
        scene, attitude = self._scene, self._attitude
        moved = set() if scene.waves is None else set(scene.motion.moved)
        if attitude is not None:
            column = scene.vessel_names.index(attitude.vessel)
            angles_rad[:, column] = attitude.at(times_s, poses.headings_rad[:, column])
            moved.add(column)
        rotations = world_R_vehicle(poses.headings_rad)
        if columns := sorted(moved):
            turned = np.swapaxes(vehicle_R_nominal(angles_rad[:, columns]), -1, -2)
            rotations[:, columns] = rotations[:, columns] @ turned
        return angles_rad, rotations


def _between(first: Array, second: Array, share: Array) -> Array:
    return first + share * (second - first)
