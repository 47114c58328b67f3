"""Tracks in a CSV file with a line of names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.errors import InputError
from modsim3d.inputs.misreadings import no_commas, other_unit
from modsim3d.inputs.text_files import read_text
from modsim3d.inputs.validation import nearest, shown
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.files.box_forms import CENTRE, CORNERS, BoxForm
from modsim3d.tracks.files.file_rows import FileRows, frames_at
from modsim3d.tracks.files.text_table import TextTable, source_of
from modsim3d.tracks.files.track_columns import COVARIANCES

TIME_TOLERANCE_S = 0.0005
"""A time may differ so much from that of its frame: half a millisecond, for files with three decimals."""
_COLUMNS = ("camera", "step", "time_s", "track", *CORNERS.names, *CENTRE.names, "label", "confidence", *COVARIANCES)


def read_csv_tracks(path: Path, rows: RunRows) -> FileRows:
    """Read a file whose first line names its columns; their order, and that of the lines, does not matter.

    Raises:
        InputError: The file cannot be read, a column is wrong, or a line has something that the run has not.
    """
    source = source_of(path)
    text = read_text(path, "tracks")
    head, _, body = text.partition("\n")
    names = [name.strip().strip('"') for name in head.split(",")]
    form = _form(names, rows, source)
    table = TextTable.of(body, names, source, first_line=2)
    many, cameras = len(table), [camera.name for camera in rows.scene.cameras]
    camera = table.names("camera", cameras) if table.has("camera") else np.zeros(many, dtype=np.int64)
    frame = _frames(table, rows, camera)
    track = table.identities("track", 0)
    numbers = np.column_stack([table.numbers(name) for name in form.names])
    labels = rows.scene.detector.labels
    label = table.names("label", labels, needed=False) if table.has("label") else np.full(many, NOBODY)
    confidence = _optional(table, "confidence")
    variances = [_optional(table, name) for name in COVARIANCES]
    table.problems.settle()
    covariance = np.stack([variances[i] for i in (0, 1, 1, 2)], axis=-1).reshape(-1, 2, 2)
    return FileRows(table.problems, frame, track, numbers, form, label, confidence, covariance)


def _form(names: Sequence[str], rows: RunRows, source: str) -> BoxForm:
    """The form of the boxes of a file whose columns are right.

    Raises:
        InputError: They are not.
    """
    if not any(name in _COLUMNS for name in names):
        needed = f"camera,step,track,{','.join(CORNERS.names)}"
        got = ",".join(names)
        must = f"line 1 must name the columns, with commas between them: {needed}"
        raise InputError(source, [f"{must} (got {shown(got)}){no_commas(got)}"])
    problems = [f"line 1: the column '{name}' is there twice" for name in dict.fromkeys(names) if names.count(name) > 1]
    problems += [f"line 1: unknown column '{name}' ({_hint(name)})" for name in names if name not in _COLUMNS]
    if "camera" not in names and len(rows.scene.cameras) > 1:
        cameras = ", ".join(camera.name for camera in rows.scene.cameras)
        problems.append(f"line 1: the column 'camera' is missing: the run has several cameras ({cameras})")
    if "step" not in names and "time_s" not in names:
        problems.append("line 1: a column 'step' or 'time_s' is needed")
    if "track" not in names:
        problems.append("line 1: the column 'track' is missing")
    there = [form for form in (CORNERS, CENTRE) if set(form.names) & set(names)]
    if len(there) != 1 or not set(there[0].names) <= set(names):
        either = f"either {', '.join(CORNERS.names)} or {', '.join(CENTRE.names)}"
        problems.append(f"line 1: the columns of the box must be {either}")
    if 0 < len(set(COVARIANCES) & set(names)) < len(COVARIANCES):
        problems.append(f"line 1: {', '.join(COVARIANCES)} belong together")
    if problems:
        raise InputError(source, problems)
    return there[0]


def _hint(name: str) -> str:
    hint = nearest(name, _COLUMNS)
    return hint if hint.startswith("did") else f"known: {', '.join(_COLUMNS)}; leave others out"


def _optional(table: TextTable, name: str) -> Array:
    return table.numbers(name, needed=False) if table.has(name) else np.full(len(table), np.nan)


def _frames(table: TextTable, rows: RunRows, camera: Indices) -> Indices:
    """Number of the frame of each row by step or time, or by both if they agree, shape (k,)."""
    if not table.has("time_s"):
        return frames_at(rows, camera, table.whole_numbers("step", 0), table.problems)
    time_s, times_s = table.numbers("time_s"), rows.scene.times_s(0, rows.steps)
    step, count = np.full(len(table), NOBODY), len(rows.scene.cameras)
    for index in range(count):
        steps, here = rows.frames[rows.frames % count == index] // count, camera == index
        if len(steps):
            step[here] = steps[_nearest(times_s[steps], time_s[here])]
    unit = other_unit(time_s[~np.isnan(time_s)], float(times_s[-1]))
    off = (step == NOBODY) | (np.abs(time_s - times_s[step]) > TIME_TOLERANCE_S)

    def say(row: int) -> str:
        name = rows.scene.cameras[camera[row]].name
        near = "" if step[row] == NOBODY else f"; the nearest is {times_s[step[row]]:.9g}"
        return f"camera '{name}' takes no frame at time_s {time_s[row]:.9g}{near} (seconds since the first step){unit}"

    table.problems.refuse(off & ~np.isnan(time_s) & (camera != NOBODY), say)
    if table.has("step"):
        given = table.whole_numbers("step", 0)
        table.problems.refuse(
            (given != step) & (given != NOBODY) & ~off,
            lambda row: f"time_s {time_s[row]:.9g} is that of step {step[row]}, but step is {given[row]}",
        )
    return np.where(off, NOBODY, step * count + camera)


def _nearest(times_s: Array, wanted_s: Array) -> Indices:
    """Index of the nearest of some ascending times, shape (k,)."""
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(len(times_s) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times_s) - 1)
    closer: Indices = np.where(np.abs(times_s[before] - wanted_s) <= np.abs(times_s[after] - wanted_s), before, after)
    return closer
