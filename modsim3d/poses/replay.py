"""Poses replayed from a file (Jessen & Mohr (2023), Figure 7.3)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import RootModel

from modsim3d.errors import InputError
from modsim3d.poses.base import PoseRequest, Poses, SourceKeys
from modsim3d.validation import MAX_COORDINATE_M, join_path, load_json, nearest, shown

MAX_PROBLEMS = 20
"""A file with one mistake in every line should not fill the screen."""
SECONDS = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
"""What a timestamp looks like; `float` takes more, such as `1_0`."""


class FileKeys(SourceKeys, RootModel[str]):
    """Poses from a file, with its own times."""

    generated: ClassVar[bool] = False

    @property
    def files(self) -> tuple[str, ...]:
        """The file."""
        return (self.root,)

    def build(self, request: PoseRequest) -> RecordedPoses:
        """What the file holds; all of it is looked at even where the vessels are not known."""
        return load_poses(request.folder / self.root, request.names)


@dataclass(frozen=True, eq=False)
class RecordedPoses:
    """Poses that were recorded, with the times' own text."""

    timestamps: Sequence[str]
    recorded: Poses

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1."""
        taken = slice(first, stop)
        return Poses(self.recorded.present[taken], self.recorded.positions_m[taken], self.recorded.headings_rad[taken])


def load_poses(path: Path, vessels: Sequence[str] | None) -> RecordedPoses:
    """Poses from a JSON file: timestamp → vessel ID → centre position and heading.

    Args:
        path: The file.
        vessels: IDs of the scene's vessels; the result has a column for each. None if they are not known, to look
            at the rest of the file.

    Raises:
        InputError: With every problem found, up to 20.
    """
    return parse_poses(load_json(path, "pose file"), f"pose file {path}", vessels)


def parse_poses(data: Any, source: str, vessels: Sequence[str] | None) -> RecordedPoses:
    """Poses from the mapping of Figure 7.3; see `load_poses`."""
    if not isinstance(data, dict) or not data:
        raise InputError(source, ["a mapping of timestamp to vessels is needed, with at least one timestamp"])
    if vessels is None:
        vessels = list({name: None for entries in data.values() if isinstance(entries, dict) for name in entries})
    problems = time_problems(list(data))
    columns = {name: column for column, name in enumerate(vessels)}
    present = np.zeros((len(data), len(vessels)), dtype=bool)
    positions = np.zeros((len(data), len(vessels), 3))
    headings = np.zeros((len(data), len(vessels)))
    for step, (timestamp, entries) in enumerate(data.items()):
        if not isinstance(entries, dict):
            problems.append(f"{timestamp}: a mapping of vessel ID to pose is needed (got {shown(entries)})")
            continue
        for name, entry in entries.items():
            if name not in columns:
                problems.append(f"{join_path(timestamp, name)}: no vessel '{name}' ({nearest(name, vessels)})")
                continue
            found = _pose_problems(entry, join_path(timestamp, name))
            problems += found
            if not found:
                column = columns[name]
                present[step, column] = True
                positions[step, column] = entry["center_position_m"]
                headings[step, column] = entry["heading_rad"]
        if len(problems) >= MAX_PROBLEMS:
            problems.append("… (the rest was not looked at)")
            break
    if problems:
        raise InputError(source, problems)
    return RecordedPoses(tuple(data), Poses(present, positions, headings))


def time_problems(timestamps: list[str]) -> list[str]:
    """Timestamps must be numbers and increase; the same time in two spellings is a duplicate."""
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


def _pose_problems(entry: Any, path: str) -> list[str]:
    if not isinstance(entry, dict):
        return [f"{path}: a mapping with center_position_m and heading_rad is needed (got {shown(entry)})"]
    known = ("center_position_m", "heading_rad")
    problems = [f"{path}.{key}: unknown key ({nearest(key, known)})" for key in entry if key not in known]
    problems += [f"{path}.{key}: missing" for key in known if key not in entry]
    if problems:
        return problems
    position, heading = entry["center_position_m"], entry["heading_rad"]
    if not isinstance(position, list) or len(position) != 3 or not all(map(_finite, position)):
        problems.append(f"{path}.center_position_m: three finite numbers in metres are needed (got {shown(position)})")
    elif max(map(abs, position)) > MAX_COORDINATE_M:
        problems.append(f"{path}.center_position_m: is farther than {MAX_COORDINATE_M:g} m (got {shown(position)})")
    if not _finite(heading):
        problems.append(f"{path}.heading_rad: a finite number of radians is needed (got {shown(heading)})")
    return problems


def _finite(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond every float
        return False
