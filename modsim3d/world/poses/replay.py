"""Poses replayed from a file (Jessen & Mohr (2023), Figure 7.3)."""

from __future__ import annotations

import math
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, RootModel, model_validator

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io import input_files
from modsim3d.io.input_files import read_text
from modsim3d.io.strict_text import check_values, load_json, parse_json
from modsim3d.io.validation import MAX_COORDINATE_M, Strict, join_path, nearest, nearest_key, shown
from modsim3d.world.poses.base import PoseRequest, Poses, SourceKeys

MAX_PROBLEMS = 20  # that are reported of one file
OF_AN_INTERRUPTED_RUN = ("unfinished", "poses.jsonl")
"""End of the path of the poses that a live run took in; a kill or a power cut may leave half a line at its end."""
# Form of a timestamp; `float` accepts more, such as `1_0`.
SECONDS = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


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
        check_values(text, source, input_files.POSE_BYTES_PER_VALUE)
        if path.resolve().parts[-2:] == OF_AN_INTERRUPTED_RUN:
            text = text[: text.rfind("\n") + 1] or text
        return parse_poses(parse_lines(text, source), source, vessels)
    return parse_poses(load_json(path, "pose file", input_files.POSE_BYTES_PER_VALUE), source, vessels)


def parse_lines(text: str, source: str) -> dict[str, Any]:
    """The mapping of Figure 7.3 from JSON Lines, one time step a line; the last line may be empty. Raises InputError if
    a line is wrong, with its number."""
    data: dict[str, Any] = {}
    for number, line in enumerate(text.rstrip().split("\n"), start=1):
        timestamp, entries = read_line(line.strip(), source, number)
        if timestamp in data:
            raise InputError(source, [f"line {number}: '{timestamp}' appears twice"])
        data[timestamp] = entries
    return data


def read_line(text: str, source: str, number: int) -> tuple[str, Any]:
    """The timestamp and the vessels' entries from one line. Raises InputError if it is no JSON object with one key."""
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
    """Refuse, with InputError, poses of too many vessels times steps for the memory, absent ones included."""
    if steps * vessels > input_files.MAX_POSES:
        most = f"more than {input_files.MAX_POSES:,} poses: use fewer of either"
        raise InputError(source, [f"{steps:,} steps of {vessels:,} vessels are {most}"])


def fill_step(poses: Poses, step: int, timestamp: str, entries: Any, columns: Mapping[str, int]) -> list[str]:
    """Write the entries of one time step, centre position and heading by vessel ID, into a row of poses, and return
    their problems. `columns` has the column of each ID. All vessels must be absent at the step before."""
    if not isinstance(entries, dict):
        return [f"{timestamp}: a mapping of vessel ID to pose is needed (got {shown(entries)})"]
    problems: list[str] = []
    for name, entry in entries.items():
        if len(problems) >= MAX_PROBLEMS:
            break
        if name not in columns:
            problems.append(f"{join_path(timestamp, name)}: no vessel '{name}' ({nearest(name, columns)})")
            continue
        if faults := _pose_problems(entry):
            problems += [join_path(timestamp, name) + problem for problem in faults]
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
    """Problems of the entry of a vessel, each to stand right after the entry's path."""
    if not isinstance(entry, dict):
        return [f": a mapping with center_position_m and heading_rad is needed (got {shown(entry)})"]
    if entry.keys() != _KEYS:
        keys = sorted(_KEYS)
        unknown = [key for key in entry if key not in keys][:MAX_PROBLEMS]
        problems = [f".{key}: unknown key ({nearest_key(key, keys)})" for key in unknown]
        return problems + [f".{key}: missing" for key in keys if key not in entry]
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


Step = tuple[str, Poses]  # text of a step's time, and the poses of that one step


class LivePoses:
    """Keeps the steps that have arrived, and waits for the others. The next step is read only when it is needed. Steps
    that have arrived stay in memory: 40 bytes for each vessel and step.

    Attributes:
        timestamps: Texts of the times of the steps that have arrived.
        source: Name of the source in errors.
        steps: Steps that have not arrived.
    """

    def __init__(self, steps: Iterable[Step], vessels: int, source: str) -> None:
        """Read nothing yet. `steps` yields each step when it arrives; `vessels` is the number of vessels."""
        self.timestamps: list[str] = []
        self.source = source
        self.steps: Iterator[Step] = iter(steps)
        self._rows: Array = np.zeros((64, vessels, 5))

    def wait(self, step: int) -> bool:
        """Wait until a step has arrived; return False if the source ends before it.

        Raises:
            ModsimError: A step that arrived is wrong.
        """
        while len(self.timestamps) <= step:
            arrived = next(self.steps, None)
            if arrived is None:
                return False
            self._keep(*arrived)
        return True

    def _keep(self, timestamp: str, poses: Poses) -> None:
        if problems := time_problems([*self.timestamps[-1:], timestamp]):
            raise InputError(self.source, [f"step {len(self.timestamps) + 1}: {problems[0]}"])
        count = len(self.timestamps)
        if count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        row = self._rows[count]
        row[:, 0], row[:, 1:4], row[:, 4] = poses.present[0], poses.positions_m[0], poses.headings_rad[0]
        self.timestamps.append(timestamp)

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1; waits for steps that have not arrived.

        Raises:
            ModsimError: The source ends before them.
        """
        if stop > first and not self.wait(stop - 1):
            raise ModsimError(f"{self.source}: ended after {len(self.timestamps)} steps; step {stop} was asked for")
        rows = self._rows[first:stop]
        return Poses(rows[..., 0] > 0, rows[..., 1:4].copy(), rows[..., 4].copy())


STANDARD_INPUT = "-"
TIMEOUT_S = 10.0
POLL_S = 0.02
MAX_LINE_BYTES = 1 << 26


class StreamKeys(SourceKeys, Strict):
    """Source of the lines, and how long to wait for a file to grow."""

    generated: ClassVar[bool] = False
    drawn: ClassVar[bool] = False

    file: str
    timeout_s: Annotated[float, Field(strict=True, ge=0, le=1e9)] = TIMEOUT_S

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, keys: Any) -> Any:
        if isinstance(keys, str):
            return {"file": keys}
        if not isinstance(keys, dict):
            raise ValueError(f"a file, '-' for standard input, or a mapping of keys is needed (got {shown(keys)})")
        return keys

    @property
    def files(self) -> tuple[str, ...]:
        """The file, if it is one."""
        return () if self.file == STANDARD_INPUT else (self.file,)

    def build(self, request: PoseRequest) -> LivePoses:
        """A stream that has not been read yet."""
        path = None if self.file == STANDARD_INPUT else request.folder / self.file
        source = "poses from standard input" if path is None else f"poses from {path}"
        if path is not None and (problem := _unreadable(path)):
            raise InputError(source, [problem])
        names = request.names or ()
        return LivePoses(read_steps(_lines(path, self.timeout_s, source), source, names), len(names), source)


def read_steps(lines: Iterable[bytes], source: str, names: Sequence[str]) -> Iterator[Step]:
    """Each step when its line arrives; an empty line is the end. `source` is named in errors. Raises InputError if a
    line is wrong, with its number."""
    columns = {name: column for column, name in enumerate(names)}
    before: list[str] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            return
        if len(line) > MAX_LINE_BYTES:
            raise InputError(source, [f"line {number}: is longer than {MAX_LINE_BYTES} bytes"])
        try:
            text = line.decode("utf-8-sig").strip()
        except UnicodeDecodeError as error:
            raise InputError(source, [f"line {number}: is not UTF-8 text (byte {error.start})"]) from None
        timestamp, entries = read_line(text, source, number)
        poses = Poses.absent(1, len(names))
        if problems := time_problems([*before, timestamp]) + fill_step(poses, 0, timestamp, entries, columns):
            raise InputError(source, [f"line {number}: {problem}" for problem in problems])
        before = [timestamp]
        yield timestamp, poses


def _unreadable(path: Path) -> str | None:
    try:
        if path.is_dir():
            return "this is a folder, a file was expected"
        if not path.exists():
            return "no such file: it must exist before the run begins, even if it is empty"
    except (OSError, ValueError) as error:
        return f"cannot be read: {error}"
    return None if os.access(path, os.R_OK) else "cannot be read: permission denied"


def _lines(path: Path | None, timeout_s: float, source: str) -> Iterator[bytes]:
    if path is not None:
        with path.open("rb") as file:
            yield from follow(file, timeout_s if path.is_file() else None)
    elif sys.stdin is None:
        raise InputError(source, ["there is no standard input"])
    else:
        yield from follow(sys.stdin.buffer, None)


def follow(file: IO[bytes], timeout_s: float | None) -> Iterator[bytes]:
    """The lines of a file as they are written; at the end what is left without a line break, if anything is. At the end
    of a file the next line is waited for, for `timeout_s`; None is for a pipe, which really ends."""
    line, since = b"", time.monotonic()
    while True:
        piece = file.readline(MAX_LINE_BYTES + 1 - len(line))
        line += piece
        if line.endswith(b"\n") or len(line) > MAX_LINE_BYTES:
            yield line
            line, since = b"", time.monotonic()
        elif not piece:
            if timeout_s is None or time.monotonic() - since >= timeout_s:
                break
            time.sleep(POLL_S)
    if line:
        yield line
