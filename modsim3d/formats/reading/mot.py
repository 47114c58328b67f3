"""MOT challenge text: `gt.txt` and `det.txt`.

A line of truth is frame, identity, x, y, width, height, flag (0 is ignored), class, visibility. A line of detections is
frame, −1, x, y, width, height, confidence, and a class if the eighth number is 1 or more; if no line has a class, there
is only one label. A `seqinfo.ini` beside or above the truth gives the size of the images, their number and the frame
rate.
"""

from __future__ import annotations

import configparser
import math
from dataclasses import dataclass
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.builder import (
    NO_OPTIONS,
    AnnotationRows,
    ImageRows,
    Place,
    Problems,
    ReadOptions,
    ResultRows,
    labelled_set,
    valid_box,
)
from modsim3d.formats.reading.text_lines import number_lines

_MOST_FRAMES = 10_000_000
"""A larger number is no frame but something else, such as a time."""


@dataclass(frozen=True)
class _Sequence:
    size_px: tuple[float, float]
    frames: int
    rate_hz: float | None


Lines = list[tuple[str, list[float]]]
"""Where each line is, and its numbers."""


def read_mot(condition: str, truth: Path, detections: Path, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition, a sequence of frames, from `gt.txt` and `det.txt`.

    A frame rate that is given overrides that of `seqinfo.ini`; if neither gives one, frames have no times.

    Raises:
        InputError: The files are wrong; each problem names its line.
    """
    labels, problems = options.labels, Problems(f"ground truth {truth}", options.skip_bad)
    annotated = list(number_lines(truth, "ground truth", ",", 6, problems))
    wrong = Problems(f"detections {detections}", options.skip_bad)
    detected = list(number_lines(detections, "detections", ",", 7, wrong))
    info = _sequence(truth, options.image_size_px, problems.source)
    names = _class_names(annotated, detected, labels)
    to_label = {number: k for k, number in enumerate(names)}
    annotations = _annotations(annotated, to_label, problems)
    results = _results(detected, to_label, wrong)
    notes = problems.settle() + wrong.settle()
    rate_hz = options.frame_rate_hz or info.rate_hz
    if rate_hz is None:
        notes.append(f"{condition}: the frame rate is not known, so frames have no times: give --frame-rate")
    images = ImageRows()
    for frame in range(max([info.frames, *(place.image + 1 for place in annotations.places + results.places)])):
        time_s = math.nan if rate_hz is None else frame / rate_hz
        images.add(f"{condition} frame {frame + 1}", info.size_px, time_s=time_s)
    only = (labels[0] if labels else "object",)
    return labelled_set(condition, tuple(names.values()) or only, images, annotations, results, notes)


def _class_of(numbers: list[float]) -> int:
    """The class of a line, −1 where it has none."""
    return int(numbers[7]) if len(numbers) > 7 else -1


def _class_names(annotated: Lines, detected: Lines, labels: tuple[str, ...]) -> dict[int, str]:
    """Names of the classes by number; none if detections name no classes."""
    if not any(_class_of(numbers) >= 1 for _, numbers in detected):
        return {}
    classes = sorted({number for _, numbers in annotated + detected if (number := _class_of(numbers)) >= 1})
    return {number: labels[number - 1] if number <= len(labels) else f"class_{number}" for number in classes}


def _annotations(lines: Lines, to_label: dict[int, int], problems: Problems) -> AnnotationRows:
    rows = AnnotationRows()
    for where, numbers in lines:
        identity = int(numbers[1]) if numbers[1] >= 0 else None
        if rows.has(int(numbers[0]) - 1, identity):
            problems.add(f"{where}: identity {identity} is in frame {numbers[0]:g} already")
            continue
        place = _place(where, numbers, problems, to_label)
        if place is not None:
            visible = numbers[8] if len(numbers) > 8 and 0 <= numbers[8] <= 1 else math.nan
            ignored = len(numbers) > 6 and numbers[6] == 0
            rows.add(place, ignored=ignored, identity=identity, visible_fraction=visible)
    return rows


def _results(lines: Lines, to_label: dict[int, int], problems: Problems) -> ResultRows:
    rows = ResultRows()
    for where, numbers in lines:
        if not 0 <= numbers[6] <= 1:
            problems.add(f"{where}: confidence must be from 0 to 1 (got {numbers[6]:g})")
            continue
        place = _place(where, numbers, problems, to_label)
        if place is not None:
            rows.add(place, numbers[6])
    return rows


def _place(where: str, numbers: list[float], problems: Problems, to_label: dict[int, int]) -> Place | None:
    """Image, label and box of a line; None with a problem if it has none."""
    frame, number = numbers[0], _class_of(numbers)
    if not 1 <= frame <= _MOST_FRAMES or frame != int(frame):
        problems.add(f"{where}: frame must be a whole number from 1 to {_MOST_FRAMES} (got {frame:g})")
    elif to_label and number not in to_label:
        problems.add(f"{where}: has no class in its eighth column, but detections have (got {number})")
    elif valid_box(numbers[2:6], where, problems):
        return Place(int(frame) - 1, to_label[number] if to_label else 0, numbers[2:6])
    return None


def _sequence(truth: Path, size_px: tuple[float, float] | None, source: str) -> _Sequence:
    for folder in (truth.parent, truth.parent.parent):
        path = folder / "seqinfo.ini"
        if not path.is_file():
            continue
        parser = configparser.ConfigParser()
        try:
            parser.read(path, encoding="utf-8")
            section = parser["Sequence"]
            size = (float(section["imWidth"]), float(section["imHeight"]))
            frames = int(section.get("seqLength", "0"))
            rate_hz = float(section["frameRate"]) if "frameRate" in section else None
        except (configparser.Error, KeyError, ValueError) as error:
            raise InputError(f"sequence {path}", [f"needs imWidth and imHeight under [Sequence]: {error}"]) from None
        given = (*size, 1.0 if rate_hz is None else rate_hz)
        if not all(0 < value < math.inf for value in given) or not 0 <= frames <= _MOST_FRAMES:
            got = f"{size[0]:g}, {size[1]:g}, {given[2]:g} and seqLength {frames}"
            raise InputError(f"sequence {path}", [f"imWidth, imHeight and frameRate must be above 0 (got {got})"])
        return _Sequence(size, frames, rate_hz)
    if size_px is None:
        raise InputError(
            source, ["the size of the images is not known: give --image-size, or put seqinfo.ini beside or above it"]
        )
    return _Sequence(size_px, 0, None)
