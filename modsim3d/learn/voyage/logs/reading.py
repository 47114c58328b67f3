"""Readers of logs of detections, and which of them reads a file."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted
from modsim3d.formats.reading.builder import Confidences, Problems
from modsim3d.formats.reading.mot import number_lines, plain_lines, sequence_info
from modsim3d.io.input_files import COCO_BYTES_PER_VALUE, FRAMES_A_ROW, FREE_FRAMES, MAX_FRAMES, read_text
from modsim3d.io.misreadings import no_commas
from modsim3d.io.ros_bag import DETECTIONS_2D, NANO, BagMessage, is_bag, read_bag
from modsim3d.io.strict_text import load_json
from modsim3d.io.text_table import TextTable
from modsim3d.io.validation import shown
from modsim3d.learn.voyage.logs import log
from modsim3d.learn.voyage.logs.coco import SECTIONS, read_coco_log, read_lines_log, read_thesis_log
from modsim3d.learn.voyage.logs.log import Clock, DetectionLog, LogOptions, LogRows, seconds
from modsim3d.runs.camera_sequences import camera_sequences
from modsim3d.runs.files.overwrite import RUN_FILE, files_of_run
from modsim3d.runs.stored_run import opened_run
from modsim3d.tracks.diagnosis import CENTRE, CORNERS, MOT, TOP_LEFT, BoxForm

# ---- MOT challenge text, `det.txt` ----


def read_mot_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a file of frame, −1, x, y, width, height, confidence, perhaps a class; InputError if it is wrong."""
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    info = sequence_info(path, (math.nan, math.nan), source)
    rate_hz = options.frame_rate_hz or info.rate_hz
    if rate_hz is None:
        problem = "the frame rate is not known: give --frame-rate, or put seqinfo.ini beside or above the file"
        raise InputError(source, [problem])
    lines, notes = plain_lines(number_lines(path, "detections", ",", 7, problems), path.name, problems)
    classes = any(len(numbers) > 7 and numbers[7] >= 1 for _, numbers in lines)
    scores = ((where, numbers[6]) for where, numbers in lines)
    rows = LogRows(source, problems, Confidences.of(scores, options.confidence_scale, problems), MOT)
    most = min(max(info.frames, FREE_FRAMES + FRAMES_A_ROW * len(lines)), MAX_FRAMES)
    last = max([info.frames, *(int(numbers[0]) for _, numbers in lines if 1 <= numbers[0] <= most)])
    frames = [rows.frame(None, number / rate_hz, info.size_px) for number in range(last)]
    for where, numbers in lines:
        if not 1 <= numbers[0] <= most or numbers[0] != int(numbers[0]):
            problems.add(f"{where}: frame must be a whole number from 1 to {most} (got {numbers[0]:.15g})")
            continue
        x, y, width, height = numbers[2:6]
        label = _label(int(numbers[7]), options.labels) if classes and len(numbers) > 7 else None
        rows.add(frames[int(numbers[0]) - 1], where, [x - 1, y - 1, width, height], label, numbers[6])
    basis = "seqLength in seqinfo.ini" if info.frames >= last else "the frame numbers up to the last with a detection"
    at = "; its first frame is taken to be the scene's first step (--log-start gives another time)"
    return rows.log(Clock.STEP, f"{basis}, {rate_hz:g} Hz{'' if options.start else at}", notes=notes)


def _label(number: int, labels: tuple[str, ...]) -> str:
    return labels[number - 1] if 1 <= number <= len(labels) else f"class_{number}"


# ---- The detections of a run as a log ----


def read_run_log(folder: Path) -> DetectionLog:
    """The log of all cameras of a run; nothing of its truth is read. Raises ModsimError if it is no run."""
    run, source = opened_run(folder), f"detections {folder}"
    rows = LogRows(source, Problems(source), Confidences("confidence", 0, 1, True, ""))
    for sequence in camera_sequences(run, tuple(range(len(run.scene.cameras)))):
        frames = [rows.frame(sequence.camera.name, time_s, sequence.size_px) for time_s in sequence.times_s.tolist()]
        table, labels = sequence.detections, run.scene.detector.labels
        sides = np.column_stack([table.boxes_px[:, :2], table.boxes_px[:, 2:] - table.boxes_px[:, :2]]).tolist()
        columns = table.frame.tolist(), sides, table.label.tolist(), table.confidence.tolist()
        for row, (frame, box, label, score) in enumerate(zip(*columns, strict=True)):
            rows.add(frames[frame], f"{sequence.camera.name} row {row}", box, labels[label], score)
    return rows.log(Clock.STEP, "its table of frames")


# ---- ROS 2 bags with `vision_msgs/Detection2DArray` ----


def read_bag_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a bag, a folder or a file of it; topic `/bow/detections` is of camera `bow`. Raises ModsimError if it
    cannot be read, has no such topic, or rosbags is missing."""
    source = f"detections {path}"
    messages = list(read_bag(path, "detections", partial(_box_topics, source), _message))
    problems = Problems(source, options.skip_bad)
    topics = {_camera(topic): topic for topic, _, _ in messages}
    every = [(topic, stamp, k, entry) for topic, stamp, message in messages for k, entry in enumerate(message)]
    scores = [(f"{topic} at {stamp / NANO:.12g} s, [{k}]", score) for topic, stamp, k, (_, _, score, _) in every]
    given = any(score is not None for _, score in scores)
    confidences = Confidences.of(scores, options.confidence_scale, problems) if given else None
    rows = LogRows(source, problems, confidences, CENTRE)
    clock = Clock.UTC if messages and messages[0][1] >= log.MIN_UNIX_S * NANO else Clock.STAMP
    for topic, stamp, message in messages:
        where, camera = f"{topic} at {stamp / NANO:.12g} s", _camera(topic)
        if topics[camera] != topic:
            which = f"{topic} and {topics[camera]} are both of camera {shown(camera)}"
            raise InputError(source, [f"{which}: give a bag with one topic of a camera"])
        if (stamp >= log.MIN_UNIX_S * NANO) != (clock is Clock.UTC):
            raise InputError(source, [f"{where}: some stamps are Unix time and others are not"])
        if rows.has(camera, stamp / NANO):
            problems.add(f"{where}: another message has the same stamp")
            continue
        frame = rows.frame(camera, stamp / NANO)
        for k, (box, label, score, turn_rad) in enumerate(message):
            if abs(np.sin(turn_rad)) > 1e-6:  # half a turn changes nothing
                problems.add(f"{where}, [{k}]: bbox.center.theta must be 0, an upright box (got {turn_rad:g})")
                continue
            rows.add(frame, f"{where}, [{k}]", box, label, score)
    return rows.log(clock, "its messages")


def _camera(topic: str) -> str | None:
    parts = [part for part in topic.split("/") if part]
    return parts[-2] if len(parts) > 1 else None


def ros_name(camera: str) -> str:
    """Name of a scene's camera in topics."""
    token = re.sub(r"[^A-Za-z0-9]+", "_", camera).strip("_")
    return token if token[:1].isalpha() else f"camera_{token}".rstrip("_")


Found = tuple[list[float], str | None, float | None, float]
"""Left, top, width and height, label and score, and the angle by which the box is turned."""


def _box_topics(source: str, topics: Mapping[str, str]) -> list[str]:
    wanted = [topic for topic, kind in topics.items() if kind == DETECTIONS_2D]
    if not wanted:
        got = ", ".join(f"{topic} ({kind})" for topic, kind in topics.items()) or "no topic"
        raise InputError(source, [f"must have a topic of {DETECTIONS_2D} (got {got})"])
    return wanted


def _message(message: BagMessage) -> tuple[str, int, list[Found]]:
    """Topic, stamp in nanoseconds and detections of a message."""
    return message.topic, message.stamp_ns, [_detection(detection) for detection in message.content.detections]


def _detection(detection: Any) -> Found:
    box = detection.bbox
    centre = getattr(box.center, "position", box.center)  # vision_msgs 2 and 3 have x and y in the pose itself
    sides = [centre.x - box.size_x / 2, centre.y - box.size_y / 2, box.size_x, box.size_y]
    turn_rad = float(getattr(box.center, "theta", 0.0))
    hypotheses = [getattr(result, "hypothesis", result) for result in detection.results]  # vision_msgs 2 has none
    best = max(hypotheses, key=lambda hypothesis: float(hypothesis.score), default=None)
    if best is None:
        return sides, None, None, turn_rad
    label = best.class_id if hasattr(best, "class_id") else best.id  # as vision_msgs 2 calls it
    return sides, str(label) or None, float(best.score), turn_rad


_KNOWN = "a run folder, a ROS 2 bag, COCO .json, MOT .txt, .csv, .parquet, or .jsonl"


def read_log(path: Path, options: LogOptions = log.NO_OPTIONS) -> DetectionLog:
    """Read a log of detections, of a kind by name and beginning. Raises InputError if it is of none, or is wrong."""
    log = _reader(path, options)
    if options.images is not None and ".json" not in path.suffixes:
        raise InputError("--images", [f"is for COCO results, and {path} says itself when its images were taken"])
    of_run = (path / RUN_FILE).is_file() or path.name in files_of_run(path.parent)  # the run, or a file in its folder
    return replace(log.shifted(options.start), of_run=of_run)


def _reader(path: Path, options: LogOptions) -> DetectionLog:
    source = f"detections {path}"
    if not path.exists():
        raise InputError(source, ["no such file or folder"])
    if path.is_dir():
        if (path / RUN_FILE).is_file():
            return read_run_log(path)
        if is_bag(path):
            return read_bag_log(path, options)
        raise InputError(source, [f"is a folder, and neither a run nor a ROS 2 bag; a log is {_KNOWN}"])
    kinds = path.name.lower().removesuffix(".gz").rsplit(".", 1)
    kind = kinds[1] if len(kinds) > 1 else ""
    if is_bag(path):
        return read_bag_log(path, options)
    if kind in ("jsonl", "ndjson"):
        return read_lines_log(path, options)
    if kind == "json":
        return _json(path, source, options)
    if kind == "parquet":
        return read_table_log(path, options)
    if kind in ("txt", "csv"):
        return read_mot_log(path, options) if _begins_with_numbers(path) else read_table_log(path, options)
    raise InputError(source, [f"its name does not say what it is; a log is {_KNOWN}"])


def _begins_with_numbers(path: Path) -> bool:
    """Whether the first line of a text is numbers, as MOT's are, and not names of columns."""
    first = next((line for line in read_text(path, "detections").splitlines() if line.strip()), "")
    try:
        [float(part) for part in first.strip().rstrip(",").split(",")]
    except ValueError:
        return False
    return True


def _json(path: Path, source: str, options: LogOptions) -> DetectionLog:
    content = load_json(path, "detections", COCO_BYTES_PER_VALUE)
    if isinstance(content, list):
        if options.images is None:
            problem = "COCO results do not say when their images were taken: give the COCO file of these with --images"
            raise InputError(source, [problem])
        images: Any = load_json(options.images, "images", COCO_BYTES_PER_VALUE)
        return read_coco_log(path, content, images, options)
    if isinstance(content, dict) and any(key in content for key in SECTIONS):
        if missing := [key for key in SECTIONS if key not in content]:
            raise InputError(source, [f"{key}: missing" for key in missing])
        return read_coco_log(path, content, None, options)
    if isinstance(content, dict):
        return read_thesis_log(path, content, options)
    raise InputError(source, [f"must be COCO or a mapping from times to detections (got {shown(content)})"])


# ---- Tables, as CSV or Parquet: a row for each detection, rows with empty boxes for frames without any ----

_OFF = 0.25  # how far a gap may be from a whole number of intervals: times are often those of the file's writing
_MAX_OFF = 0.05  # share of the gaps that may be further off where the interval is taken from the times themselves


@dataclass(frozen=True, eq=False)
class EmptyFrames:
    """Frames of a camera that must have been between those with detections."""

    time_s: Array  # the times that were added, (k,)
    rate_hz: float
    longest_s: float  # the longest time without any detection


def filled(time_s: Array, rate_hz: float | None, source: str) -> EmptyFrames:
    """Frames without detections between those with, of times (n,), at a rate, by default that of the usual gap. Raises
    InputError if no rate fits, or frames are too many."""
    gaps = np.diff(time_s)
    if not len(gaps):
        return EmptyFrames(np.empty(0), rate_hz or 1.0, 0.0)
    # The usual gap is that which most of those that are no multiple of it are near to: the median of the short half.
    interval = 1 / rate_hz if rate_hz else float(np.median(np.sort(gaps)[: max(1, (len(gaps) + 1) // 2)]))
    count = np.maximum(np.rint(gaps / interval), 1)
    off = np.abs(gaps / interval - count) > _OFF
    if off.mean() > (0 if rate_hz else _MAX_OFF):
        first = int(np.flatnonzero(off)[0])
        gap = f"frames {gaps[first]:g} s apart after {time_s[first]:.12g} s"
        if rate_hz:
            problem = f"{gap} do not fit --frame-rate {rate_hz:g}, which is a frame every {interval:g} s"
        else:
            problem = (
                f"its frames without detections cannot be known: the usual gap is {interval:g} s, with {gap}; "
                "give --frame-rate, or a row with empty cells for each frame without detections"
            )
        raise InputError(source, [problem])
    if len(time_s) + count.sum() > MAX_FRAMES:
        problem = f"spans {len(time_s) + int(count.sum()):,} frames of {1 / interval:g} Hz, at most {MAX_FRAMES:,}"
        raise InputError(source, [problem])
    between = [time_s[k] + gaps[k] * np.arange(1, count[k]) / count[k] for k in np.flatnonzero(count > 1).tolist()]
    return EmptyFrames(np.concatenate([np.empty(0), *between]), 1 / interval, float(gaps.max()))


_TIMES, _SCORES, _LABELS = ("utc", "time_s", "time", "timestamp"), ("score", "confidence"), ("label", "class")
_EDGES = BoxForm("left, top, right, bottom", ("left", "top", "right", "bottom"), 0, CORNERS.to_corners)
_SIDES = BoxForm("left, top, width, height", ("left", "top", "width", "height"), 0, TOP_LEFT.to_corners)
_DETECTORS = tuple(  # as the tables of common detectors have them
    BoxForm(CORNERS.meaning, names, 0, CORNERS.to_corners)
    for names in (("x1", "y1", "x2", "y2"), ("xmin", "ymin", "xmax", "ymax"), ("x_min", "y_min", "x_max", "y_max"))
)
_FORMS = (_EDGES, _SIDES, *_DETECTORS, CORNERS, CENTRE)
_NEEDED = "time_s or utc; left, top, right, bottom or left, top, width, height; and perhaps camera, label, score"


def read_table_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a table with a line of names. Frames are of a file beside it, `frames…` beside `detections…`, as runs
    and exports have; or its rows, if some have empty boxes; or what the rate adds. InputError names wrong lines."""
    source = f"detections {path}"
    table = TextTable.read(path, "detections")
    time_s, clock = times_of(table, source)
    form = _form(table, source)
    boxes = np.column_stack([table.numbers(name, missing=("",)) for name in form.names])
    empty = np.asarray(np.isnan(boxes).all(axis=1), dtype=bool)
    partial = np.isnan(boxes).any(axis=1) & ~empty
    table.problems.refuse(partial, lambda _: f"{', '.join(form.names)} must be numbers, or all be empty")
    table.problems.settle()
    cameras = _texts(table, "camera")
    labels, scores = (_texts(table, _first(table, names)) for names in (_LABELS, _SCORES))
    problems = Problems(source, options.skip_bad)
    values = [None if text is None else _score(text) for text in scores]
    where = [f"{table.problems.word} {line}" for line in table.problems.line.tolist()]
    confidences = None
    if any(value is not None for value in values):
        confidences = Confidences.of(zip(where, values, strict=True), options.confidence_scale, problems, "score")
    rows = LogRows(source, problems, confidences, form)
    for row, (corners, is_empty) in enumerate(zip(form.boxes_px(boxes).tolist(), empty.tolist(), strict=True)):
        frame = rows.frame(cameras[row], float(time_s[row]))
        if not is_empty:
            left, top, right, bottom = corners
            rows.add(frame, where[row], [left, top, right - left, bottom - top], labels[row], values[row])
    return rows.log(clock, _add_frames(path, rows, cameras, time_s, clock, bool(empty.any()), options))


def _score(text: str) -> float | str:
    """A finite number, or the text if it is none."""
    number = seconds(text)
    return text if np.isnan(number) else number


def _first(table: TextTable, names: Sequence[str]) -> str:
    """The first of some names that is a column; empty if none is."""
    return next((name for name in names if table.has(name)), "")


def _texts(table: TextTable, name: str) -> list[str | None]:
    if not table.has(name):
        return [None] * len(table)
    return [text or None for text in table.columns[name].to_pylist()]


def times_of(table: TextTable, source: str) -> tuple[Array, Clock]:
    """The time of each row, (k,), and what it counts from. Raises InputError if there are none, or one is wrong."""
    name = _first(table, _TIMES)
    if not name:
        problem = f"line 1: a column with the time is missing (got {_got(table)}); needed are {_NEEDED}"
        raise InputError(source, [problem])
    texts = table.columns[name].to_pylist()
    times = np.array([seconds(text) for text in texts])
    of_utc = np.isnan(times)
    times = np.where(of_utc, [log.utc_s(text) if bad else 0.0 for text, bad in zip(texts, of_utc, strict=True)], times)
    table.problems.refuse(
        np.isnan(times),
        lambda row: (
            f"{name} must be seconds, or a time such as {log.TIME_FORM} (got {shown(texts[row])}"
            f"{', which may be milliseconds' if texts[row].strip().isdigit() else ''})"
        ),
    )
    table.problems.settle()
    of_utc |= times >= log.MIN_UNIX_S
    table.problems.refuse(
        ~of_utc & (name == "utc"),
        lambda row: (
            f"utc must be a time such as {log.TIME_FORM}, or Unix time (got {shown(texts[row])}): seconds since the "
            "scene's first step are time_s"
        ),
    )
    table.problems.settle()
    table.problems.refuse(of_utc != of_utc[:1].any(), lambda row: f"{name}: {log.MIXED}")
    table.problems.settle()
    return times, Clock.UTC if of_utc.any() else Clock.STAMP if name == "timestamp" else Clock.STEP


def _form(table: TextTable, source: str) -> BoxForm:
    for form in _FORMS:
        if all(table.has(name) for name in form.names):
            return form
    raise InputError(source, [f"line 1: columns of the box are missing (got {_got(table)}); needed are {_NEEDED}"])


def _got(table: TextTable) -> str:
    names = list(table.columns)
    return ", ".join(map(shown, names[:8])) + (", …" if len(names) > 8 else "") + no_commas(",".join(names))


def _add_frames(
    path: Path, rows: LogRows, names: Sequence[str | None], time_s: Array, clock: Clock, void: bool, options: LogOptions
) -> str:
    """Add the frames without detections to the rows, and say how they are known."""
    beside = path.with_name(path.name.replace("detections", "frames", 1))
    if beside != path and beside.is_file():
        frames = TextTable.read(beside, "frames")
        times, other = times_of(frames, f"frames {beside}")
        if other is not clock:
            raise InputError(f"frames {beside}", [f"has times in {other.value}, and {path.name} in {clock.value}"])
        lacking = np.flatnonzero(~np.isin(time_s, times))
        if len(lacking):
            first = f"{counted(len(lacking), 'detection')} (first {time_s[lacking[0]]:.12g})"
            raise InputError(f"frames {beside}", [f"lacks the time of {first}: write both files with the same digits"])
        for camera, time in zip(_texts(frames, "camera"), times.tolist(), strict=True):
            rows.frame(camera, time)
        return f"the rows of {beside.name}"
    if void and options.frame_rate_hz is None:
        return "its rows, some of which have empty boxes"
    of_camera = np.array([camera or "" for camera in names], dtype=object)
    said_of = []
    for camera in dict.fromkeys(names):
        seen = np.unique(time_s[of_camera == (camera or "")])
        more = filled(seen, options.frame_rate_hz, rows.source)
        for time in more.time_s.tolist():
            rows.frame(camera, time)
        named = "" if camera is None else f" of {camera}"
        said_of.append(
            f"{more.rate_hz:.4g} Hz{named}: {len(more.time_s):,} without detections were added to {len(seen):,}, in "
            f"gaps of up to {more.longest_s:.3g} s"
        )
    how = "--frame-rate" if options.frame_rate_hz else "the usual gap between its times"
    return f"{how}, {'; '.join(said_of)}"
