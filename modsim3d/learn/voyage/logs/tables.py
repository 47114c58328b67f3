"""Tables, as CSV or Parquet: a row for each detection, and rows with empty boxes for frames without any."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted
from modsim3d.formats.reading.builder import Confidences, Problems
from modsim3d.io.input_files import MAX_FRAMES
from modsim3d.io.misreadings import no_commas
from modsim3d.io.text_table import TextTable
from modsim3d.io.validation import shown
from modsim3d.learn.voyage.logs import log
from modsim3d.tracks.diagnosis import CENTRE, CORNERS, TOP_LEFT, BoxForm

# ---- Frames without detections, of logs that only say what was detected ----

_OFF = 0.25  # how far a gap may be from a whole number of intervals: times are often those of the file's writing
_MAX_OFF = 0.05  # share of the gaps that may be further off where the interval is taken from the times themselves


@dataclass(frozen=True, eq=False)
class Filled:
    """Frames of a camera that must have been between those with detections."""

    time_s: Array  # the times that were added, (k,)
    rate_hz: float
    longest_s: float  # the longest time without any detection


def filled(time_s: Array, rate_hz: float | None, source: str) -> Filled:
    """The frames without detections between those with, whose times (n,) ascend; the frame rate is that of the usual
    gap between two frames if None. Raises InputError if the times fit no frame rate, or give too many frames."""
    gaps = np.diff(time_s)
    if not len(gaps):
        return Filled(np.empty(0), rate_hz or 1.0, 0.0)
    # The usual gap is that which most of those that are no multiple of it are near to: the median of the short half.
    interval = 1 / rate_hz if rate_hz else float(np.median(np.sort(gaps)[: max(1, (len(gaps) + 1) // 2)]))
    count = np.maximum(np.rint(gaps / interval), 1)
    off = np.abs(gaps / interval - count) > _OFF
    if off.mean() > (0 if rate_hz else _MAX_OFF):
        first = int(np.flatnonzero(off)[0])
        found = f"frames {gaps[first]:g} s apart after {time_s[first]:.12g} s"
        if rate_hz:
            problem = f"{found} do not fit --frame-rate {rate_hz:g}, which is a frame every {interval:g} s"
        else:
            problem = (
                f"its frames without detections cannot be known: the usual gap is {interval:g} s, with {found}; "
                "give --frame-rate, or a row with empty cells for each frame without detections"
            )
        raise InputError(source, [problem])
    if len(time_s) + count.sum() > MAX_FRAMES:
        problem = f"spans {len(time_s) + int(count.sum()):,} frames of {1 / interval:g} Hz, at most {MAX_FRAMES:,}"
        raise InputError(source, [problem])
    between = [time_s[k] + gaps[k] * np.arange(1, count[k]) / count[k] for k in np.flatnonzero(count > 1).tolist()]
    return Filled(np.concatenate([np.empty(0), *between]), 1 / interval, float(gaps.max()))


_TIMES, _SCORES, _LABELS = ("utc", "time_s", "time", "timestamp"), ("score", "confidence"), ("label", "class")
_EDGES = BoxForm("left, top, right, bottom", ("left", "top", "right", "bottom"), 0, CORNERS.to_corners)
_SIDES = BoxForm("left, top, width, height", ("left", "top", "width", "height"), 0, TOP_LEFT.to_corners)
_DETECTORS = tuple(  # as the tables of common detectors have them
    BoxForm(CORNERS.meaning, names, 0, CORNERS.to_corners)
    for names in (("x1", "y1", "x2", "y2"), ("xmin", "ymin", "xmax", "ymax"), ("x_min", "y_min", "x_max", "y_max"))
)
_FORMS = (_EDGES, _SIDES, *_DETECTORS, CORNERS, CENTRE)
_NEEDED = "time_s or utc; left, top, right, bottom or left, top, width, height; and perhaps camera, label, score"


def read_table_log(path: Path, options: log.LogOptions) -> log.DetectionLog:
    """The log of a table with a line of names. The frames are those of a file beside it, `frames…` beside
    `detections…`, as runs and exports have; or those of its rows, where some have empty boxes; or those that the frame
    rate adds between the rows' times. Raises InputError if the file is wrong; each problem names its line."""
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
    rows = log.LogRows(source, problems, confidences, form)
    for row, (corners, is_empty) in enumerate(zip(form.boxes_px(boxes).tolist(), empty.tolist(), strict=True)):
        frame = rows.frame(cameras[row], float(time_s[row]))
        if not is_empty:
            left, top, right, bottom = corners
            sides = [left, top, right - left, bottom - top]
            rows.add(frame, where[row], sides, labels[row], values[row])
    return rows.log(clock, _add_frames(path, rows, cameras, time_s, clock, bool(empty.any()), options))


def _score(text: str) -> float | str:
    """A finite number, or the text if it is none."""
    number = log.seconds(text)
    return text if np.isnan(number) else number


def _first(table: TextTable, names: Sequence[str]) -> str:
    """The first of some names that is a column; empty if none is."""
    return next((name for name in names if table.has(name)), "")


def _texts(table: TextTable, name: str) -> list[str | None]:
    """A column of texts, None where it is empty or not there."""
    if not table.has(name):
        return [None] * len(table)
    return [text or None for text in table.columns[name].to_pylist()]


def times_of(table: TextTable, source: str) -> tuple[Array, log.Clock]:
    """The time of each row, (k,), and what it counts from. Raises InputError if there are none, or one is wrong."""
    name = _first(table, _TIMES)
    if not name:
        problem = f"line 1: a column with the time is missing (got {_got(table)}); needed are {_NEEDED}"
        raise InputError(source, [problem])
    texts = table.columns[name].to_pylist()
    times = np.array([log.seconds(text) for text in texts])
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
    seconds_from = log.Clock.STAMP if name == "timestamp" else log.Clock.STEP
    return times, log.Clock.UTC if of_utc.any() else seconds_from


def _form(table: TextTable, source: str) -> BoxForm:
    for form in _FORMS:
        if all(table.has(name) for name in form.names):
            return form
    raise InputError(source, [f"line 1: columns of the box are missing (got {_got(table)}); needed are {_NEEDED}"])


def _got(table: TextTable) -> str:
    names = list(table.columns)
    return ", ".join(map(shown, names[:8])) + (", …" if len(names) > 8 else "") + no_commas(",".join(names))


def _add_frames(
    path: Path,
    rows: log.LogRows,
    cameras: Sequence[str | None],
    time_s: Array,
    clock: log.Clock,
    said: bool,
    options: log.LogOptions,
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
    if said and options.frame_rate_hz is None:
        return "its rows, some of which have empty boxes"
    of_camera = np.array([camera or "" for camera in cameras], dtype=object)
    said_of = []
    for camera in dict.fromkeys(cameras):
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
