"""Poses given as NumPy arrays, and the pose file that holds the same (Jessen & Mohr (2023), Figure 7.3)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import orjson

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.io import input_files
from modsim3d.io.validation import MAX_COORDINATE_M, nearest, nearest_key, shown
from modsim3d.world.poses.base import PoseRequest, Poses, SourceKeys, generated_timestamps
from modsim3d.world.poses.replay import MAX_PROBLEMS, RecordedPoses, check_pose_count

KEYS = ("positions_m", "headings_rad", "time_step_s", "times_s", "names")
FILE = "poses.json"  # the file in a copy of the scene that holds the arrays
_MIN_STEP_S, _MAX_S = 1e-9, 1e9


@dataclass(frozen=True, eq=False)
class ArrayKeys(SourceKeys):
    """The section `poses` of a scene with arrays in place of a file; `name` is the scene's in errors."""

    section: Mapping[str, Any]
    name: str
    generated: ClassVar[bool] = False
    drawn: ClassVar[bool] = False

    @property
    def files(self) -> tuple[str, ...]:
        """The file that a copy of the scene has."""
        return (FILE,)

    def build(self, request: PoseRequest) -> RecordedPoses:
        """The poses in the arrays; all of them are checked even if the vessels are not known."""
        return poses_of_arrays(self.section, request.names, self.name)


def poses_of_arrays(section: Mapping[str, Any], vessels: Sequence[str] | None, source: str) -> RecordedPoses:
    """Poses from arrays, which are copied: `positions_m` (T, N, 2) or (T, N, 3) and `headings_rad` (T, N), NaN where a
    vessel is absent; `time_step_s` or `times_s` (T,); `names` of the N columns, if they are not the scene's vessels in
    their order, whose IDs are None if not known. Raises InputError with every problem found; `source` names the scene
    in it."""
    problems = [f"poses.{key}: unknown key ({nearest_key(key, KEYS)})" for key in section if key not in KEYS]
    names = _names(section.get("names"), vessels, problems)
    positions = _numbers(section, "positions_m", "(T, N, 2) or (T, N, 3)", problems)
    headings = _numbers(section, "headings_rad", "(T, N)", problems)
    if positions is not None and headings is not None:
        problems += _shape_problems(positions, headings, names)
    if problems or positions is None or headings is None:
        raise InputError(source, problems)
    steps = len(positions)
    check_pose_count(source, steps, len(names or ()))
    timestamps = _timestamps(section, steps, problems)
    labels = names if names is not None else [f"[{column}]" for column in range(positions.shape[1])]
    problems += _value_problems(positions, headings, labels)
    if problems:
        raise InputError(source, problems)
    order = list(vessels) if vessels is not None else labels
    present = np.isfinite(headings)
    poses = Poses.absent(steps, len(order))
    columns = [order.index(name) for name in labels]
    poses.present[:, columns] = present
    poses.positions_m[:, columns, : positions.shape[2]] = np.where(present[..., None], positions, 0.0)
    poses.headings_rad[:, columns] = np.where(present, headings, 0.0)
    for array in vars(poses).values():
        array.setflags(write=False)
    return RecordedPoses(timestamps, poses)


def pose_file(poses: RecordedPoses, names: Sequence[str], source: str) -> bytes:
    """The pose file with the same poses, to the last bit. Raises InputError if it is too large to be read again."""
    text = b"{" + b",\n".join(line[1:-1] for line in pose_texts(poses.recorded, poses.timestamps, names)) + b"}\n"
    if len(text) > input_files.MAX_TEXT_BYTES:
        most = f"at most {input_files.MAX_TEXT_BYTES:,} can be read again: use fewer steps or vessels"
        raise InputError(source, [f"poses: the arrays make a pose file of {len(text):,} bytes, and {most}"])
    return text


def pose_texts(poses: Poses, timestamps: Sequence[str], names: Sequence[str]) -> Iterator[bytes]:
    """The JSON text of each step, an object of its timestamp alone; reading it gives exactly the same numbers."""
    positions, headings = poses.positions_m.tolist(), poses.headings_rad.tolist()
    for step, timestamp in enumerate(timestamps):
        entries = {
            names[column]: {"center_position_m": positions[step][column], "heading_rad": headings[step][column]}
            for column in np.flatnonzero(poses.present[step]).tolist()
        }
        yield orjson.dumps({timestamp: entries})


def _names(given: object, vessels: Sequence[str] | None, problems: list[str]) -> list[str] | None:
    """Names of the columns: those given, or the vessels; None if neither is known."""
    if given is None:
        return None if vessels is None else list(vessels)
    if isinstance(given, np.ndarray):
        given = given.tolist()
    if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
        problems.append(f"poses.names: a list of vessel IDs is needed (got {shown(given)})")
        return None
    repeated = sorted({name for name in given if given.count(name) > 1})
    problems += [f"poses.names: '{name}' appears twice" for name in repeated]
    if vessels is not None:
        unknown = [name for name in given if name not in vessels][:MAX_PROBLEMS]
        problems += [f"poses.names: no vessel '{name}' ({nearest(name, vessels)})" for name in unknown]
    return list(given)


def _numbers(section: Mapping[str, Any], key: str, shape: str, problems: list[str]) -> Array | None:
    """An array of the section as 64-bit floats; None with a problem if it is none."""
    if section.get(key) is None:
        problems.append(f"poses.{key}: missing; an array of shape {shape} is needed")
        return None
    try:
        array = np.asarray(section[key])
    except ValueError:  # lists of different lengths
        problems.append(f"poses.{key}: an array of shape {shape} is needed, and its rows differ in length")
        return None
    if array.dtype.kind not in "fiu":
        problems.append(f"poses.{key}: numbers are needed (got an array of {array.dtype})")
        return None
    return array.astype(np.float64)


def _shape_problems(positions: Array, headings: Array, names: list[str] | None) -> list[str]:
    problems = []
    count = "N" if names is None else str(len(names))
    of = "" if names is None else f", a column for each of the {len(names)} vessels named"
    fits = positions.ndim == 3 and positions.shape[2] in (2, 3) and (names is None or positions.shape[1] == len(names))
    if not fits:
        shapes = f"shape (T, {count}, 2) or (T, {count}, 3) is needed{of}"
        problems.append(f"poses.positions_m: {shapes} (got {positions.shape})")
    elif headings.shape != positions.shape[:2]:
        needed = positions.shape[:2]
        problems.append(f"poses.headings_rad: shape {needed} is needed, that of positions_m (got {headings.shape})")
    elif not len(positions):
        problems.append("poses.positions_m: at least one step is needed (got none)")
    return problems


def _timestamps(section: Mapping[str, Any], steps: int, problems: list[str]) -> tuple[str, ...]:
    """Texts of the times, which are exact; none with a problem if they are not given as needed."""
    step_s, times = section.get("time_step_s"), section.get("times_s")
    if (step_s is None) == (times is None):
        problems.append("poses: give exactly one of time_step_s and times_s")
        return ()
    if step_s is not None:
        number = isinstance(step_s, int | float | np.integer | np.floating) and not isinstance(step_s, bool)
        if number and _MIN_STEP_S <= step_s <= _MAX_S:
            return generated_timestamps(steps, float(step_s))
        needed = f"a number of seconds from {_MIN_STEP_S:g} to {_MAX_S:g} is needed"
        problems.append(f"poses.time_step_s: {needed} (got {shown(step_s)})")
        return ()
    array = _numbers(section, "times_s", f"({steps},)", problems)
    if array is None:
        return ()
    if array.shape != (steps,):
        problems.append(f"poses.times_s: shape ({steps},) is needed, a time for each step (got {array.shape})")
    elif not np.isfinite(array).all():
        problems.append("poses.times_s: finite numbers of seconds are needed (got NaN or infinity)")
    elif len(back := np.flatnonzero(np.diff(array) <= 0)):
        step = int(back[0])
        order = f"times must increase, but {array[step + 1]:g} s comes after {array[step]:g} s"
        problems.append(f"poses.times_s[{step + 1}]: {order}")
    return tuple(map(repr, array.tolist()))


def _value_problems(positions: Array, headings: Array, names: Sequence[str]) -> list[str]:
    """Problems of single numbers, the first of each kind."""
    problems = []
    absent = np.isnan(positions)
    for array, bad, what in (
        ("positions_m", (np.abs(positions) > MAX_COORDINATE_M).any(axis=2), f"more than {MAX_COORDINATE_M:g} m away"),
        ("headings_rad", np.isinf(headings), "infinite"),
        ("positions_m", absent.any(axis=2) & ~absent.all(axis=2), "a place of which only a part is NaN"),
        ("headings_rad", np.isnan(headings) & ~absent.all(axis=2), "NaN, but its position is not"),
        ("positions_m", ~np.isnan(headings) & absent.all(axis=2), "NaN, but its heading is not"),
    ):
        if len(places := np.argwhere(bad)):
            step, column = places[0].tolist()
            more = f", and so in {len(places) - 1:,} more places" if len(places) > 1 else ""
            both = "both are finite, or both NaN where a vessel is absent"
            problems.append(f"poses.{array}[{step}]: '{names[column]}' is {what}{more}; {both}")
    return problems
