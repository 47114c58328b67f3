"""Log of a detector during a voyage: frames with their times, and the boxes in them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import from_top_left
from modsim3d.core.errors import InputError
from modsim3d.core.text import counted, number_in
from modsim3d.formats.reading.builder import NOT_GIVEN, Confidences, Problems, check_whole, valid_box
from modsim3d.io.input_files import composed
from modsim3d.scene.ais.options import time_text
from modsim3d.tracks.diagnosis import CORNERS, TOP_LEFT, BoxForm

NO_LABEL = -1
_SHARES = 2.0  # boxes in shares of an image are no further from its corner than this


class Clock(Enum):
    """Origin of the times of a log."""

    STEP = "seconds since the scene's first step"
    STAMP = "seconds as the scene's poses write them"
    UTC = "UTC"


@dataclass(frozen=True)
class Start:
    """The time of a log's zero: Unix seconds if the clock is `UTC`, else seconds since the scene's first step."""

    time_s: float
    clock: Clock


@dataclass(frozen=True)
class LogOptions:
    """Facts that logs do not state themselves.

    Attributes:
        frame_rate_hz: Of MOT without `seqinfo.ini`, and of tables, to know the frames without detections.
        start: The time of the log's zero, which is that of the first frame in MOT.
        images: COCO file with the images that COCO results name.
        labels: Names of the classes of MOT from number 1.
        confidence_scale: Confidences that stand for 0 and for 1; None if they are from 0 to 1.
        category_offset: Number to add to the category IDs of COCO results.
        skip_bad: Leave out wrong entries and count them.
    """

    frame_rate_hz: float | None = None
    start: Start | None = None
    images: Path | None = None
    labels: tuple[str, ...] = ()
    confidence_scale: tuple[float, float] | None = None
    category_offset: int = 0
    skip_bad: bool = False


NO_OPTIONS = LogOptions()


@dataclass(frozen=True, eq=False)
class DetectionLog:
    """F frames in order of camera and time, and D detections in order of frame."""

    source: str  # what messages call the log
    clock: Clock
    cameras: tuple[str | None, ...]  # names; None for the one of a log that names none
    camera: Indices  # of each frame, (F,)
    time_s: Array  # of each frame; Unix time if the clock is `UTC`, (F,)
    size_px: Array  # width and height of each frame, nan where unknown, (F, 2)
    labels: tuple[str, ...]  # names of the classes; none if the log names no classes
    frame: Indices  # of each detection, non-decreasing, (D,)
    label: Indices  # index into the labels, −1 without, (D,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, (D, 4)
    confidence: Array  # in [0, 1], nan where not given, (D,)
    frames_from: str  # how the frames are known, those without detections included
    notes: tuple[str, ...] = ()  # what the reader left out or took for granted
    of_run: bool = False  # whether a run wrote it, so that its clock is the scene's own
    form: BoxForm = TOP_LEFT  # of the boxes in the file

    @property
    def span(self) -> str:
        """The times of the first and the last frame in words."""
        return " to ".join(self.when(float(time)) for time in (self.time_s.min(), self.time_s.max()))

    def when(self, time_s: float) -> str:
        """A time of the log in words."""
        return time_text(time_s) if self.clock is Clock.UTC else f"{time_s:.12g} s"

    def shifted(self, start: Start | None) -> DetectionLog:
        """The log with the time of its zero. Raises InputError if one is given, and the log needs none."""
        if start is None:
            return self
        if self.clock is Clock.UTC:
            problem = "the log has times in UTC: leave --log-start out, which is for logs that count from 0"
            raise InputError(self.source, [problem])
        return replace(self, time_s=self.time_s + start.time_s, clock=start.clock)

    def take(self, frames: Mask) -> DetectionLog:
        """Some of its frames, shape (F,), with their detections."""
        kept = np.flatnonzero(frames)
        place = np.full(len(self.time_s), -1)
        place[kept] = np.arange(len(kept))
        rows = np.flatnonzero(place[self.frame] >= 0)
        return replace(
            self,
            camera=self.camera[kept],
            time_s=self.time_s[kept],
            size_px=self.size_px[kept],
            frame=place[self.frame[rows]],
            label=self.label[rows],
            boxes_px=self.boxes_px[rows],
            confidence=self.confidence[rows],
        )


@dataclass
class LogRows:
    """Frames and detections as they are read; detections name their frame by its number here."""

    source: str  # what messages call the log
    problems: Problems
    confidences: Confidences | None = None  # how they are read; None if it gives none
    form: BoxForm = TOP_LEFT  # of its boxes
    _frames: dict[tuple[str | None, float], int] = field(default_factory=dict)
    _sizes: list[tuple[float, float]] = field(default_factory=list)
    _labels: dict[str, int] = field(default_factory=dict)
    _rows: list[tuple[int, int, float]] = field(default_factory=list)
    _boxes: list[list[float]] = field(default_factory=list)
    _with_class: dict[bool, str] = field(default_factory=dict)

    def frame(self, camera: str | None, time_s: float, size_px: tuple[float, float] = (np.nan, np.nan)) -> int:
        """Number of the frame of a camera at a time, which may be a new one."""
        number = self._frames.setdefault((camera, time_s), len(self._frames))
        if number == len(self._sizes):
            self._sizes.append(size_px)
        return number

    def has(self, camera: str | None, time_s: float) -> bool:
        """Whether a camera has a frame at a time already."""
        return (camera, time_s) in self._frames

    def add(self, frame: int, where: str, box: Sequence[float], label: str | None, confidence: object = None) -> None:
        """Append a detection with its left, top, width and height in pixels; a problem if it is wrong. `frame` is the
        number of its frame, `where` its place in the file; the label is None if the log names none."""
        score: float | None = np.nan
        if self.confidences is not None:
            score = self.confidences.read(NOT_GIVEN if confidence is None else confidence, where, self.problems)
        if score is None or not valid_box(list(box), where, self.problems):
            if score is not None and self.form.to_corners is CORNERS.to_corners:
                meant = f"boxes are read as {self.form.meaning}: are the last two width and height?"
                self.problems.hint = self.problems.hint or meant
            return
        number = NO_LABEL if label is None else self._labels.setdefault(composed(label), len(self._labels))
        self._with_class.setdefault(label is not None, where)
        self._rows.append((frame, number, score))
        self._boxes.append(list(box))

    def log(
        self, clock: Clock, frames_from: str, labels: Mapping[str, int] | None = None, notes: Sequence[str] = ()
    ) -> DetectionLog:
        """The log. `frames_from` says how its frames are known; `labels` name all classes in the order of the file,
        those met if None; `notes` are assumptions. Raises InputError if entries are wrong, there is no frame, or only
        some have a class."""
        notes = [*notes, *self.problems.settle(), *(self.confidences.notes if self.confidences else [])]
        if not self._frames:
            raise InputError(self.source, ["holds no frame: it needs the times of some, with or without detections"])
        number = np.array([row[1] for row in self._rows], dtype=np.int64)
        if len(self._with_class) == 2:
            which = f"{self._with_class[True]} has a class, and {self._with_class[False]} has none"
            raise InputError(self.source, [f"{which}: give one to all detections, or to none"])
        names = list(self._labels)
        check_whole(names, self.source)
        if labels is not None:
            order = sorted(labels, key=lambda name: labels[name])
            place = {name: k for k, name in enumerate(order)}
            number = np.array([place[names[label]] for label in number.tolist()], dtype=np.int64)
            names = order
        cameras = tuple(dict.fromkeys(camera for camera, _ in self._frames))
        index = {name: k for k, name in enumerate(cameras)}
        camera = np.array([index[name] for name, _ in self._frames], dtype=np.int64)
        time_s = np.array([time for _, time in self._frames])
        order_of_frames = np.lexsort((time_s, camera))
        frame = np.argsort(order_of_frames)[np.array([row[0] for row in self._rows], dtype=np.int64)]
        boxes_px = from_top_left(np.array(self._boxes, dtype=np.float64).reshape(-1, 4))
        if len(boxes_px) and (np.abs(boxes_px) <= _SHARES).all():
            problem = f"all boxes lie within {_SHARES:g} px of the image's corner: give pixels, not shares of the image"
            raise InputError(self.source, [problem])
        rows = np.argsort(frame, kind="stable")
        log = DetectionLog(
            source=self.source,
            clock=clock,
            cameras=cameras,
            camera=camera[order_of_frames],
            time_s=time_s[order_of_frames],
            size_px=np.array(self._sizes, dtype=np.float64).reshape(-1, 2)[order_of_frames],
            labels=tuple(names),
            frame=frame[rows],
            label=number[rows],
            boxes_px=boxes_px[rows],
            confidence=np.array([row[2] for row in self._rows], dtype=np.float64)[rows],
            frames_from=frames_from,
            notes=tuple(notes),
            form=self.form,
        )
        return _unique(log)


def _unique(log: DetectionLog) -> DetectionLog:
    """The log with each detection once, and a remark if some are there again."""
    sure = np.nan_to_num(log.confidence, nan=NOT_GIVEN)
    _, first = np.unique(np.column_stack([log.frame, log.label, sure, log.boxes_px]), axis=0, return_index=True)
    again = np.setdiff1d(np.arange(len(log.frame)), first)
    if not len(again):
        return log
    kept, when = np.sort(first), log.when(float(log.time_s[log.frame[again[0]]]))
    which = f"{counted(len(again), 'detection is', 'detections are')} there a second time (first at {when})"
    note = f"{log.source}: {which}, with the same time, box, class and confidence: each counts once"
    columns = {name: getattr(log, name)[kept] for name in ("frame", "label", "boxes_px", "confidence")}
    return replace(log, **columns, notes=(*log.notes, note))


# ---- Times in logs ----

MIN_UNIX_S = 1e8  # a number of seconds from here on, March 1973, is Unix time: no scene lasts three years
MAX_S = 1e11
MIXED = "some times are UTC and others are not (from 1e8 on, seconds are Unix time; are these nanoseconds?)"
TIME_FORM = "2024-01-04T10:00:00.250Z"  # a time as messages show it
_EXIF_DAY = re.compile(r"(\d{4}):(\d\d):(\d\d)(?= )")  # as cameras write a date into their images: 2024:01:04 10:00:00


def utc_s(text: str) -> float:
    """Unix time from a date and time of ISO 8601 or EXIF, NaN if it is none; without a zone it is UTC."""
    try:
        when = datetime.fromisoformat(_EXIF_DAY.sub(r"\1-\2-\3", text.strip().replace("/", "-"), count=1))
        return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return math.nan


def seconds(text: str) -> float:
    """A finite number of seconds, NaN if the text is none."""
    number = number_in(text)
    return number if abs(number) <= MAX_S else math.nan


def time_of(value: object) -> tuple[float, bool]:
    """The time that a number or a text stands for, NaN if none, and whether it is UTC, as Unix time."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan, False
    number = seconds(str(value))
    if math.isnan(number):
        return (utc_s(value), True) if isinstance(value, str) else (math.nan, False)
    return number, number >= MIN_UNIX_S


def all_utc(utc: Sequence[bool]) -> bool | None:
    """Whether all times are UTC; None if some are and others are not."""
    return None if any(utc) and not all(utc) else any(utc)
