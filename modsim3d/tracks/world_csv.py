"""Tracks in the world from CSV, whose columns have the names of a run's export. docs/world_tracks.md has them."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from modsim3d.ais.geography import local_metres, wrapped_deg
from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs import budgets
from modsim3d.inputs.misreadings import no_commas
from modsim3d.inputs.opening import open_input
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import shown
from modsim3d.runs.files.columns import numbers
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.files.text_table import name_of, source_of
from modsim3d.tracks.world_rows import MOST_DEG, WorldRows

STATE = ("w1", "w2", "v1", "v2")
IN_SCENE, ON_EARTH = ("w1_m", "w2_m"), ("latitude_deg", "longitude_deg")
ALONG_AXES, OVER_GROUND, BY_COURSE = (
    ("v1_m_s", "v2_m_s"),
    ("v_east_m_s", "v_north_m_s"),
    ("speed_m_s", "course_deg"),
)
_UNITS = {0: "m2", 1: "m2_s", 2: "m2_s2"}


def _covariance_name(row: int, column: int) -> str:
    unit = _UNITS[(row > 1) + (column > 1)]
    if row == column:
        return f"{STATE[row]}_variance_{unit}"
    return f"{STATE[row]}_{STATE[column]}_covariance_{unit}"


COVARIANCES = {(i, j): _covariance_name(i, j) for i in range(4) for j in range(i, 4)}
"""Column of each place of the upper triangle of the covariance."""
_OF_POSITION = tuple(COVARIANCES[place] for place in ((0, 0), (0, 1), (1, 1)))
_OF_VELOCITY = tuple(COVARIANCES[place] for place in ((2, 2), (2, 3), (3, 3)))
_OF_BOTH = tuple(COVARIANCES[i, j] for i in (0, 1) for j in (2, 3))
GROUPS = (IN_SCENE, ON_EARTH, ALONG_AXES, OVER_GROUND, BY_COURSE, _OF_POSITION, _OF_VELOCITY, _OF_BOTH)
"""Columns that are there together or not at all."""
COLUMNS = ("track", "time_s", "step", *(name for group in GROUPS for name in group))
_ALIKE = 0.85
"""Of names that are taken for slips of the pen; other columns are ignored."""


def header(path: Path) -> tuple[str, ...]:
    """The cells of the first line.

    Raises:
        InputError: The file cannot be read.
    """
    with open_input(path, "tracks", budgets.MAX_TEXT_BYTES) as file:
        line = file.readline(budgets.MAX_LINE_CHARACTERS)
    text = line.decode("utf-8", "replace").replace("\r", "\n").partition("\n")[0]
    return tuple(cell.strip().strip('"') for cell in text.split(","))


def read_world_csv(path: Path, run: StoredRun) -> WorldRows:
    """The rows of a CSV file.

    Raises:
        InputError: It cannot be read, or its columns are not those of tracks.
    """
    source = source_of(path)
    columns = header(path)
    if marks := no_commas(line := ",".join(columns)):
        raise InputError(source, [f"line 1 must name the columns, with commas between them (got {shown(line)}){marks}"])
    groups = _groups(source, columns)
    table = _table(path, source, columns)

    def column(name: str) -> Array:
        return numbers(table, name)

    if {"time_s", "step"} <= {*columns}:
        _check_steps(source, column("step"), column("time_s"), run.scene.times_s(0, run.steps))
    covariance = np.full((len(table), 4, 4), np.nan)
    for (i, j), name in COVARIANCES.items():
        if name in table.column_names:
            covariance[:, i, j] = covariance[:, j, i] = column(name)
    degrees = None
    if ON_EARTH in groups:
        degrees = np.column_stack([column(name) for name in ON_EARTH])
    return WorldRows(
        source=source,
        name=name_of(path),
        place=lambda row: f"row {row + 2}",
        track=[text or "" for text in table["track"].to_pylist()],
        time_s=_times_s(source, column, groups, run),
        position_m=_positions_m(source, column, degrees, run),
        velocity_m_s=_velocities_m_s(column, groups, degrees, run, len(table)),
        covariance=covariance,
        degrees=degrees,
    )


def _groups(source: str, columns: Sequence[str]) -> set[tuple[str, ...]]:
    """The groups of columns that are there."""
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
    found = {group for group in GROUPS if set(group) <= set(columns)}
    for what, several, needed in (
        ("position", (IN_SCENE, ON_EARTH), True),
        ("velocity", (ALONG_AXES, OVER_GROUND, BY_COURSE), False),
    ):
        names = " or ".join(f"{group[0]} and {group[1]}" for group in several)
        count = len(found & set(several))
        if count > 1 or (needed and not count and not any(set(group) & set(columns) for group in several)):
            problems.append(f"must have one {what}: {names} (got {'more than one' if count else 'none'})")
    if _OF_BOTH in found and not {_OF_POSITION, _OF_VELOCITY} <= found:
        problems.append(f"has {_OF_BOTH[0]} without the covariances of position and velocity")
    if problems:
        raise InputError(source, problems)
    return found | ({("time_s",)} if "time_s" in columns else {("step",)})


def _table(path: Path, source: str, columns: Sequence[str]) -> pa.Table:
    names = [name for name in columns if name in COLUMNS]
    types = {name: pa.string() if name == "track" else pa.float64() for name in names}
    convert = csv.ConvertOptions(
        include_columns=names, column_types=types, strings_can_be_null=False, null_values=["", "nan", "NaN", "null"]
    )
    try:
        file = pa.BufferReader(read_text(path, "tracks").encode())
        read = csv.ReadOptions(use_threads=False, column_names=list(columns), skip_rows=1)
        return csv.read_csv(file, read, convert_options=convert)
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        raise InputError(source, [f"cannot be read as CSV: {str(error).splitlines()[0]}"]) from None


def _times_s(source: str, column: Callable[[str], Array], groups: set[tuple[str, ...]], run: StoredRun) -> Array:
    if ("time_s",) in groups:
        return column("time_s")
    steps, times_s = column("step"), run.scene.times_s(0, run.steps)
    wrong = ~((steps >= 0) & (steps < len(times_s)) & (steps == np.floor(steps)))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        must = f"must be a whole number from 0 to {len(times_s) - 1}, the run's last"
        raise InputError(source, [f"row {row + 2}: step {must} (got {steps[row]:.15g})"])
    found: Array = times_s[steps.astype(np.int64)]
    return found


def _check_steps(source: str, steps: Array, time_s: Array, times_s: Array) -> None:
    """Refuse steps that are farther than half a step from the time beside them; blank ones say nothing."""
    of_time = np.interp(time_s, times_s, np.arange(len(times_s)), left=np.nan, right=np.nan)
    for row in np.flatnonzero(np.abs(of_time - steps) > 0.5 + 1e-9)[:1].tolist():
        of_step = f"time_s {time_s[row]:.9g} is that of step {of_time[row]:.0f}, but step is {steps[row]:.9g}"
        raise InputError(source, [f"row {row + 2}: {of_step}: leave out the column that is wrong"])


def _positions_m(source: str, column: Callable[[str], Array], degrees: Array | None, run: StoredRun) -> Array:
    if degrees is None:
        return np.column_stack([column(name) for name in IN_SCENE])
    if run.scene.origin is None:
        problem = (
            "has latitude and longitude, but the run's scene has no origin: give the scene the key "
            "origin: {latitude_deg: ..., longitude_deg: ...}, or give w1_m and w2_m"
        )
        raise InputError(source, [problem])
    wrong = (np.abs(degrees) > (MOST_DEG[0], 360.0)).any(axis=1)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        swapped = "" if (np.abs(degrees[:, 1]) > MOST_DEG[0]).any() else ": are latitude and longitude swapped?"
        got = f"(got {degrees[row, 0]:g} and {degrees[row, 1]:g})"
        raise InputError(source, [f"row {row + 2}: is no latitude and longitude in degrees {got}{swapped}"])
    return local_metres(degrees[:, 0], degrees[:, 1], run.scene.origin)


def _velocities_m_s(
    column: Callable[[str], Array],
    groups: set[tuple[str, ...]],
    degrees: Array | None,
    run: StoredRun,
    count: int,
) -> Array:
    """Along w1 and w2, NaN where unknown, shape (k, 2)."""
    if ALONG_AXES in groups:
        return np.column_stack([column(name) for name in ALONG_AXES])
    if BY_COURSE in groups:
        speed, course = column("speed_m_s"), np.deg2rad(column("course_deg"))
        east, north = speed * np.sin(course), speed * np.cos(course)
    elif OVER_GROUND in groups:
        east, north = (column(name) for name in OVER_GROUND)
    else:
        return np.full((count, 2), np.nan)
    if degrees is None or run.scene.origin is None:
        return np.column_stack([east, north])
    # True north differs from w2 by the convergence of the meridians, as in the export of AIS.
    turn = np.deg2rad(wrapped_deg(degrees[:, 1] - run.scene.origin[1])) * np.sin(np.deg2rad(degrees[:, 0]))
    return np.column_stack([np.cos(turn) * east - np.sin(turn) * north, np.sin(turn) * east + np.cos(turn) * north])
