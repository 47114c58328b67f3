"""KITTI's tracking labels: a line for each object, whose third word is its type. A line is frame, track, type,
truncation, occlusion, angle; left, top, right and bottom of the box; height, width and length of the object, its x, y
and z before the camera in metres, its rotation; and in results a score. Frames and pixels count from 0 (readme of the
tracking benchmark's development kit). Occlusion is a class, and becomes the visible fraction. Truncation becomes the
share inside the image: it is the share outside in a file where one is no whole number, else a class too. `DontCare` is
a region to be ignored."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from modsim3d.core.errors import InputError
from modsim3d.core.text import number_in
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.reading.builder import NO_OPTIONS, Problems, ReadOptions
from modsim3d.formats.reading.mot import OCCLUSION, VISIBLE_FRACTIONS, SequenceLines, problems_of, sequence_set
from modsim3d.io.input_files import read_text
from modsim3d.io.validation import nearest, shown

TYPES = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc", "Person")
NEIGHBOURS = {"Van": "Car", "Person_sitting": "Pedestrian", "Person": "Pedestrian"}
"""Types that the benchmark counts neither for nor against a detector of the other; a sitting person has two names."""
REGION = "DontCare"
_TYPE, _TRUNCATION, _OCCLUSION, _DEPTH, _SCORE = 2, 3, 4, 15, 17  # columns from 0


def is_kitti(line: str) -> bool:
    """Whether a line has the form: words without commas, of which the third alone is no number."""
    words = line.split()
    return len(words) > 9 and [k for k, word in enumerate(words) if math.isnan(number_in(word))] == [_TYPE]


def read_kitti(condition: str, truth: Path, detections: Path | None, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition, a sequence of frames, from labels and results, or from labels alone. The classes are those of
    the options, or all types; then neighbours of one of them are ignored, and other types are left out. Raises
    InputError if the files are wrong; each problem names its line."""
    problems, wrong = problems_of(truth, detections, options)
    labels = list(_lines(truth, "ground truth", _SCORE, problems))
    results = list(_lines(detections, "detections", _SCORE + 1, wrong)) if detections else []
    types = {name for _, name, _ in (*labels, *results)} - {REGION}
    names = options.labels or (*TYPES, *sorted(types - set(TYPES)))
    number_of = {name: float(number) for number, name in enumerate(names, 1)}
    beside = {name: number_of[other] for name, other in NEIGHBOURS.items() if other in names and name not in names}
    shares = any(row[_TRUNCATION] % 1 for _, _, row in labels)
    for where, _, row in labels:
        if shares and row[_TRUNCATION] > 1:
            problems.add(f"{where}: truncation must be a share up to 1, as in other lines (got {row[_TRUNCATION]:g})")
    labels = [line for line in labels if not shares or line[2][_TRUNCATION] <= 1]
    annotated = [
        (where, [*_place(row), name in names, {**beside, **number_of}[name], *_attributes(row, shares)])
        for where, name, row in labels
        if name in names or name in beside
    ]
    regions = [(where, _place(row)) for where, name, row in labels if name == REGION]
    detected = [(where, [*_place(row), row[_SCORE], number_of[name]]) for where, name, row in results if name in names]
    notes = [
        f"KITTI: occlusion is a class: {OCCLUSION}",
        "KITTI: truncation is the share outside the image where one in a file is no whole number, else a class: "
        "1 stands for 0.75 of a vessel inside, and 2 for 0.25",
        f"KITTI: half of a detection in {REGION} is enough to ignore it",
    ]
    if options.labels:
        near = f"; to be ignored: {', '.join(f'{name} beside {NEIGHBOURS[name]}' for name in beside)}" if beside else ""
        notes.append(f"KITTI: types other than {', '.join(names)} are left out{near}")
    in_words = dict(enumerate(names, 1))
    lines = SequenceLines(annotated, detected if detections else None, regions, in_words, 0, notes)
    return sequence_set(condition, truth, lines, options, problems, wrong)


def chosen_types(given: tuple[str, ...], truth: Sequence[Path], detections: Sequence[Path]) -> tuple[str, ...]:
    """The types that are given; if none are, those that detections name. Raises InputError if no file has one."""
    in_truth, detected = (_types_in(paths) for paths in (truth, detections))
    types = (*TYPES, *sorted((in_truth | detected) - set(TYPES)))
    if unknown := [name for name in given if name not in types]:
        wrong = (f"{shown(name)} is no type in the files ({nearest(name, types)})" for name in unknown)
        raise InputError("--labels", list(wrong))
    return given or tuple(name for name in types if name in detected)


def _types_in(paths: Sequence[Path]) -> set[str]:
    lines = (line.split() for path in paths for line in read_text(path, "labels").splitlines())
    return {words[_TYPE] for words in lines if len(words) > _TYPE} - {REGION}


def _lines(path: Path, what: str, least: int, problems: Problems) -> Iterator[tuple[str, str, list[float]]]:
    """Place in the file, type and numbers, NaN for the type, of the lines that are right in themselves."""
    for index, text in enumerate(read_text(path, what).splitlines()):
        words, where = text.split(), f"{path.name} line {index + 1}"
        numbers = [number_in(word) for word in words]
        if not words:
            continue
        if len(words) < least:
            wanted = f"must have {least}{', of which the last is the score' * (least > _SCORE)}"
            problems.add(f"{where}: has {len(words)} columns, {wanted} (got {shown(text)})")
        elif [place for place, number in enumerate(numbers[:least]) if math.isnan(number)] != [_TYPE]:
            problems.add(f"{where}: must be finite numbers but for the third column, a type (got {shown(text)})")
        elif least == _SCORE and numbers[_OCCLUSION] not in (-1, 0, 1, 2, 3):
            got = f"{numbers[_OCCLUSION]:g}"
            problems.add(f"{where}: occlusion must be 0, 1, 2 or 3, or -1 where it is not known (got {got})")
        elif least == _SCORE and not (0 <= numbers[_TRUNCATION] <= 1 or numbers[_TRUNCATION] in (-1, 2)):
            wanted = "a class 0, 1 or 2, a share up to 1, or -1 where it is not known"
            problems.add(f"{where}: truncation must be {wanted} (got {numbers[_TRUNCATION]:g})")
        else:
            yield where, words[_TYPE], numbers


def _place(row: list[float]) -> list[float]:
    left, top, right, bottom = row[6:10]
    return [*row[:2], left, top, right - left, bottom - top]


def _attributes(row: list[float], shares: bool) -> tuple[float, float, float]:
    """Visible fraction, distance in metres and share inside the image, whose truncation is a class or a share."""
    cut = row[_TRUNCATION]
    inside = math.nan if cut == -1 else 1 - cut if shares else VISIBLE_FRACTIONS[int(cut)]
    return VISIBLE_FRACTIONS[int(row[_OCCLUSION])], row[_DEPTH] if row[_DEPTH] > 0 else math.nan, inside
