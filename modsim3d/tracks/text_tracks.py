"""Tracks in text: a CSV file with a line of names, or files of MOTChallenge, one a camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, positions
from modsim3d.core.boxes import sizes
from modsim3d.core.errors import InputError
from modsim3d.io.input_files import read_text
from modsim3d.io.misreadings import no_commas, other_unit
from modsim3d.io.text_table import RowProblems, TextTable, named_lines
from modsim3d.io.validation import nearest, shown
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks import tracks
from modsim3d.tracks.diagnosis import CENTRE, CORNERS, MOT, TOP_LEFT, BoxForm
from modsim3d.tracks.tracks import COVARIANCES, Tracks, camera_sequence_names, covariances, source_of


@dataclass(frozen=True, eq=False)
class FileRows:
    """The k rows of a file."""

    problems: RowProblems
    frame: Indices  # number of the frame as in `RunRows`: (k,)
    track: Indices  # number of the track: (k,)
    numbers: Array  # the box as the file has it: (k, 4)
    form: BoxForm  # of these numbers
    label: Indices  # index of the label, `NOBODY` for none: (k,)
    confidence: Array  # NaN for none: (k,)
    covariance_px2: Array  # of the centre, NaN for none: (k, 2, 2)

    @property
    def boxes_px(self) -> Array:
        """Boxes as x_min, y_min, x_max, y_max, shape (k, 4)."""
        return self.form.boxes_px(self.numbers)

    def check(self, rows: RunRows) -> None:
        """Check all that a row says beside its frame. Raises InputError if a row cannot be right."""
        self._check_boxes(rows)
        self._check_attributes()
        self._check_once(rows)
        self.problems.settle()

    def _check_boxes(self, rows: RunRows) -> None:
        boxes = self.boxes_px
        width, height = sizes(boxes).T
        self.problems.refuse(
            ~((width > 0) & (height > 0)),  # NaN too
            lambda row: (
                f"the box has width {width[row]:g} and height {height[row]:g}, must be above 0 "
                f"({self._numbers(row)}, read as {self.form.meaning})"
            ),
        )
        cameras = rows.scene.cameras
        images = np.array([camera.intrinsics.image_size_px for camera in cameras])
        size = images[self.frame % len(cameras)]
        self.problems.refuse(
            tracks.far_tracks(boxes, np.column_stack([self.frame % len(cameras), self.track]), size),
            lambda row: f"{tracks.FAR}; the image has {size[row, 0]} x {size[row, 1]} px ({self._numbers(row)})",
        )

    def _check_attributes(self) -> None:
        self.problems.refuse(
            (self.confidence < 0) | (self.confidence > 1),
            lambda row: f"confidence must be from 0 to 1 (got {self.confidence[row]:g})",
        )
        (a, b), (_, d) = np.moveaxis(self.covariance_px2, 0, -1)
        present = ~np.isnan(self.covariance_px2)[:, [0, 0, 1], [0, 1, 1]]
        some = present.any(axis=1) & ~present.all(axis=1)
        self.problems.refuse(some, lambda row: "the covariance needs all three numbers, or none")
        self.problems.refuse(
            present.all(axis=1) & ~covariances(a, b, d),
            lambda row: (
                f"var_x_px2 {a[row]:g}, cov_xy_px2 {b[row]:g} and var_y_px2 {d[row]:g} are no covariance: both "
                "variances must be above 0, and their product above the square of cov_xy_px2"
            ),
        )

    def _check_once(self, rows: RunRows) -> None:
        order = np.lexsort((self.track, self.frame))  # stable: of equal ones the first in the file comes first
        again = (np.diff(self.frame[order]) == 0) & (np.diff(self.track[order]) == 0)
        before = np.full(len(order), NOBODY)
        before[order[1:][again]] = order[:-1][again]
        cameras = [camera.name for camera in rows.scene.cameras]

        def say(row: int) -> str:
            frame = int(self.frame[row])
            where = f"step {frame // len(cameras)} of camera '{cameras[frame % len(cameras)]}'"
            place = f"{self.problems.word} {self.problems.line[before[row]]}"
            return f"track {self.track[row]} is at {where} already ({place}): a track has one box in a frame"

        self.problems.refuse(before != NOBODY, say)

    def _numbers(self, row: int) -> str:
        pairs = zip(self.form.names, self.numbers[row].tolist(), strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def frames_at(rows: RunRows, camera: Indices, step: Indices, problems: RowProblems) -> Indices:
    """Number of the frame of each row; a camera that takes none at the step is a problem, shape (k,)."""
    count = len(rows.scene.cameras)
    wanted = step * count + camera
    valid = positions(rows.frames, np.where((camera < 0) | (step < 0), NOBODY, wanted)) != NOBODY

    def say(row: int) -> str:
        name = rows.scene.cameras[camera[row]].name
        steps = rows.frames[rows.frames % count == camera[row]] // count
        if not 0 <= step[row] < rows.steps:
            return f"there is no step {step[row]}: the run has steps 0 to {rows.steps - 1}"
        near = steps[np.argsort(np.abs(steps - step[row]), kind="stable")[:1]].tolist()
        return f"camera '{name}' takes no frame at step {step[row]}" + (f"; the nearest is {near[0]}" if near else "")

    problems.refuse(~valid & (camera >= 0) & (step != NOBODY), say)
    return np.where(valid, wanted, NOBODY)


def tracks_of(files: Sequence[FileRows], cameras: int) -> Tracks:
    """The checked rows of files as tracks."""
    names = ("frame", "track", "boxes_px", "label", "confidence", "covariance_px2")
    return Tracks.of(cameras, *(np.concatenate([getattr(file, name) for file in files]) for name in names))


TIME_TOLERANCE_S = 0.0005  # of a time from that of its frame: half a millisecond, for files with three decimals
_COLUMNS = ("camera", "step", "time_s", "track", *CORNERS.names, *CENTRE.names, "label", "confidence", *COVARIANCES)


def read_csv_tracks(path: Path, rows: RunRows) -> FileRows:
    """Read a file whose first line names its columns; their order, and that of the lines, does not matter. Raises
    InputError if the file cannot be read, a column is wrong, or a line has something that the run has not."""
    source = source_of(path)
    names, body = named_lines(path, "tracks")
    form = _form(names, rows, source)
    table = TextTable.of(body, names, source, first_line=2)
    many, cameras = len(table), [camera.name for camera in rows.scene.cameras]
    camera = table.names("camera", cameras) if table.has("camera") else np.zeros(many, dtype=np.int64)
    frame = _csv_frames(table, rows, camera)
    track = table.identities("track", 0)
    numbers = np.column_stack([table.numbers(name) for name in form.names])
    labels = rows.scene.detector.labels
    label = table.names("label", labels, needed=False)
    confidence = table.numbers("confidence", missing=("",))
    variances = [table.numbers(name, missing=("",)) for name in COVARIANCES]
    table.problems.settle()
    covariance = np.stack([variances[i] for i in (0, 1, 1, 2)], axis=-1).reshape(-1, 2, 2)
    return FileRows(table.problems, frame, track, numbers, form, label, confidence, covariance)


def _form(names: Sequence[str], rows: RunRows, source: str) -> BoxForm:
    """The form of the boxes of a file whose columns are right. Raises InputError if they are not."""
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
    forms = [form for form in (CORNERS, CENTRE) if set(form.names) & set(names)]
    if len(forms) != 1 or not set(forms[0].names) <= set(names):
        either = f"either {', '.join(CORNERS.names)} or {', '.join(CENTRE.names)}"
        problems.append(f"line 1: the columns of the box must be {either}")
    if 0 < len(set(COVARIANCES) & set(names)) < len(COVARIANCES):
        problems.append(f"line 1: {', '.join(COVARIANCES)} belong together")
    if problems:
        raise InputError(source, problems)
    return forms[0]


def _hint(name: str) -> str:
    hint = nearest(name, _COLUMNS)
    return hint if hint.startswith("did") else f"known: {', '.join(_COLUMNS)}; leave others out"


def _csv_frames(table: TextTable, rows: RunRows, camera: Indices) -> Indices:
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


_FIRST = ("frame", "identity", *MOT.names, "confidence")
_MIN_CELLS = 6
_NO_CONFIDENCE = -1
_DATA = "data"  # the folder inside that of a tracker in which evaluators look for its files


def read_mot_tracks(path: Path, rows: RunRows, cameras: Sequence[int] = ()) -> list[FileRows]:
    """Read the files of some cameras, all if there are none: a folder of them, or the only one. Raises InputError if a
    file is missing, is of no camera, cannot be read, or has a line that cannot be right."""
    return [_read(file, camera, rows) for camera, file in sorted(_files(path, rows, cameras).items())]


def _files(path: Path, rows: RunRows, cameras: Sequence[int]) -> Mapping[int, Path]:
    names = camera_sequence_names([camera.name for camera in rows.scene.cameras])
    needed = [names[index] for index in cameras or range(len(names))]
    wanted, source = ", ".join(f"{name}.txt" for name in needed), source_of(path)
    if path.is_file():
        if len(needed) > 1:
            problem = f"this is one file, and the run has {len(names)} cameras: give the folder with {wanted}"
            raise InputError(source, [problem])
        return {names.index(needed[0]): path}
    folder = path if any(path.glob("*.txt")) or not (path / _DATA).is_dir() else path / _DATA
    files = {file.stem: file for file in sorted(folder.glob("*.txt"))}
    if not files:
        raise InputError(source, [f"holds no tracks: neither tracks.json nor {wanted}"])
    problems = [_unknown(stem, names, rows) for stem in files if stem not in names]
    missing = [name for name in needed if name not in files]
    problems += [f"{name}.txt is missing: a tracker that found nothing leaves an empty file" for name in missing]
    if problems:
        raise InputError(source_of(folder), problems)
    return {names.index(stem): file for stem, file in files.items() if stem in needed}


def _unknown(stem: str, names: tuple[str, ...], rows: RunRows) -> str:
    of_class = {f"{name}-{tracks.plain_name(label)}" for name in names for label in rows.scene.detector.labels}
    if stem in of_class:
        return f"{stem}.txt is of one class: give the tracks of all classes together, as for the set modsim3d-all"
    return f"{stem}.txt is of no camera of the run ({nearest(stem, names)})"


def _read(path: Path, camera: int, rows: RunRows) -> FileRows:
    text, source = read_text(path, "tracks"), source_of(path)
    begin = next(filter(str.strip, text.splitlines()), ",".join(_FIRST))
    cells = begin.count(",") + 1
    if cells < _MIN_CELLS:
        form = f"frame,identity,{','.join(MOT.names)}"
        raise InputError(source, [f"a line must have at least {_MIN_CELLS} numbers with commas between them: {form}"])
    further = (f"number {index}" for index in range(len(_FIRST) + 1, cells + 1))
    table = TextTable.of(text, [*_FIRST, *further][:cells], source)
    many = len(table)
    labels = rows.scene.labels
    first = 1 if labels is None else labels.sequences[camera].first_frame
    frame = _mot_frames(table, rows, camera, first)
    track = table.identities("identity", _NO_CONFIDENCE)
    unknown = "identity is -1, as in a file of detections: tracks need one of 0 or more"
    table.problems.refuse(track == NOBODY, lambda row: unknown)
    numbers = np.column_stack([table.numbers(name) for name in MOT.names])
    confidence = table.numbers("confidence") if table.has("confidence") else np.full(many, np.nan)
    table.problems.settle()
    confidence = np.where(confidence == _NO_CONFIDENCE, np.nan, confidence)
    covariance = np.full((many, 2, 2), np.nan)
    meant = MOT if first else TOP_LEFT
    return FileRows(table.problems, frame, track, numbers, meant, np.full(many, NOBODY), confidence, covariance)


def _mot_frames(table: TextTable, rows: RunRows, camera: int, first: int) -> Indices:
    """Number of the frame of each row, which the file counts from `first`, shape (k,)."""
    taken = rows.frames[rows.frames % len(rows.scene.cameras) == camera]
    number = table.whole_numbers("frame", 0)
    name = rows.scene.cameras[camera].name
    problem = "frame is 0: frames count from 1, and here perhaps from 0"
    table.problems.refuse((number == 0) & (first == 1), lambda row: problem)
    has = f"camera '{name}' has frames {first} to {len(taken) - 1 + first}"
    table.problems.refuse(number >= len(taken) + first, lambda row: f"there is no frame {number[row]}: {has}")
    inside = (number >= first) & (number < len(taken) + first)
    frames = np.full(len(table), NOBODY)
    frames[inside] = taken[number[inside] - first]
    return frames
