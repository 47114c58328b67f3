"""Poses replayed from a file (Jessen & Mohr (2023), Figure 7.3)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import RootModel

from modsim3d.errors import InputError
from modsim3d.inputs import budgets
from modsim3d.inputs.strict_json import check_values, load_json, parse_json
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import MAX_COORDINATE_M, join_path, nearest, shown
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys

MAX_PROBLEMS = 20
"""Most problems that are reported of one file."""
OF_AN_INTERRUPTED_RUN = ("unfinished", "poses.jsonl")
"""End of the path of the poses that a live run took in; a kill or a power cut may leave half a line at its end."""
SECONDS = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""Form of a timestamp; `float` accepts more, such as `1_0`."""


class FileKeys(SourceKeys, RootModel[str]):
    """Poses from a file, with its own times."""

    generated: ClassVar[bool] = False
    drawn: ClassVar[bool] = False

    @property
    def files(self) -> tuple[str, ...]:
        """The file."""
        return (self.root,)

    def build(self, request: PoseRequest) -> RecordedPoses:
        """The poses in the file; all of it is checked even if the vessels are not known."""
        return load_poses(request.folder / self.root, request.names)


@dataclass(frozen=True, eq=False)
class RecordedPoses:
    """Recorded poses with the original texts of the times."""

    timestamps: Sequence[str]
    recorded: Poses

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1."""
        return self.recorded.rows(slice(first, stop))


def load_poses(path: Path, vessels: Sequence[str] | None) -> RecordedPoses:
    """Poses from a JSON file: timestamp → vessel ID → centre position and heading; or one such time step a line.

    Args:
        path: A file that ends in `.jsonl` or `.jsonl.gz` has one step a line. Of an interrupted run's own
            `unfinished/poses.jsonl` a last line without its end is left out.
        vessels: IDs of the scene's vessels, one for each column; None if they are not known.

    Raises:
        InputError: With every problem found, up to 20.
    """
    source = f"pose file {path}"
    if path.name.removesuffix(".gz").endswith(".jsonl"):
        text = read_text(path, "pose file")
        check_values(text, source, budgets.POSE_BYTES_PER_VALUE)
        if path.resolve().parts[-2:] == OF_AN_INTERRUPTED_RUN:
            text = text[: text.rfind("\n") + 1] or text
        return parse_poses(parse_lines(text, source), source, vessels)
    return parse_poses(load_json(path, "pose file", budgets.POSE_BYTES_PER_VALUE), source, vessels)


def parse_lines(text: str, source: str) -> dict[str, Any]:
    """The mapping of Figure 7.3 from JSON Lines, one time step a line; the last line may be empty.

    Raises:
        InputError: A line is wrong; the message names its number.
    """
    data: dict[str, Any] = {}
    for number, line in enumerate(text.rstrip().split("\n"), start=1):
        timestamp, entries = read_line(line.strip(), source, number)
        if timestamp in data:
            raise InputError(source, [f"line {number}: '{timestamp}' appears twice"])
        data[timestamp] = entries
    return data


def read_line(text: str, source: str, number: int) -> tuple[str, Any]:
    """The timestamp and the vessels' entries from one line.

    Raises:
        InputError: The line is no JSON object with one key.
    """
    where = f"line {number}"
    if not text:
        raise InputError(source, [f"{where}: is empty; an empty line is the end of a stream"])
    try:
        check_values(text, source)
        content = parse_json(text, source, first_line=number, whole="line")
    except InputError as error:
        raise InputError(source, [p if p.startswith(where) else f"{where}: {p}" for p in error.problems]) from None
    if not isinstance(content, dict) or len(content) != 1:
        got = f"{len(content)} keys" if isinstance(content, dict) else shown(content)
        form = '{"0.1": {"vessel": {"center_position_m": [0, 0, 0], "heading_rad": 0}}}'
        raise InputError(source, [f"{where}: one time step is needed, such as {form} (got {got})"])
    ((timestamp, entries),) = content.items()
    return timestamp, entries


def parse_poses(data: Any, source: str, vessels: Sequence[str] | None) -> RecordedPoses:
    """Poses from the mapping of Figure 7.3; see `load_poses`."""
    if not isinstance(data, dict) or not data:
        raise InputError(source, ["a mapping of timestamp to vessels is needed, with at least one timestamp"])
    if vessels is None:
        vessels = list({name: None for entries in data.values() if isinstance(entries, dict) for name in entries})
    check_pose_count(source, len(data), len(vessels))
    problems = time_problems(list(data))
    columns = {name: column for column, name in enumerate(vessels)}
    poses = Poses.absent(len(data), len(vessels))
    for step, (timestamp, entries) in enumerate(data.items()):
        problems += fill_step(poses, step, timestamp, entries, columns)
        if len(problems) >= MAX_PROBLEMS:
            problems.append("… (the rest was not checked)")
            break
    if problems:
        raise InputError(source, problems)
    return RecordedPoses(tuple(data), poses)


def check_pose_count(source: str, steps: int, vessels: int) -> None:
    """Refuse poses that would fill the memory, though most vessels may be absent at most steps.

    Raises:
        InputError: Vessels times steps exceed the budget.
    """
    if steps * vessels > budgets.MAX_POSES:
        problem = (
            f"{steps:,} steps of {vessels:,} vessels are more than {budgets.MAX_POSES:,} poses: use fewer of either"
        )
        raise InputError(source, [problem])


def fill_step(poses: Poses, step: int, timestamp: str, entries: Any, columns: Mapping[str, int]) -> list[str]:
    """Write the entries of one time step into a row of poses, and return the problems of the entries.

    Entries are centre position and heading by vessel ID; `columns` has the column of each ID. All vessels must be
    absent at the step before.
    """
    if not isinstance(entries, dict):
        return [f"{timestamp}: a mapping of vessel ID to pose is needed (got {shown(entries)})"]
    problems: list[str] = []
    for name, entry in entries.items():
        if len(problems) >= MAX_PROBLEMS:
            break
        if name not in columns:
            problems.append(f"{join_path(timestamp, name)}: no vessel '{name}' ({nearest(name, columns)})")
            continue
        if found := _pose_problems(entry):
            problems += [join_path(timestamp, name) + problem for problem in found]
            continue
        column = columns[name]
        poses.present[step, column] = True
        poses.positions_m[step, column] = entry["center_position_m"]
        poses.headings_rad[step, column] = entry["heading_rad"]
    return problems


def time_problems(timestamps: list[str]) -> list[str]:
    """Problems of timestamps, which must be increasing numbers; one time in two spellings is a duplicate."""
    problems: list[str] = []
    previous: tuple[str, float] | None = None
    for text in timestamps:
        time = float(text) if SECONDS.fullmatch(text) else math.nan
        if not math.isfinite(time):
            problems.append(f"{text}: a timestamp must be a number of seconds (got {text!r})")
            continue
        if previous is not None and time <= previous[1]:
            fault = "is the same time as" if time == previous[1] else "comes after"
            problems.append(f"{text}: timestamps must increase, but '{text}' {fault} '{previous[0]}'")
        previous = (text, time)
    return problems[:MAX_PROBLEMS]


_KEYS = {"center_position_m", "heading_rad"}


def _pose_problems(entry: Any) -> list[str]:
    """What is wrong with the entry of a vessel, each to stand right after the entry's path."""
    if not isinstance(entry, dict):
        return [f": a mapping with center_position_m and heading_rad is needed (got {shown(entry)})"]
    if entry.keys() != _KEYS:
        known = sorted(_KEYS)
        unknown = [key for key in entry if key not in known][:MAX_PROBLEMS]
        problems = [f".{key}: unknown key ({nearest(key, known)})" for key in unknown]
        return problems + [f".{key}: missing" for key in known if key not in entry]
    problems = []
    position, heading = entry["center_position_m"], entry["heading_rad"]
    if not isinstance(position, list) or len(position) != 3 or not all(map(_finite, position)):
        problems.append(f".center_position_m: three finite numbers in metres are needed (got {shown(position)})")
    elif max(map(abs, position)) > MAX_COORDINATE_M:
        problems.append(f".center_position_m: is farther than {MAX_COORDINATE_M:g} m (got {shown(position)})")
    if not _finite(heading):
        problems.append(f".heading_rad: a finite number of radians is needed (got {shown(heading)})")
    return problems


_NUMBERS = float, int


def _finite(value: Any) -> bool:
    if not isinstance(value, _NUMBERS) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond every float
        return False
