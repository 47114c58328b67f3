"""Tracks in the world from CSV, whose columns have the names of a run's export. docs/world_tracks.md has them."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow.csv import write_csv
from scipy.spatial.transform import Rotation

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io import input_files
from modsim3d.io.atomic_write import write_files
from modsim3d.io.input_files import open_input
from modsim3d.io.misreadings import no_commas
from modsim3d.io.ros_bag import DETECTIONS_3D, ODOMETRY, BagMessage, is_bag, read_bag
from modsim3d.io.text_table import RowProblems, TextTable, named_lines
from modsim3d.io.validation import nearest, shown
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.ais.messages import local_metres, wrapped_deg
from modsim3d.tracks.reading import FACTS, WORLD_TABLE, facts_text, stored_facts
from modsim3d.tracks.tracks import Origin, WorldTracks, name_of, source_of
from modsim3d.tracks.world_rows import MAX_DEG, WorldRows, checked

STATE = ("w1", "w2", "v1", "v2")
IN_SCENE, ON_EARTH = ("w1_m", "w2_m"), ("latitude_deg", "longitude_deg")
ALONG_AXES, OVER_GROUND = ("v1_m_s", "v2_m_s"), ("v_east_m_s", "v_north_m_s")
BY_COURSE = ("speed_m_s", "course_deg")
_UNITS = {0: "m2", 1: "m2_s", 2: "m2_s2"}


def _covariance_name(row: int, column: int) -> str:
    unit = _UNITS[(row > 1) + (column > 1)]
    if row == column:
        return f"{STATE[row]}_variance_{unit}"
    return f"{STATE[row]}_{STATE[column]}_covariance_{unit}"


# Column of each place of the upper triangle of the covariance.
COVARIANCES = {(i, j): _covariance_name(i, j) for i in range(4) for j in range(i, 4)}
_OF_POSITION = tuple(COVARIANCES[place] for place in ((0, 0), (0, 1), (1, 1)))
_OF_VELOCITY = tuple(COVARIANCES[place] for place in ((2, 2), (2, 3), (3, 3)))
_OF_BOTH = tuple(COVARIANCES[i, j] for i in (0, 1) for j in (2, 3))
# Columns that are there together or not at all.
GROUPS = (IN_SCENE, ON_EARTH, ALONG_AXES, OVER_GROUND, BY_COURSE, _OF_POSITION, _OF_VELOCITY, _OF_BOTH)
COLUMNS = ("track", "time_s", "step", *(name for group in GROUPS for name in group))
_ALIKE = 0.85  # of names that are taken for slips of the pen; other columns are ignored
_MISSING = ("", "nan", "NaN", "null")


def header(path: Path) -> tuple[str, ...]:
    """The cells of the first line. Raises InputError if the file cannot be read."""
    with open_input(path, "tracks", input_files.MAX_TEXT_BYTES) as file:
        line = file.readline(input_files.MAX_LINE_CHARACTERS)
    text = line.decode("utf-8", "replace").replace("\r", "\n").partition("\n")[0]
    return tuple(cell.strip().strip('"') for cell in text.split(","))


def read_world_csv(path: Path, run: StoredRun) -> WorldRows:
    """The rows of a CSV file. Raises InputError if it cannot be read, or its columns are not those of tracks."""
    source = source_of(path)
    columns, body = named_lines(path, "tracks")
    if marks := no_commas(line := ",".join(columns)):
        raise InputError(source, [f"line 1 must name the columns, with commas between them (got {shown(line)}){marks}"])
    groups = _groups(source, columns)
    table = TextTable.of(body, columns, source, first_line=2)
    numbers = {name: table.numbers(name, missing=_MISSING) for name in COLUMNS if name != "track" and table.has(name)}
    table.problems.settle()
    covariance = np.full((len(table), 4, 4), np.nan)
    for (i, j), name in COVARIANCES.items():
        if name in numbers:
            covariance[:, i, j] = covariance[:, j, i] = numbers[name]
    degrees = np.column_stack([numbers[name] for name in ON_EARTH]) if ON_EARTH in groups else None
    rows = WorldRows(
        problems=table.problems,
        name=name_of(path),
        track=table.columns["track"].to_pylist(),
        time_s=_times_s(numbers, table.problems, run),
        position_m=_positions_m(numbers, degrees, table.problems, run),
        velocity_m_s=_velocities_m_s(numbers, groups, degrees, run),
        covariance=covariance,
        degrees=degrees,
    )
    table.problems.settle()
    return rows


def _groups(source: str, columns: Sequence[str]) -> set[tuple[str, ...]]:
    problems = [f"column {name} is there twice" for name in COLUMNS if columns.count(name) > 1]
    missing = [name for name in COLUMNS if name not in columns]
    for name in columns:
        close = [] if name in COLUMNS else difflib.get_close_matches(name.strip(), missing, n=1, cutoff=_ALIKE)
        problems += [f"unknown column {shown(name)}: did you mean {close[0]}?" for close in [close] if close]
    for group in GROUPS:
        lacking = [name for name in group if name not in columns]
        if 0 < len(lacking) < len(group):
            problems.append(f"has not all of {', '.join(group)}: {', '.join(lacking)} is missing")
    if "track" not in columns:
        problems.append("has no column track, the tracker's name of the track")
    if "time_s" not in columns and "step" not in columns:
        problems.append("has no column time_s, the time since the scene's first step, and no column step")
    groups = {group for group in GROUPS if set(group) <= set(columns)}
    for what, several, needed in (
        ("position", (IN_SCENE, ON_EARTH), True),
        ("velocity", (ALONG_AXES, OVER_GROUND, BY_COURSE), False),
    ):
        names = " or ".join(f"{group[0]} and {group[1]}" for group in several)
        count = len(groups & set(several))
        if count > 1 or (needed and not count and not any(set(group) & set(columns) for group in several)):
            problems.append(f"must have one {what}: {names} (got {'more than one' if count else 'none'})")
    if _OF_BOTH in groups and not {_OF_POSITION, _OF_VELOCITY} <= groups:
        problems.append(f"has {_OF_BOTH[0]} without the covariances of position and velocity")
    if problems:
        raise InputError(source, problems)
    return groups


def _times_s(numbers: Mapping[str, Array], problems: RowProblems, run: StoredRun) -> Array:
    """The time of each row, by its own or its step, which may not contradict each other."""
    times_s = run.scene.times_s(0, run.steps)
    steps = numbers.get("step")
    if "time_s" not in numbers:
        steps = numbers["step"]
        wrong = ~((steps >= 0) & (steps < len(times_s)) & (steps == np.floor(steps)))
        must = f"must be a whole number from 0 to {len(times_s) - 1}, the run's last"
        problems.refuse(wrong, lambda row: f"step {must} (got {steps[row]:.15g})")
        return times_s[np.where(wrong, 0, steps).astype(np.int64)]
    time_s = numbers["time_s"]
    if steps is not None:  # blank ones say nothing
        of_time = np.interp(time_s, times_s, np.arange(len(times_s)), left=np.nan, right=np.nan)

        def say(row: int) -> str:
            differ = f"time_s {time_s[row]:.9g} is that of step {of_time[row]:.0f}, but step is {steps[row]:.9g}"
            return f"{differ}: leave out the column that is wrong"

        problems.refuse(np.abs(of_time - steps) > 0.5 + 1e-9, say)
    return time_s


def _positions_m(numbers: Mapping[str, Array], degrees: Array | None, problems: RowProblems, run: StoredRun) -> Array:
    if degrees is None:
        return np.column_stack([numbers[name] for name in IN_SCENE])
    if run.scene.origin is None:
        keys = "origin: {latitude_deg: ..., longitude_deg: ...}, or give w1_m and w2_m"
        problem = "has latitude and longitude, but the run's scene has no origin: give the scene the key"
        raise InputError(problems.source, [f"{problem} {keys}"])
    swapped = "" if (np.abs(degrees[:, 1]) > MAX_DEG[0]).any() else ": are latitude and longitude swapped?"
    wrong, must = (np.abs(degrees) > (MAX_DEG[0], 360.0)).any(axis=1), "is no latitude and longitude in degrees"
    problems.refuse(wrong, lambda row: f"{must} (got {degrees[row, 0]:g} and {degrees[row, 1]:g}){swapped}")
    return local_metres(degrees[:, 0], degrees[:, 1], run.scene.origin)


def _velocities_m_s(
    numbers: Mapping[str, Array], groups: set[tuple[str, ...]], degrees: Array | None, run: StoredRun
) -> Array:
    """Along w1 and w2, NaN where unknown, shape (k, 2)."""
    if ALONG_AXES in groups:
        return np.column_stack([numbers[name] for name in ALONG_AXES])
    if BY_COURSE in groups:
        speed, course = numbers["speed_m_s"], np.deg2rad(numbers["course_deg"])
        east, north = speed * np.sin(course), speed * np.cos(course)
    elif OVER_GROUND in groups:
        east, north = (numbers[name] for name in OVER_GROUND)
    else:
        return np.full((len(next(iter(numbers.values()))), 2), np.nan)
    if degrees is None or run.scene.origin is None:
        return np.column_stack([east, north])
    # True north differs from w2 by the convergence of the meridians, as in the export of AIS.
    turn = np.deg2rad(wrapped_deg(degrees[:, 1] - run.scene.origin[1])) * np.sin(np.deg2rad(degrees[:, 0]))
    return np.column_stack([np.cos(turn) * east - np.sin(turn) * north, np.sin(turn) * east + np.cos(turn) * north])


MAP = "map"  # the frame of the scene's axes in the bags that a run is exported to
_KINDS = (DETECTIONS_3D, ODOMETRY)


class _Estimate(NamedTuple):
    """Content of a message on a track; its covariances are rows of 6 × 6, and all zeros stand for unknown."""

    track: str
    stamp_ns: int
    position_m: tuple[float, float]
    covariance: Array
    quaternion: tuple[float, float, float, float]
    velocity_m_s: tuple[float, float, float]
    velocity_covariance: Array


def read_world_bag(path: Path, run: StoredRun, topic: str | None = None) -> WorldRows:
    """The rows of a bag in a folder. The topic of the tracks is None for the only one that can be. Raises InputError if
    it cannot be read, has no such topic or several, or another frame, and ModsimError if rosbags is not installed."""
    source = source_of(path)
    messages = list(read_bag(path, "tracks", lambda topics: [_choose_topic(topics, source, topic)], _estimates))
    word = f"{messages[0][0]} message" if messages else "message"
    number, frames = np.arange(len(messages)) + 1, [frame for _, frame, _ in messages]
    of_messages = RowProblems(source, number, word)
    wanted = f"frame_id must be '{MAP}', the scene's axes"
    of_messages.refuse([frame != MAP for frame in frames], lambda row: f"{wanted} (got {shown(frames[row])})")
    of_messages.settle()
    rows = [estimate for _, _, estimates in messages for estimate in estimates]
    start = float(run.scene.timestamps(0, 1)[0])
    covariance = np.full((len(rows), 4, 4), np.nan)
    velocity = np.full((len(rows), 2), np.nan)
    if rows:
        covariance[:, :2, :2] = _covariances(np.array([estimate.covariance for estimate in rows]))[:, :2, :2]
        velocity, covariance[:, 2:, 2:] = _velocities(rows)
    return WorldRows(
        problems=RowProblems(source, np.repeat(number, [len(estimates) for _, _, estimates in messages]), word),
        name=path.name,
        track=[estimate.track for estimate in rows],
        time_s=np.array([estimate.stamp_ns for estimate in rows], dtype=np.float64) / 1e9 - start,
        position_m=np.array([estimate.position_m for estimate in rows], dtype=np.float64).reshape(-1, 2),
        velocity_m_s=velocity,
        covariance=covariance,
    )


def _covariances(covariances: Array) -> Array:
    """Covariances of shape (k, 36) as (k, 6, 6), NaN where they are all zero or begin with −1, ROS's unknown."""
    unknown = (covariances == 0).all(axis=1) | (covariances[:, 0] == -1)
    return np.where(unknown[:, None], np.nan, covariances).reshape(-1, 6, 6)


def _velocities(estimates: list[_Estimate]) -> tuple[Array, Array]:
    """Velocities in the map and their covariances, shapes (k, 2) and (k, 2, 2); a bag of zeros says none."""
    quaternions = np.array([estimate.quaternion for estimate in estimates], dtype=np.float64)
    velocity = np.array([estimate.velocity_m_s for estimate in estimates], dtype=np.float64)
    length = np.linalg.norm(quaternions, axis=1)
    quaternions[~(length > 0)] = (0.0, 0.0, 0.0, 1.0)  # an orientation that nobody filled in
    turn = Rotation.from_quat(quaternions)
    covariance = _covariances(np.array([estimate.velocity_covariance for estimate in estimates]))[:, :3, :3]
    if not velocity.any():
        return np.full((len(estimates), 2), np.nan), np.full((len(estimates), 2, 2), np.nan)
    matrices = turn.as_matrix()
    in_map = matrices @ covariance @ np.swapaxes(matrices, -1, -2)
    return turn.apply(velocity)[:, :2], in_map[:, :2, :2]


def _estimates(message: BagMessage) -> tuple[str, str, list[_Estimate]]:
    """Topic, frame and estimates of a message."""
    of_kind = _of_array if message.kind == DETECTIONS_3D else _of_odometry
    return message.topic, message.content.header.frame_id, list(of_kind(message.stamp_ns, message.content))


def _choose_topic(topics: Mapping[str, str], source: str, topic: str | None) -> str:
    able = [name for name, kind in topics.items() if kind in _KINDS]
    if topic is not None:
        if topic not in able:
            raise InputError(source, [f"has no topic {topic} of {' or '.join(_KINDS)} ({nearest(topic, able)})"])
        return topic
    for kind in _KINDS:  # own ship's odometry is often there too
        of_kind = [name for name in able if topics[name] == kind]
        if len(of_kind) == 1:
            return of_kind[0]
        if of_kind:
            names = ", ".join(sorted(of_kind))
            raise InputError(source, [f"must have one topic of {kind} (got {len(of_kind)}: {names})"])
    names = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "no topic at all"
    raise InputError(source, [f"must have a topic of {' or '.join(_KINDS)} (got {names})"])


def _of_array(stamp_ns: int, message: Any) -> Iterator[_Estimate]:
    for detection in message.detections:
        best = detection.results[0].pose if len(detection.results) else None
        centre = best.pose if best else detection.bbox.center
        covariance = np.asarray(best.covariance) if best else np.zeros(36)
        at = (centre.position.x, centre.position.y)
        track = detection.id if hasattr(detection, "id") else detection.tracking_id  # as vision_msgs 2 calls it
        yield _Estimate(track, stamp_ns, at, covariance, (0, 0, 0, 1), (0, 0, 0), np.zeros(36))


def _of_odometry(stamp_ns: int, message: Any) -> Iterator[_Estimate]:
    pose, twist = message.pose, message.twist
    place, turn, speed = pose.pose.position, pose.pose.orientation, twist.twist.linear
    facts = message.child_frame_id, stamp_ns, (place.x, place.y), np.asarray(pose.covariance)
    quaternion, velocity = (turn.x, turn.y, turn.z, turn.w), (speed.x, speed.y, speed.z)
    yield _Estimate(*facts, quaternion, velocity, np.asarray(twist.covariance))


IN_IMAGE = "x_min_px"


def is_world(path: StrPath) -> bool:
    """Whether a file or folder has tracks in the world: a ROS 2 bag, or CSV with places in the world and no boxes."""
    path = as_path(path, "path", "tracks")
    if path.is_dir() or is_bag(path):
        return is_bag(path) or (path / WORLD_TABLE).is_file()
    try:
        columns = ",".join(header(path)).translate(str.maketrans(";\t|", ",,,")).split(",")  # which the reader refuses
    except InputError:  # whoever reads it says so
        return False
    return IN_IMAGE not in columns and any(name in columns for name in IN_SCENE + ON_EARTH)


def read_world_tracks(path: StrPath, run: StoredRun, topic: str | None = None) -> WorldTracks:
    """Read tracks in the world.

    Args:
        path: A folder that `modsim3d track` has written, a CSV file, or a ROS 2 bag: its folder, or a file of it.
        run: The run that the tracker was given.
        topic: The bag's topic; None for the only one that can be.

    Raises:
        InputError: The file is wrong, or is not of this run; each problem says where it is.
        ModsimError: rosbags is not installed, and a bag needs it.
    """
    path = as_path(path, "path", "tracks")
    run.scene.check_world("a score of tracks in the world")
    run.check_has_steps()
    if (path / WORLD_TABLE).is_file():
        facts = stored_facts(path, run, WORLD_TABLE)
        return replace(checked(read_world_csv(path / WORLD_TABLE, run), run), name=facts.name)
    if path.is_dir() or is_bag(path):
        return checked(read_world_bag(path, run, topic), run)
    if topic is not None:
        raise InputError(source_of(path), ["a topic is for a ROS 2 bag"])
    return checked(read_world_csv(path, run), run)


def write_claimed_world_tracks(folder: Path, run: StoredRun, tracks: WorldTracks, origin: Origin) -> None:
    """Write `world_tracks.csv` and `tracks.json`, which the caller has claimed; the same tracks give the same bytes.
    Raises OutputError if they cannot be written."""
    order = np.lexsort((tracks.track, tracks.time_s))
    columns: dict[str, Any] = {
        "track": np.array(tracks.track_names, dtype=object)[tracks.track],
        "time_s": tracks.time_s,
    }
    columns |= zip(IN_SCENE, tracks.position_m.T, strict=True)
    columns |= zip(ALONG_AXES, tracks.velocity_m_s.T, strict=True)
    columns |= {name: tracks.covariance[:, i, j] for (i, j), name in COVARIANCES.items()}
    unknown = [group for group in GROUPS if group[0] in columns and np.isnan(columns[group[0]]).all()]
    left_out = {name for group in unknown for name in group}
    arrays = {
        name: pa.array(values[order], from_pandas=True) for name, values in columns.items() if name not in left_out
    }
    out = pa.BufferOutputStream()
    write_csv(pa.table(arrays), out)
    content = out.getvalue().to_pybytes()
    counts = {"rows": len(tracks), "tracks": len(tracks.track_names)}
    facts = facts_text(tracks.name, origin, run, counts, {WORLD_TABLE: content})
    write_files({folder / WORLD_TABLE: content, folder / FACTS: facts})
