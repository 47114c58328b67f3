"""MOT challenge text: `gt.txt` and `det.txt`.

Truth: frame, identity, x, y, width, height, flag (0 is ignored), class, visibility. Detections: frame, −1, x, y, width,
height, confidence, and a class where the eighth number is 1 or more; without one, all labels are one. A `seqinfo.ini`
in the folder of the truth, or above it, gives the size of the images, their number and the frame rate.
"""

from __future__ import annotations

import configparser
import math
from dataclasses import dataclass
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.learn.labelled import Labelled
from modsim3d.learn.reading.builder import Problems, Rows, corners, one_condition
from modsim3d.learn.reading.text_lines import number_lines

_MOST_FRAMES = 10_000_000
"""More is no frame number but something else, such as a time."""


@dataclass(frozen=True)
class _Sequence:
    size_px: tuple[float, float]
    frames: int
    rate_hz: float | None


def read_mot(
    condition: str,
    truth: Path,
    detections: Path,
    labels: tuple[str, ...] = (),
    image_size_px: tuple[float, float] | None = None,
    skip_bad: bool = False,
    frame_rate_hz: float | None = None,
) -> Labelled:
    """One condition, a sequence of frames.

    Args:
        condition: Its name.
        truth: `gt.txt`.
        detections: `det.txt`.
        labels: Names of the classes 1, 2, ...
        image_size_px: Width and height, where there is no `seqinfo.ini`.
        skip_bad: Leave out lines that something is wrong with, and count them.
        frame_rate_hz: In place of that of `seqinfo.ini`; of neither, frames have no times.

    Raises:
        InputError: Something is wrong; each problem names its line.
    """
    problems = Problems(f"ground truth {truth}", skip_bad)
    known = list(number_lines(truth, "ground truth", ",", 6, problems))
    wrong = Problems(f"detections {detections}", skip_bad)
    given = list(number_lines(detections, "detections", ",", 7, wrong))
    info = _sequence(truth, image_size_px, problems.source)
    classed = any(len(numbers) > 7 and numbers[7] >= 1 for _, numbers in given)
    classes = sorted({int(numbers[7]) for _, numbers in known + given if len(numbers) > 7 and numbers[7] >= 1})
    names = {number: labels[number - 1] if number <= len(labels) else f"class_{number}" for number in classes}
    names = names if classed and names else {}
    to_label = {number: k for k, number in enumerate(names)}
    only = (labels[0] if labels else "object",)
    rows, found = Rows(), Rows()
    for where, numbers in known:
        identity = int(numbers[1]) if numbers[1] >= 0 else None
        if rows.has(int(numbers[0]) - 1, identity):
            problems.add(f"{where}: identity {identity} is in frame {numbers[0]:g} already")
            continue
        box = _row(where, numbers, problems, rows, to_label)
        if box is None:
            continue
        ignored = len(numbers) > 6 and numbers[6] == 0
        rows.ignored.append(ignored)
        rows.crowd.append(False)
        rows.identify(rows.image[-1], identity)
        rows.visible_fraction.append(numbers[8] if len(numbers) > 8 and 0 <= numbers[8] <= 1 else math.nan)
        rows.distance_m.append(math.nan)
    for where, numbers in given:
        if not 0 <= numbers[6] <= 1:
            wrong.add(f"{where}: confidence must be from 0 to 1 (got {numbers[6]:g})")
        elif _row(where, numbers, wrong, found, to_label) is not None:
            found.confidence.append(numbers[6])
            found.probabilities.append(None)
    notes = problems.settle() + wrong.settle()
    rate_hz = frame_rate_hz or info.rate_hz
    if rate_hz is None:
        notes.append(f"{condition}: the frame rate is not known, so frames have no times: give --frame-rate")
    count = max([info.frames, *(image + 1 for image in rows.image + found.image)])
    return one_condition(
        condition,
        tuple(names.values()) or only,
        [f"{condition} frame {frame + 1}" for frame in range(count)],
        [info.size_px] * count,
        rows,
        found,
        notes,
        [0] * count,
        [math.nan if rate_hz is None else frame / rate_hz for frame in range(count)],
    )


def _row(
    where: str, numbers: list[float], problems: Problems, rows: Rows, to_label: dict[int, int]
) -> list[float] | None:
    """Put down what truth and detections have in common."""
    frame = numbers[0]
    if not 1 <= frame <= _MOST_FRAMES or frame != int(frame):
        problems.add(f"{where}: frame must be a whole number from 1 to {_MOST_FRAMES} (got {frame:g})")
        return None
    number = int(numbers[7]) if len(numbers) > 7 else -1
    if to_label and number not in to_label:
        problems.add(f"{where}: has no class in its eighth column, but detections have (got {number})")
        return None
    box = corners(list(numbers[2:6]), where, problems)
    if box is not None:
        rows.image.append(int(frame) - 1)
        rows.label.append(to_label[number] if to_label else 0)
        rows.boxes.append(box)
    return box


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
